"""Worlds in plain MuJoCo."""

from __future__ import annotations

import mujoco

import maax_mjx as maax


def in_plain_mujoco(env, state, world=None):
    """A world's MjModel and MjData, from the file alone that `to_mjcf` writes of it."""
    model = mujoco.MjModel.from_xml_string(maax.to_mjcf(env, state, world))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qacc_warmstart[:] = model.numeric("qacc_warmstart").data
    return model, data
