"""Locks: the four rules against a truth table in plain Python, and how firmly a locked object is held."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import maax_mjx as maax
from maax_mjx.wrappers.lock_rules import LOCK_TYPES, lock_rule

PUSH, TWIST = 200.0, 20.0
equal = np.testing.assert_array_equal


def truth(lock_type, wants, near, locked, last_owner, team):
    """Is one object locked after a step, and who may own it: the rules of FACTS, agent by agent."""
    asking = [i for i in range(len(team)) if near[i] and wants[i]]
    refusing = [i for i in range(len(team)) if near[i] and not wants[i]]
    if lock_type == "any":
        lock, unlock = bool(asking), bool(refusing) and not asking
    elif lock_type == "all":
        lock, unlock = bool(asking) and not refusing, bool(refusing)
    elif lock_type == "any_specific":
        lock, unlock = bool(asking), locked and last_owner in refusing
    else:
        vetoes = [i for i in refusing if team[i] == team[last_owner]]
        lock, unlock = bool(asking) and not vetoes, bool(vetoes)
    stays = locked and not unlock
    if lock and not stays:
        return True, set(asking)
    return stays, {last_owner} if stays else {-1}


@pytest.mark.parametrize("lock_type", LOCK_TYPES)
@pytest.mark.parametrize("n_agents", [2, 3, 4])
def test_rules(lock_type, n_agents):
    """Every combination of wants, nearness, lock and last owner, with every way to form two teams."""
    cases = list(
        itertools.product(
            itertools.product([False, True], repeat=n_agents),
            itertools.product([False, True], repeat=n_agents),
            [False, True],
            range(n_agents),
        )
    )
    wants, near, locked, owner = (np.array([case[i] for case in cases]) for i in range(4))
    for team in itertools.product([0, 1], repeat=n_agents):
        lock, unlock = lock_rule(lock_type, wants.T, near.T, jnp.asarray(locked), jnp.asarray(owner), np.array(team))
        kept = locked & ~np.asarray(unlock)
        after = kept | np.asarray(lock)
        for i, case in enumerate(cases):
            want, owners = truth(lock_type, *case, team)
            assert after[i] == want, (case, team)
            if owners == {-1} or not want:
                continue
            assert (owners == {case[3]} and kept[i]) or not kept[i]


def build(method="equality", *, free=False, radius=10.0, lock_type="team", outer="walls", per_object=True):
    env = maax.Base(4, impl="c")
    env.add_module(maax.WallScenarios("empty", outer=outer))
    env.add_module(maax.Agents({"hiders": 2, "seekers": (0, 2)}))
    env.add_module(maax.Boxes((1, 2), n_elongated_boxes=(0, 1), free=free))
    env.add_module(maax.Ramps(1, free=free))
    return maax.LockObjects(
        maax.TeamMembership(env), method=method, radius=radius, lock_type=lock_type, per_object=per_object
    )


@pytest.fixture(scope="module")
def locking():
    env = build()
    return env, jax.jit(env.reset), jax.jit(env.step)


def bodies(env):
    return np.concatenate([env.base.modules[name].body_ids for name in ("boxes", "ramps")])


def action(wants, move=0.0):
    return {"move": jnp.full((4, 3), move), "lock": jnp.asarray(wants, jnp.int32)}


LIMITS = {("equality", False): (0.5, 0.1), ("joint_range", False): (5.0, 0.7), ("equality", True): (5.0, 0.7)}


@pytest.mark.parametrize(("method", "free"), LIMITS)
def test_a_locked_object_is_held(method, free, locking):
    """Under 200 N and 20 Nm for 1,000 steps, and without swinging; unlocked, it goes."""
    env, reset, step = locking
    if (method, free) != ("equality", False):
        env = build(method, free=free)
        reset, step = jax.jit(env.reset), jax.jit(env.step)
    params = env.default_params.replace(n_boxes=2, n_elongated_boxes=1)
    state = step(reset(jax.random.key(0), params), action(np.ones((4, 3))))
    ids = bodies(env)
    force = np.zeros(state.data.xfrc_applied.shape, np.float32)
    force[ids] = [0.6 * PUSH, 0.8 * PUSH, 0, 0, 0, TWIST]
    state = state.replace(data=state.data.replace(xfrc_applied=jnp.asarray(force)))
    place, turn = np.asarray(state.data.xpos)[ids], np.asarray(state.data.xquat, float)[ids]
    way, angle, places = 0.0, 0.0, []
    for _ in range(1000):
        state = step(state, action(np.ones((4, 3))))
        xpos, xquat = np.asarray(state.data.xpos)[ids], np.asarray(state.data.xquat, float)[ids]
        way = max(way, np.linalg.norm(xpos - place, axis=1).max() * 1e3)
        sine = np.linalg.norm(np.cross(xquat[:, 1:], turn[:, 1:]) + xquat[:, :1] * turn[:, 1:]
                              - turn[:, :1] * xquat[:, 1:], axis=1)  # fmt: skip
        angle = max(angle, np.degrees(2 * np.arcsin(sine)).max())
        places.append(xpos)
    assert way < LIMITS[method, free][0], "mm"
    assert angle < LIMITS[method, free][1], "degrees"
    assert np.ptp(places[-200:], axis=0).max() < 2e-5, "it swings"
    assert not state.metrics["physics_fault"]
    equal(state.obs["obj_lock"][:, 0], 1)
    for _ in range(20):
        state = step(state, action(np.zeros((4, 3))))
    equal(state.obs["obj_lock"][:, 0], 0)
    assert (np.linalg.norm(np.asarray(state.data.xpos)[ids] - place, axis=1) > 0.1).all()


def test_unlocked_it_moves_as_if_never_locked(locking):
    _, reset, step = locking
    fresh = reset(jax.random.key(1))
    state = step(step(fresh, action(np.ones((4, 3)))), action(np.zeros((4, 3))))
    never = fresh.replace(data=state.data.replace(eq_active=fresh.data.eq_active))
    for t in range(50):
        push = action(np.zeros((4, 3)), 1.0 if t % 20 < 10 else -0.5)
        state, never = step(state, push), step(never, push)
        np.testing.assert_allclose(state.data.qpos, never.data.qpos, atol=1e-6)


def test_the_file_of_a_locked_world_moves_as_it_does(locking):
    env, reset, step = locking
    state = step(reset(jax.random.key(2)), action(np.ones((4, 3))))
    model = mujoco.MjModel.from_xml_string(maax.to_mjcf(env, state))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qacc_warmstart[:] = model.numeric("qacc_warmstart").data
    assert data.eq_active.sum() == 4 * int(np.asarray(state.obs["obj_lock"]).sum()) > 0
    for _ in range(50):
        state = step(state, action(np.ones((4, 3)), 0.7))
        data.ctrl[:] = np.where(np.repeat(np.asarray(state.world.active["agent"]), 3), 0.7, 0.0)
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, state.data.qpos, atol=1e-5)


def test_only_what_is_near_and_present_is_locked(locking):
    env = build(radius=0.25, lock_type="any")
    reset, step = jax.jit(env.reset), jax.jit(env.step)
    agents, box = env.base.agents, env.base.modules["boxes"]
    seen = []
    for seed in range(40):
        start = reset(jax.random.key(seed))
        extents = np.asarray(box.extents_of(start.world))[0]
        gap = np.random.default_rng(seed).uniform(0.16, 0.35)
        centre = np.asarray(start.data.qpos)[box.qpos_ids[0]]
        at = centre[:2] + np.array([extents[0] / 2 + gap, 0])
        qpos = start.data.qpos.at[agents.qpos_ids[0, :2]].set(jnp.asarray(at))
        state = start.replace(data=env.base.engine.pose(start.world, start.data.replace(qpos=qpos)))
        state = step(state, action(np.array([[1, 0, 0]] + [[0, 0, 0]] * 3)))
        assert bool(state.obs["obj_lock"][0, 0]) == (gap <= 0.25) or abs(gap - 0.25) < 1e-3
        seen.append(gap <= 0.25)
        if gap <= 0.25:
            equal(state.obs["you_lock"][:, 0, 0], [1, 0, 0, 0])
            equal(state.obs["team_lock"][:2, 0, 0], [1, 1])
            assert not np.asarray(state.obs["team_lock"])[2:].any()
            assert int(state.mechanics["locks"].owner[0]) == 0
        assert not np.asarray(state.mechanics["locks"].locked)[~np.asarray(
            jnp.concatenate([state.world.active["box"], state.world.active["ramp"]]))].any()  # fmt: skip
    assert 0.2 < np.mean(seen) < 0.9


def test_all_at_once_and_owners_are_drawn_among_those_who_want(locking):
    env = build(per_object=False, lock_type="any")
    worlds = maax.Worlds(env, 400)
    params = env.default_params.replace(n_seekers=2)
    states = worlds.reset(jax.random.key(0), params)
    wants = jnp.tile(jnp.array([1, 0, 1, 1]), (400, 1))
    states = worlds.step(states, {"move": jnp.zeros((400, 4, 3)), "lock": wants})
    locks = states.mechanics["locks"]
    active = jnp.concatenate([states.world.active["box"], states.world.active["ramp"]], axis=1)
    equal(locks.locked, active)
    counts = np.bincount(np.asarray(locks.owner)[:, -1], minlength=4)
    assert counts[1] == 0
    assert (counts[[0, 2, 3]] > 90).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: maax.LockObjects(maax.make("standard")), "LockObjects: needs TeamMembership"),
        (lambda: build(lock_type="some"), "lock_type: got 'some'; takes one of"),
        (lambda: build("glue"), "method: got 'glue'; takes one of"),
        (lambda: build("joint_range", free=True), "the free joints of boxes have none; takes 'equality'"),
        (
            lambda: maax.LockObjects(maax.TeamMembership(maax.make("standard")), ["boxs"]),
            "objects: got 'boxs'; takes one of",
        ),
    ],
)
def test_mistakes(call, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call()
    assert message in str(error.value)
