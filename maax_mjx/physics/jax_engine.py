"""impl="jax": MJX's own JAX physics. Any accelerator, differentiable, the reference."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from mujoco import mjx

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.world import World


class JaxEngine(Engine):
    """Rebuilds the mjx.Data from a template at every step: all of it is recomputed anyway, and nothing is carried."""

    impl = "jax"

    def advance(self, world: World, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        model = self.mjx.overlay(world)

        def frame(data: Data, _: None) -> tuple[Data, jax.Array]:
            d = mjx.step(model, self.mjx.data(data))
            stepped = data.replace(time=d.time, qpos=d.qpos, qvel=d.qvel, qacc_warmstart=d.qacc_warmstart)
            # The deepest contacts are kept: some may be missing only if every kept one is active.
            dist = d._impl.contact.dist
            return stepped, jnp.all(dist < 0) if dist.size else jnp.zeros((), bool)

        if n_frames == 1:
            return frame(data, None)
        data, overflow = jax.lax.scan(frame, data, length=n_frames)
        return data, overflow.any()
