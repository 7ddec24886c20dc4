"""Locks: the four rules against a truth table in plain Python, and how firmly a locked object is held."""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from helpers.handled import handled
from helpers.plain_mujoco import in_plain_mujoco

import maax_mjx as maax
from maax_mjx.wrappers.locks.rules import LOCK_TYPES, lock_rule

PUSH, TWIST = 200.0, 20.0
equal = np.testing.assert_array_equal


def truth(lock_type, wants, near, locked, last_owner, team):
    """Is one object locked after a step, and who may own it: the published rules, agent by agent."""
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


def build(method="equality", *, free=False, radius=10.0, lock_type="team", outer="walls", per_object=True, n_frames=1):
    env = maax.Base(4, n_frames, impl="c")
    env.add_module(maax.WallScenarios("empty", outer=outer))
    env.add_module(maax.Agents({"hiders": 2, "seekers": (0, 2)}))
    env.add_module(maax.Boxes((1, 2), n_elongated_boxes=(0, 1), free=free))
    env.add_module(maax.Ramps(1, free=free))
    return maax.LockObjects(
        maax.TeamMembership(env), method=method, radius=radius, lock_type=lock_type, per_object=per_object
    )


@functools.cache
def posed(env):
    """`posed(env)(fields, data)`: the data with the poses of its qpos."""
    return jax.jit(env.base.engine.pose)


@functools.cache
def jitted(method="equality", free=False, outer="walls"):
    env = build(method, free=free, outer=outer)
    return env, jax.jit(env.reset), jax.jit(env.step)


@pytest.fixture(scope="module")
def locking():
    return jitted()


def bodies(env):
    return np.concatenate([env.base.modules[name].body_ids for name in ("box", "ramp")])


def action(wants, move=0.0):
    return {"move": np.full((4, 3), move, np.float32), "lock": np.asarray(wants, np.int32)}


def spread(env, state):
    """The state with objects away from each other and from the walls, so that all can be pushed along x and y."""
    spots = {"agent": [[0.5, 0.5], [0.5, 4.5], [5.0, 0.5], [3.4, 3.4]], "box": [[1.5, 1.5], [3.4, 1.5]]}
    qpos = np.array(state.data.qpos)
    for name, xy in (spots | {"ramp": [[1.5, 3.0]]}).items():
        module = env.base.modules[name]
        ids, there = module.qpos_ids[:, :2], state.world.active[module.kind][:, None]
        qpos[ids] = np.where(there, np.array(xy), qpos[ids])
    return state.replace(data=posed(env)(state.world.fields, state.data.replace(qpos=qpos)))


LIMITS = {("equality", False): (0.5, 0.1), ("joint_range", False): (5.0, 0.7), ("equality", True): (5.0, 0.7)}


@pytest.mark.slow
@pytest.mark.parametrize(("method", "free"), LIMITS)
def test_a_locked_object_is_held(method, free):
    """Under 200 N and 20 Nm for 1,000 steps, and without swinging; unlocked, it goes."""
    env, reset, step = jitted(method, free)
    params = env.default_params.replace(n_boxes=2, n_elongated_boxes=1)
    state = step(spread(env, reset(seeds.key(0), params)), action(np.ones((4, 3))))
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
    equal(handled(state.obs)["obj_lock"][:, 0], 1)
    for _ in range(20):
        state = step(state, action(np.zeros((4, 3))))
    equal(handled(state.obs)["obj_lock"][:, 0], 0)
    assert (np.linalg.norm(np.asarray(state.data.xpos)[ids] - place, axis=1) > 0.1).all()


@pytest.mark.slow
@pytest.mark.parametrize(("method", "free", "outer"), [*((*case, "walls") for case in LIMITS),
                                                       ("joint_range", False, "limits")])  # fmt: skip
def test_unlocked_it_moves_as_if_never_locked(method, free, outer):
    """Agents and objects, pushed and turned as far as the edge of the arena, which may be joint ranges too.

    What never was locked is stepped without the wrapper.
    """
    env, reset, step = jitted(method, free, outer)
    plain = jax.jit(env.env.step)
    fresh = spread(env, reset(seeds.key(2), env.default_params.replace(n_boxes=2, n_elongated_boxes=1)))
    state = fresh
    for _ in range(5):
        state = step(state, action(np.ones((4, 3)), 0.5))
    equal(handled(state.obs)["obj_lock"], 1)
    state = step(state, action(np.zeros((4, 3))))
    equal(handled(state.obs)["obj_lock"], 0)
    force = state.data.xfrc_applied.at[bodies(env)].set(jnp.array([24.0, 32.0, 0, 0, 0, 2.0]))
    state = state.replace(data=state.data.replace(xfrc_applied=force))
    mechanics = {name: memory for name, memory in fresh.mechanics.items() if name != env.name}
    data = state.data.replace(eq_active=fresh.data.eq_active)
    never = fresh.replace(data=data, step=state.step, mechanics=mechanics)
    start = np.asarray(state.data.xpos)[bodies(env)]
    for t in range(200):
        push = action(np.zeros((4, 3)), 1.0 if t % 20 < 10 else -0.5)
        state, never = step(state, push), plain(never, {"move": push["move"]})
        np.testing.assert_allclose(state.data.qpos, never.data.qpos, atol=1e-6)
    assert (np.linalg.norm(np.asarray(state.data.xpos)[bodies(env)] - start, axis=1) > 0.5).all()
    assert not state.metrics["physics_fault"]


def machine(lock_type, wants, near, locked, owner, team):
    """One object's next state by the published rules: whether it is locked, kept from before, and who asks for it."""
    wanting = {i for i in range(len(team)) if near[i] and wants[i]}
    against = {i for i in range(len(team)) if near[i] and not wants[i]}
    if lock_type == "any_specific":
        against &= {owner}
    if lock_type == "team":
        against = {i for i in against if team[i] == team[owner]}
    unlocks = bool(against) and not (lock_type == "any" and wanting)
    locks = bool(wanting) and (lock_type in ("any", "any_specific") or not against)
    kept = bool(locked) and not unlocks
    return kept or locks, kept, wanting


N_WORLDS, N_STEPS, REACH = 32, 40, 1.2


@pytest.fixture(scope="module")
def roaming():
    """States of up to 4 agents and 3 objects; they are the same of every lock type."""
    env, reset, _ = jitted()
    keys = jax.random.split(seeds.key(5), N_WORLDS)
    drawn = [jax.device_get(reset(key, env.default_params).replace(key=())) for key in keys]
    return jax.tree.map(lambda *x: np.stack(x), *drawn).replace(key=keys)


@pytest.mark.slow
@pytest.mark.parametrize("lock_type", LOCK_TYPES)
def test_locks_over_time(lock_type, roaming):
    """Agents roam among objects and change their minds; nearness is recomputed from where all were before a step.

    Who owns a new lock is drawn: anyone who asks may, and the oracle goes on from there. It keeps the last owner of
    what was unlocked, who was agent 0 where nobody was.
    """
    env = build(lock_type=lock_type, radius=REACH, n_frames=8)
    _ = env.base.model
    team = env.base.agents.team_index
    rng = seeds.rng(3)
    wants = (rng.random((N_STEPS // 2, N_WORLDS, 4, 3)) < 0.6).repeat(2, axis=0)
    moves = rng.choice([-1.0, 0.0, 1.0], (N_STEPS // 5, N_WORLDS, 4, 3)).repeat(5, axis=0) * [1, 1, 0.1]

    @jax.jit
    def play(states, moves, wants):
        def step(states, action):
            after = jax.vmap(env.step)(states, action)
            obs = {name: x[..., 0] for name, x in handled(after.obs).items()}
            return after, (states.data.qpos, after.mechanics["locks"], obs, after.metrics["physics_fault"])

        return jax.lax.scan(step, states, {"move": moves, "lock": wants})[1]

    qpos, locks, obs, faults = jax.device_get(play(roaming, moves, wants))
    assert not faults.any()
    modules = [env.base.modules[name] for name in ("box", "ramp")]
    present = np.concatenate([roaming.world.active[m.kind] for m in modules], axis=1)
    extents = np.concatenate([jax.jit(jax.vmap(m.extents_of))(roaming.world) for m in modules], axis=1)
    playing = np.asarray(roaming.world.active["agent"])
    at, to = qpos[..., env.base.agents.qpos_ids], qpos[..., np.concatenate([m.qpos_ids for m in modules])]
    gap = at[..., :, None, :3] - to[..., None, :, :3]
    cos, sin = np.cos(to[..., None, :, 3]), np.sin(to[..., None, :, 3])
    local = np.stack([cos * gap[..., 0] + sin * gap[..., 1], cos * gap[..., 1] - sin * gap[..., 0], gap[..., 2]], -1)
    distance = np.linalg.norm(np.maximum(np.abs(local) - extents[None, :, None] / 2, 0), axis=-1)
    unsure = (np.abs(distance - REACH) < 1e-4).any(axis=2)
    near = (distance <= REACH) & present[:, None] & playing[..., None]
    locked, owner = np.zeros((N_WORLDS, 3), bool), np.zeros((N_WORLDS, 3), int)
    new = let_go = latched = objected = changed_hands = 0
    for t, w, k in itertools.product(range(N_STEPS), range(N_WORLDS), range(3)):
        was, last = locked[w, k], owner[w, k]
        now, kept, asking = machine(lock_type, wants[t, w, :, k], near[t, w, :, k], was, last, team)
        if unsure[t, w, k]:
            now, kept = locks.locked[t, w, k], locks.owner[t, w, k] == last
        case = (t, w, k)
        assert locks.locked[case] == now, case
        if now and not kept:
            assert locks.last_owner[case] in asking or unsure[case], case
            np.testing.assert_allclose(locks.pose[case][:4], to[case], atol=1e-6)
            owner[w, k] = locks.last_owner[case]
            new += 1
        locked[w, k] = now
        assert locks.last_owner[case] == owner[w, k], case
        assert locks.owner[case] == (owner[w, k] if now else -1), case
        assert obs["obj_lock"][case] == now, case
        equal(obs["you_lock"][t, w, :, k], [now and playing[w, i] and i == owner[w, k] for i in range(4)])
        equal(obs["team_lock"][t, w, :, k], [now and playing[w, i] and team[i] == team[owner[w, k]] for i in range(4)])
        let_go += was and not now
        latched += now and not near[t, w, :, k].any()
        changed_hands += was and now and not kept
        objected += not was and last > 1 and bool(asking) and not now
    assert unsure.sum() < 20
    assert min(new, let_go, latched) > 50
    assert (changed_hands > 5) == (lock_type == "any_specific")
    if lock_type == "team":
        assert objected > 5, "seekers that owned it last object to a new lock"


@pytest.mark.parametrize("method", ["equality", "joint_range"])
def test_the_file_of_a_locked_world_moves_as_it_does(method):
    """Locked objects are pushed and turned, so that the file without their locks would move otherwise."""
    env, reset, step = jitted(method)
    state = step(reset(seeds.key(2)), action(np.ones((4, 3))))
    locked = np.asarray(handled(state.obs)["obj_lock"])[:, 0] > 0
    assert locked.any()
    force = np.zeros(state.data.xfrc_applied.shape, np.float32)
    force[bodies(env)[locked]] = [0.6 * PUSH, 0.8 * PUSH, 0, 0, 0, TWIST]
    state = state.replace(data=state.data.replace(xfrc_applied=jnp.asarray(force)))
    model, data = in_plain_mujoco(env, state)
    data.xfrc_applied[:] = force
    for _ in range(50):
        state = step(state, action(np.ones((4, 3)), 0.7))
        data.ctrl[:] = np.where(np.repeat(np.asarray(state.world.active["agent"]), 3), 0.7, 0.0)
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, state.data.qpos, atol=1e-5)


def test_only_what_is_near_and_present_is_locked(locking):
    env = build(radius=0.25, lock_type="any")
    reset, step = jax.jit(env.reset), jax.jit(env.step)
    agents, box = env.base.agents, env.base.modules["box"]
    extents_of, seen = jax.jit(box.extents_of), []
    for seed in range(40):
        start = reset(seeds.key(seed))
        extents = np.asarray(extents_of(start.world))[0]
        gap = seeds.rng(seed).uniform(0.16, 0.35)
        centre = np.asarray(start.data.qpos)[box.qpos_ids[0]]
        at = centre[:2] + np.array([extents[0] / 2 + gap, 0])
        qpos = np.array(start.data.qpos)
        qpos[agents.qpos_ids[0, :2]] = at
        state = start.replace(data=posed(env)(start.world.fields, start.data.replace(qpos=qpos)))
        state = step(state, action(np.array([[1, 0, 0]] + [[0, 0, 0]] * 3)))
        assert bool(handled(state.obs)["obj_lock"][0, 0]) == (gap <= 0.25) or abs(gap - 0.25) < 1e-3
        seen.append(gap <= 0.25)
        if gap <= 0.25:
            equal(handled(state.obs)["you_lock"][:, 0, 0], [1, 0, 0, 0])
            equal(handled(state.obs)["team_lock"][:2, 0, 0], [1, 1])
            assert not np.asarray(handled(state.obs)["team_lock"])[2:].any()
            assert int(state.mechanics["locks"].owner[0]) == 0
        assert not np.asarray(state.mechanics["locks"].locked)[~np.asarray(
            np.concatenate([state.world.active["box"], state.world.active["ramp"]]))].any()  # fmt: skip
    assert 0.1 < np.mean(seen) < 0.9


@pytest.mark.slow
def test_all_at_once_and_owners_are_drawn_among_those_who_want(locking):
    env = build(per_object=False, lock_type="any")
    worlds = maax.Worlds(env, 400)
    params = env.default_params.replace(n_seekers=2)
    states = worlds.reset(seeds.key(0), params)
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
        (lambda: build("joint_range", free=True), "the free joints of box have none; takes 'equality'"),
        (
            lambda: maax.LockObjects(maax.TeamMembership(maax.make("standard")), ["boxs"]),
            "objects: got 'boxs'; did you mean 'box'",
        ),
    ],
)
def test_mistakes(call, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call()
    assert message in str(error.value)
