"""Equality constraints that mechanics switch and aim through data, without recompiling the model."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.core.arena_limits import SOLIMP, SOLREF
from maax_mjx.core.state import State
from maax_mjx.physics import Overlay

WIDTH = mujoco.mjNEQDATA
"""Numbers of `eq_data` per equality."""


def add_equality(
    spec: mujoco.MjSpec, name: str, kind: mujoco.mjtEq, first: str, second: str = "", ratio: float = 0.0,
    soft: bool = False,
) -> None:  # fmt: skip
    """Adds an equality of one or two joints or of two bodies, inactive until data activates it.

    Args:
        spec: spec to add it to.
        name: name of the equality.
        kind: joint, connect or weld.
        first: names of joints or of bodies; a joint equality may leave out the second.
        second: likewise.
        ratio: ratio of the first joint to the second.
        soft: whether it has MuJoCo's default softness; otherwise it is as stiff as a step of 5 ms allows.
    """
    stiff = {} if soft else {"solref": SOLREF, "solimp": SOLIMP}
    of_joints = kind == mujoco.mjtEq.mjEQ_JOINT
    data = np.zeros(WIDTH)
    data[1] = ratio
    if kind == mujoco.mjtEq.mjEQ_WELD:
        data[6] = data[10] = 1.0  # the real part of its quaternion, and its torque scale
    spec.add_equality(
        name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT if of_joints else mujoco.mjtObj.mjOBJ_BODY,
        name1=first, name2=second, active=False, data=data, **stiff,
    )  # fmt: skip


def joint_data(offset: jax.Array, ratio: float) -> jax.Array:
    """Returns `eq_data` (n, `WIDTH`) of joint equalities with an offset (n,) and a ratio to the second joint."""
    columns = [offset, jnp.full_like(offset, ratio)]
    return jnp.pad(jnp.stack(columns, axis=1), ((0, 0), (0, WIDTH - 2)))


def connect_data(point: jax.Array) -> jax.Array:
    """Returns `eq_data` (n, `WIDTH`) that connects points (n, 3) in first bodies' frames to second bodies' origins."""
    return jnp.pad(point, ((0, 0), (0, WIDTH - 3)))


def weld_data(pose: jax.Array) -> jax.Array:
    """Returns `eq_data` (n, `WIDTH`) of welds that hold second bodies at poses (n, 7) in the first bodies' frames."""
    scale = jnp.ones((len(pose), 1))
    return jnp.pad(jnp.concatenate([pose, scale], axis=1), ((0, 0), (3, WIDTH - 11)))


def set_equalities(state: State, overlay: Overlay, ids: np.ndarray, data: jax.Array, active: jax.Array) -> State:
    """Sets some equalities of a state.

    Args:
        state: a state before a step.
        overlay: the environment's overlay.
        ids: (n,) ids of the equalities.
        data: (n, `WIDTH`) their `eq_data`.
        active: (n,) bool, whether they hold.
    """
    rows = np.searchsorted(overlay["eq_data"], ids)
    fields = state.world.fields | {"eq_data": with_rows(state.world.fields["eq_data"], rows, data)}
    eq_active = with_rows(state.data.eq_active, ids, active)
    return state.replace(world=state.world.replace(fields=fields), data=state.data.replace(eq_active=eq_active))
