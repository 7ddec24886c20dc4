"""The engine impl="warp": MJX-Warp, the fast one on NVIDIA GPUs. It runs on a CPU too, slowly."""

from __future__ import annotations

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from maax_mjx.physics.data import Data
from maax_mjx.physics.fields import Fields, Overlay
from maax_mjx.physics.mjx_engine import MjxEngine
from maax_mjx.physics.mjx_internals import (
    check_internals,
    clear_overflow,
    lost_contacts,
    solve_in_one_launch,
    with_contact_room,
    without_overflow_warnings,
)
from maax_mjx.physics.mjx_model import overlaid, put_on_host, state_of, with_friction

ROWS_PER_CONTACT = 4
ROWS_PER_EQUALITY = 6

CONTACTS_PER_CONVEX_PAIR = 4
"""Contacts that there is room for per pair of convex geoms. Warp takes 5 kB of scratch per pair, nearly all of its
memory, and uses it again for every kind of pair (box and box, box and ramp). A pair mostly has four contacts, and the
floor, which has most of them, is no convex geom. In C MuJoCo under hostile play one world of M had 2 pairs of a kind at
the same time, of room for 7, and one of `hide_and_seek_full` 6 of 22. What finds no room counts as contact overflow."""

MIN_CONVEX_PAIRS = 64
"""Pairs of a batch that there is room for at least, if so many contacts: few worlds cannot use the room of others."""


def fitted(model: mujoco.MjModel, overlay: Overlay) -> mujoco.MjModel:
    """Returns a copy that says what Warp can leave out.

    Rows of the constraints' Jacobian are kept as their few entries: written as a whole, they took a sixth of a physics
    step of `hide_and_seek_quadrant`. Where no joint or tendon of any world has dry friction, the solver knows no rows
    of that kind (see `warp_newton`).
    """
    model = copy.copy(model)
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    names = ("dof_frictionloss", "tendon_frictionloss")
    if not any(name in overlay or getattr(model, name).any() for name in names):
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    return model


class WarpEngine(MjxEngine):
    """Steps all worlds of a device together; their contacts share one buffer.

    Its size follows from the number of worlds that are mapped over, whatever maps them: `Worlds`, `jax.vmap`, or a
    device's share in `shard_map`. It lives inside a step, so that nothing is carried from one to the next.

    Args:
        model: the compiled model.
        overlay: the rows in which worlds differ.
        contacts_per_world: contacts of a world that there is room for. Some may have more in the contact buffer, which
            all worlds of a device share, but not in the constraint rows.
        n_equalities: how many equalities can be active at once.

    Raises:
        RuntimeError: the installed MJX or Warp is not one that `mjx_internals` knows.
    """

    impl = "warp"

    def __init__(self, model: mujoco.MjModel, overlay: Overlay, contacts_per_world: int, n_equalities: int):
        check_internals("warp")
        solve_in_one_launch()
        super().__init__(model, overlay)
        self.contacts_per_world = contacts_per_world
        rows = ROWS_PER_CONTACT * contacts_per_world + ROWS_PER_EQUALITY * n_equalities + int(model.jnt_limited.sum())
        model = fitted(with_friction(model), overlay)
        with jax.ensure_compile_time_eval():
            device = jax.local_devices()[0]
            self._model = put_on_host(mjx.put_model(model, device=device, impl="warp"))
            data = mjx.make_data(model, device=device, impl="warp", naconmax=contacts_per_world, njmax=rows)
            self._data = put_on_host(data)
        self._needs_velocities = bool(np.isin(model.eq_type, (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)).any())
        # Overflow would be printed from the device; `step` reports it.
        self._model = without_overflow_warnings(self._model)

    def step(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        @jax.custom_batching.custom_vmap
        def run(fields: Fields, data: Data) -> tuple[Data, jax.Array]:
            n_worlds = data.time.shape[0]
            return jax.vmap(lambda f, d: self._frames(n_worlds, f, d, n_frames))(fields, data)

        @run.def_vmap
        def mapped(axis_size: int, is_mapped: tuple, fields: Fields, data: Data) -> tuple:
            """Merges the mapped axis with the batch axis, so that all worlds are stepped together."""

            def merge(x: jax.Array, x_mapped: bool) -> jax.Array:
                x = x if x_mapped else jnp.broadcast_to(x, (axis_size, *x.shape))
                return x.reshape(x.shape[0] * x.shape[1], *x.shape[2:])

            out = run(*jax.tree.map(merge, (fields, data), tuple(is_mapped)))
            out = jax.tree.map(lambda x: x.reshape(axis_size, x.shape[0] // axis_size, *x.shape[1:]), out)
            return out, jax.tree.map(lambda _: True, out)

        batch = jax.tree.map(lambda x: x[None], (fields, data))
        return jax.tree.map(lambda x: x[0], run(*batch))

    def mjx_model(self, fields: Fields) -> mjx.Model:
        return overlaid(self._model, self.overlay, fields)

    def mjx_data(self, data: Data, n_worlds: int) -> mjx.Data:
        size = n_worlds * self.contacts_per_world
        pairs = min(size, max(MIN_CONVEX_PAIRS, size // CONTACTS_PER_CONVEX_PAIR))
        template = with_contact_room(jax.tree.map(jnp.asarray, self._data), size, pairs)
        # Poses of geoms on the world body are computed by make_data alone, where the overlay is not known yet.
        return template.replace(**state_of(data), geom_xpos=data.geom_xpos, geom_xmat=data.geom_xmat)

    def _frames(self, n_worlds: int, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        model = self.mjx_model(fields)

        def state(d: mjx.Data) -> Data:
            return data.replace(time=d.time, qpos=d.qpos, qvel=d.qvel, qacc_warmstart=d.qacc_warmstart)

        def frame(d: mjx.Data, _: None) -> tuple[mjx.Data, jax.Array]:
            d = clear_overflow(d)
            if self._needs_velocities:
                # Warp builds its constraints first: connects and welds would read the last step's velocities in space.
                d = d.replace(**self.mjx.velocities(fields, state(d)))
            d = self.mjx_step(model, d)
            return d, lost_contacts(d)

        # Warp keeps a graph, with the memory that it needs, for each of its calls in a program: a loop has one.
        start = self.mjx_data(data, n_worlds)
        d, overflow = frame(start, None) if n_frames == 1 else jax.lax.scan(frame, start, length=n_frames)
        return state(d), overflow.any()
