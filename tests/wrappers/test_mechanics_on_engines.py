"""Locks hold and holds carry on the accelerators' engines as they do on `c`; senses read their poses."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from helpers.plain_mujoco import in_plain_mujoco

import maax_mjx as maax

pytestmark = pytest.mark.slow

PUSH, TWIST = 200.0, 20.0
PUSHED = 300  # steps; 1,000 on `c`, in `test_locks`


@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_locks_and_holds(impl):
    """Carried along by forces that change, then locked and pushed by 200 N and 20 Nm."""
    if impl == "warp":
        pytest.importorskip("warp")
    env = maax.Base(1, impl=impl)
    env.add_module(maax.WallScenarios("empty"))
    env.add_module(maax.Agents(1))
    env.add_module(maax.Boxes(1))
    env = maax.Lidar(maax.LineOfSight(maax.TeamMembership(env), objects=["box"]), 4)
    env = maax.GrabObjects(maax.LockObjects(env, ["box"]), ["box"])
    base = env.base
    state = jax.jit(env.reset)(seeds.key(0))
    agent, box = base.agents.qpos_ids[0], base.modules["box"].qpos_ids[0]
    qpos = state.data.qpos.at[agent[:2]].set(jnp.array([2.5, 3.0])).at[box[:2]].set(jnp.array([2.93, 3.0]))
    state = state.replace(data=jax.jit(base.engine.pose)(state.world.fields, state.data.replace(qpos=qpos)))
    moves = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0.3, 0.3, 1]], np.float32).repeat(30, axis=0)

    @jax.jit
    def play(state, moves, grabbing):
        """Steps in which the box is held, or else locked; compiled once for both."""

        def step(state, move):
            action = {"move": move[None], "grab": jnp.full(1, grabbing), "lock": jnp.full((1, 1), 1 - grabbing)}
            state = env.step(state, action)
            return state, (state.data.qpos, state.mechanics["grabs"].held[0])

        return jax.lax.scan(step, state, moves)

    state, (trail, held) = jax.device_get(play(state, moves, 1))
    gap, yaw = trail[:, box[:2]] - trail[:, agent[:2]], trail[:, agent[3]]
    cos, sin = np.cos(yaw), np.sin(yaw)
    offset = np.stack([cos * gap[:, 0] + sin * gap[:, 1], cos * gap[:, 1] - sin * gap[:, 0]], axis=1)
    error = np.linalg.norm(offset - [0.43, 0.0], axis=1) * 1e3
    assert (held == 0).all()
    assert np.ptp(trail[:, box[:2]], axis=0).max() > 0.5
    assert np.median(error) < 15, "mm"
    assert error.max() < 100, "mm"

    # One step on, it is where MuJoCo has it: agent and box turn about each other, which a connect has to make up for.
    model, data = in_plain_mujoco(env, state)
    data.ctrl[:] = state.data.ctrl
    assert abs(data.qvel[base.agents.qvel_ids[0][3]]) > 2, "rad/s"
    assert data.eq_active.any()
    mujoco.mj_step(model, data)
    after, _ = jax.jit(base.engine.advance, static_argnums=2)(state.world.fields, state.data, 1)
    assert np.abs(np.asarray(after.qpos) - data.qpos).max() < 1e-5

    body = base.modules["box"].body_ids[0]
    force = np.array(state.data.xfrc_applied)
    force[body] = [0.6 * PUSH, 0.8 * PUSH, 0, 0, 0, TWIST]
    start = np.asarray(state.data.qpos[box])
    state, trail = state.replace(data=state.data.replace(xfrc_applied=force)), []
    for _ in range(PUSHED // len(moves)):
        state, (qpos, _) = jax.device_get(play(state, np.zeros_like(moves), 0))
        trail.append(qpos[:, box])
    moved = np.abs(np.concatenate(trail) - start)
    assert state.mechanics["locks"].locked.all()
    assert np.linalg.norm(moved[:, :2], axis=1).max() < 0.5e-3
    assert np.degrees(moved[:, 3]).max() < 0.1
    ray = np.asarray(state.obs["lidar"])[0, :, 0]
    assert ((ray > 0.15) & (ray < 6)).all()


@pytest.mark.parametrize("pushed", [False, True], ids=["agent", "agents and 200 N"])
def test_a_locked_box_withstands_agents(pushed):
    """Two lean on two of its faces for 1,000 steps with all their force, off the middle, so that both turn it."""
    env = maax.Base(2, impl="c")
    env.add_module(maax.Agents(2))
    env.add_module(maax.Boxes(1))
    env = maax.LockObjects(maax.TeamMembership(env), ["box"], radius=10.0)
    base = env.base
    state = jax.jit(env.reset)(seeds.key(0))
    agents, box = base.agents.qpos_ids, base.modules["box"].qpos_ids[0]
    qpos = state.data.qpos.at[box[:2]].set(3.0)
    qpos = qpos.at[agents[:, :2]].set(jnp.array([[2.6, 2.8], [3.2, 2.6]]))
    data = jax.jit(base.engine.pose)(state.world.fields, state.data.replace(qpos=qpos))
    load = jnp.array([0.6 * PUSH, 0.8 * PUSH, 0, 0, 0, TWIST]) * pushed
    force = data.xfrc_applied.at[base.modules["box"].body_ids[0]].set(load)
    state = state.replace(data=data.replace(xfrc_applied=force))
    moves = jnp.broadcast_to(jnp.array([[1.0, 0, 0], [0, 1.0, 0]]), (1000, 2, 3))

    @jax.jit
    def lean(state):
        def step(state, move):
            state = env.step(state, {"move": move, "lock": jnp.ones((2, 1), int)})
            return state, (state.data.qpos, state.mechanics["locks"].locked[0], state.metrics["physics_fault"])

        return jax.lax.scan(step, state, moves)[1]

    trail, locked, fault = (np.asarray(x) for x in lean(state))
    assert locked.all()
    assert not fault.any()
    assert (trail[:, [agents[0, 0], agents[1, 1]]] > 2.599).all(), "in contact"
    moved = np.abs(trail[:, box] - np.asarray(qpos)[box])
    assert np.linalg.norm(moved[:, :3], axis=1).max() < 0.5e-3
    assert np.degrees(moved[:, 3]).max() < 0.1
