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

PUSH, TWIST, N = 200.0, 20.0, 1000


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
    state = state.replace(data=base.engine.pose(state.world.fields, state.data.replace(qpos=qpos)))
    moves = jnp.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0.3, 0.3, 1]]).repeat(30, axis=0)

    @jax.jit
    def carry(state):
        def step(state, move):
            action = {"move": move[None], "grab": jnp.ones(1, int), "lock": jnp.zeros((1, 1), int)}
            state = env.step(state, action)
            q = state.data.qpos
            cos, sin = jnp.cos(q[agent[3]]), jnp.sin(q[agent[3]])
            offset = q[box[:2]] - q[agent[:2]]
            seen = jnp.array([cos * offset[0] + sin * offset[1], cos * offset[1] - sin * offset[0]])
            return state, (seen, q[box[:2]], state.mechanics["grabs"].held[0])

        return jax.lax.scan(step, state, moves)

    state, (offset, way, held) = carry(state)
    error = np.linalg.norm(np.asarray(offset) - [0.43, 0.0], axis=1) * 1e3
    assert (np.asarray(held) == 0).all()
    assert np.ptp(np.asarray(way), axis=0).max() > 0.5
    assert np.median(error) < 15, "mm"
    assert error.max() < 100, "mm"

    # One step on, it is where MuJoCo has it: agent and box turn about each other, which a connect has to make up for.
    model, data = in_plain_mujoco(env, state)
    data.ctrl[:] = state.data.ctrl
    assert abs(data.qvel[base.agents.qvel_ids[0][3]]) > 2, "rad/s"
    assert data.eq_active.any()
    mujoco.mj_step(model, data)
    after, _ = base.engine.advance(state.world.fields, state.data, 1)
    assert np.abs(np.asarray(after.qpos) - data.qpos).max() < 1e-5

    body = base.modules["box"].body_ids[0]
    force = state.data.xfrc_applied.at[body].set(jnp.array([0.6 * PUSH, 0.8 * PUSH, 0, 0, 0, TWIST]))

    @jax.jit
    def push(state):
        def step(state, _):
            action = {"move": jnp.zeros((1, 3)), "grab": jnp.zeros(1, int), "lock": jnp.ones((1, 1), int)}
            state = env.step(state, action)
            return state, state.data.qpos[box]

        state = state.replace(data=state.data.replace(xfrc_applied=force))
        return jax.lax.scan(step, state, length=N)

    start = np.asarray(state.data.qpos[box])
    state, trail = push(state)
    moved = np.abs(np.asarray(trail) - start)
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
    data = base.engine.pose(state.world.fields, state.data.replace(qpos=qpos))
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
