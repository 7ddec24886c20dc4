"""M with the bodies of the thesis's code, from a table of what its files say."""

from __future__ import annotations

import jax
import mujoco
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax


def joints_of(model, body):
    ids = np.flatnonzero(model.jnt_bodyid == model.body(body).id)
    return {int(model.jnt_type[j]): set(model.dof_damping[model.dof_jntid == j].tolist()) for j in ids}


def frictions_of(model, body):
    return set(model.geom_friction[model.geom_bodyid == model.body(body).id, 0].tolist())


def test_bodies_are_as_the_files_say():
    model = maax.make("standard", preset="maax", impl="c").base.model
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    assert joints_of(model, "box0") == {free: {0.01}}
    assert joints_of(model, "ramp0") == {free: {0.001}}
    for motor in ("x", "y", "yaw"):
        assert model.joint(f"agent0:{motor}").damping[0] == 0.01
        assert model.actuator(f"agent0:{motor}").gear[0] == 100.0
    assert frictions_of(model, "agent0") == {0.01}
    assert frictions_of(model, "box0") == {0.2}
    assert frictions_of(model, "ramp0") == {0.01}
    assert set(model.geom_friction[[model.geom(f"wall{i}").id for i in range(8)], 0]) == {0.01}
    assert model.geom(model.body("world").geomadr[0]).friction[0] == 1.0
    assert model.opt.gravity[2] == -9.81


def test_outer_walls_are_three_metres_high():
    env = maax.make("standard", preset="maax", impl="c")
    assert np.asarray(env.reset(seeds.key(0)).world.plan.wall_heights).max() == 3.0
    assert np.asarray(maax.make("standard", impl="c").reset(seeds.key(0)).world.plan.wall_heights).max() == 4.0


def test_by_default_bodies_are_ours():
    model = maax.make("standard", impl="c").base.model
    assert model.joint("box0:x").damping[0] == 0.01
    assert model.joint("ramp0:x").damping[0] == 0.1
    assert model.joint("agent0:x").damping[0] == 10.0
    assert frictions_of(model, "box0") == {1.0}


def test_fields_that_are_given_stay():
    model = maax.make("standard", preset="maax", impl="c", box_friction=0.7, n_boxes=2, agent_damping=3.0).base.model
    assert frictions_of(model, "box1") == {0.7}
    assert model.joint("agent1:x").damping[0] == 3.0
    assert frictions_of(model, "ramp0") == {0.01}


@pytest.mark.slow
def test_it_steps():
    env = maax.make("standard", preset="maax", impl="c")
    worlds = maax.Worlds(env, 8)
    states, kept = worlds.rollout(
        worlds.reset(seeds.key(1)),
        lambda state, key: env.sample_action(key),
        100,
        keep=("metrics.physics_fault", "obs"),
    )
    assert not np.asarray(kept["metrics.physics_fault"]).any()
    assert np.isfinite(jax.tree.leaves(jax.tree.map(np.asarray, kept["obs"]))[0]).all()
    # Hardly anything slows agents down, so that full force for a second makes them faster than ours ever are.
    speed = np.abs(np.asarray(states.data.qvel)[:, env.base.agents.qvel_ids[:, :2]])
    assert speed.max() > 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"preset": "brax"}, "preset: got 'brax'; takes one of 'ours', or 'maax'|preset: got 'brax'"),
        ({"box_damping": -1.0}, "box_damping: got -1.0"),
        ({"outer_height": 0.0}, "outer_height: got 0.0"),
        ({"preset": "maax", "outer": "limits"}, "as a free joint has no range"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        maax.make("standard", impl="c", **change)
