"""Distances from agents to objects, and which objects are within reach."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import check_bool
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.physics.rotation import conjugate, rotate
from maax_mjx.wrappers.senses import LineOfSight
from maax_mjx.wrappers.wrapper import Wrapper


class Reach:
    """The reach of agents: which of them can reach which objects of some modules.

    Args:
        wrapper: wrapper of the mechanic.
        objects: names of the modules; None is boxes and ramps, if there are any.
        radius: metres from an agent's centre to an object's surface.
        in_vision_only: whether objects that an agent did not see after the previous step are out of its reach.

    Attributes:
        modules: the modules.
        n: number of their objects.

    Raises:
        ValueError: an unknown module; vision without a `LineOfSight` that sees its objects.
    """

    def __init__(self, wrapper: Wrapper, objects: Sequence[str] | None, radius: float, in_vision_only: bool):
        self._base = wrapper.base
        self.modules = self._base.objects(objects)
        self.n = sum(module.n_max for module in self.modules)
        if not self.n:
            got = [m.name for m in self.modules]
            others = [m.name for m in self._base.movables if m is not self._base.agents]
            raise ValueError(
                f"objects: got {got}, which hold no objects; takes others of {others}, or leave "
                f"{type(wrapper).__name__} out"
            )
        self._radius = radius
        self._sight = wrapper.inner(LineOfSight) if check_bool("in_vision_only", in_vision_only) else None
        held = [m for m in self.modules if m.n_max]
        self._sees = [f"sees_{m.kind}" for m in held]
        if self._sight is not None:
            self._sight.check_sees(held)

    def __call__(self, state: State) -> tuple[jax.Array, jax.Array]:
        """Returns (n_agents, n) distances in metres, and (n_agents, n) bool: within reach, with both in play."""
        distance = distance_to_objects(self._base.agents.body_ids, self.modules, state)
        present = jnp.concatenate([state.world.active[m.kind] for m in self.modules])
        near = (distance <= self._radius) & present & state.world.active[self._base.agents.kind][:, None]
        if self._sight is not None:
            near &= self._sight.seen(state, self._sees)
        return distance, near


def distance_to_objects(bodies: np.ndarray, modules: Sequence[Entities], state: State) -> jax.Array:
    """Returns metres (n_bodies, n) from the centres of bodies to the surfaces of oriented boxes; 0 inside.

    Ramps and cylinders count as their boxes, as in OpenAI's code.
    """
    centres = jnp.concatenate([state.data.xpos[m.body_ids] for m in modules])
    quats = jnp.concatenate([state.data.xquat[m.body_ids] for m in modules])
    half = jnp.concatenate([m.reach_of(state.world) for m in modules]) / 2
    local = rotate(conjugate(quats), state.data.xpos[bodies][:, None] - centres)
    beyond = [jnp.maximum(jnp.abs(local[..., i]) - half[:, i], 0.0) for i in range(3)]
    return jnp.sqrt(sum(x * x for x in beyond))
