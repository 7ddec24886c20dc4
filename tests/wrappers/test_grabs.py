"""Grabs against plain Python and NumPy written from the rules, and how firmly what is held follows its holder."""

from __future__ import annotations

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
from maax_mjx.wrappers.grabs.rules import grab_rule

equal, close = np.testing.assert_array_equal, np.testing.assert_allclose
RADIUS, N_WORLDS = 0.25, 64


def truth(candidate, distance, exclusive):
    """Who holds what: everyone the nearest of its candidates; or the nearest pair of all first, one agent each."""
    n_agents, n_objects = candidate.shape
    pairs = [(distance[i, j], i, j) for i in range(n_agents) for j in range(n_objects) if candidate[i, j]]
    held, taken = [-1] * n_agents, set()
    for _, i, j in sorted(pairs):
        if held[i] < 0 and not (exclusive and j in taken):
            held[i] = j
            taken.add(j)
    return held


@pytest.mark.parametrize("exclusive", [False, True])
@pytest.mark.parametrize(("n_agents", "n_objects"), [(2, 2), (2, 3), (3, 2), (3, 3), (4, 5)])
def test_rule(n_agents, n_objects, exclusive):
    """Every candidate matrix of the small ones, 500 random ones of the largest; distances are random."""
    rng = seeds.rng(n_agents * 10 + n_objects)
    if n_agents == 4:
        candidates = rng.random((500, n_agents, n_objects)) < rng.choice([0.2, 0.5, 0.9], (500, 1, 1))
    else:
        every = list(itertools.product([False, True], repeat=n_agents * n_objects))
        candidates = np.array(every).reshape(-1, n_agents, n_objects)
    distances = rng.uniform(0, 1, candidates.shape).astype(np.float32)
    if n_agents == 4:
        distances[250:] = distances[250:].round(1)  # the first agent and the first object go first among equals
    rule = jax.jit(jax.vmap(lambda candidate, distance: grab_rule(candidate, distance, exclusive)))
    held = np.asarray(rule(candidates, distances))
    assert held.dtype == np.int32
    equal(held, [truth(c, d, exclusive) for c, d in zip(candidates, distances, strict=True)])
    assert (held == -1).any()
    assert (held == n_objects - 1).any()


# --- what is within reach ------------------------------------------------------------------------------------------


def distance_to_rectangle(point, centre, yaw, half):
    """Metres from a point to a turned rectangle in the plane: to the nearest of its sides, 0 inside."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    corners = [centre + turn @ (half * sign) for sign in ([1, 1], [-1, 1], [-1, -1], [1, -1])]
    inside, nearest = True, np.inf
    for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
        side, to = b - a, point - a
        inside &= side[0] * to[1] - side[1] * to[0] >= 0
        nearest = min(nearest, np.linalg.norm(to - np.clip(to @ side / (side @ side), 0, 1) * side))
    return 0.0 if inside else nearest


@pytest.mark.parametrize(("selective", "exclusive"), [(True, False), (False, True)])
def test_the_nearest_within_reach_is_held(selective, exclusive):
    """Turned elongated boxes and ramps, present or not, around agents, present or not, that move at full force.

    It counts where all were at the beginning of the step; at its end they are centimetres away.
    """
    env = maax.Base(4, impl="c", n_frames=5)
    env.add_module(maax.Agents({"hiders": (1, 2), "seekers": (0, 2)}))
    env.add_module(maax.Boxes((1, 3), n_elongated_boxes=(0, 3)))
    env.add_module(maax.Ramps((0, 1)))
    env = maax.GrabObjects(env, selective=selective, exclusive=exclusive)
    assert env.action_space["grab"].shape == ((4, 4) if selective else (4,))
    start = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(0), N_WORLDS))
    agents, modules = env.base.agents, [env.base.modules[name] for name in ("box", "ramp")]
    ids = np.concatenate([m.qpos_ids for m in modules])
    here = np.asarray(start.world.active["agent"])
    there = np.concatenate([np.asarray(start.world.active[m.kind]) for m in modules], axis=1)
    half = np.concatenate([np.asarray(jax.vmap(m.extents_of)(start.world)) for m in modules], axis=1)[..., :2] / 2

    @jax.jit
    @jax.vmap
    def step(state, qpos, action):
        state = state.replace(data=env.base.engine.pose(state.world.fields, state.data.replace(qpos=qpos)))
        state = env.step(state, action)
        return state.mechanics["grabs"].held, state.obs

    shared = taken_away = ties = 0
    for seed in range(4):
        rng = seeds.rng(seed)
        qpos = np.array(start.data.qpos)
        for columns, height in ((agents.qpos_ids, 0.15), (ids, 0.25)):
            qpos[:, columns[:, :2]] = 3 + rng.uniform(-1.2, 1.2, (N_WORLDS, 4, 2))
            qpos[:, columns[:, 2]] = height
            qpos[:, columns[:, 3]] = rng.uniform(-np.pi, np.pi, (N_WORLDS, 4))
        wants = rng.random((N_WORLDS, 4, 4) if selective else (N_WORLDS, 4)) < 0.8
        move = rng.choice([-1.0, 1.0], (N_WORLDS, 4, 3)).astype(np.float32)
        held, obs = step(start, jnp.asarray(qpos), {"move": move, "grab": wants})
        held, obs = np.asarray(held), jax.device_get(obs)
        for w in range(N_WORLDS):
            at, to = qpos[w, agents.qpos_ids], qpos[w, ids]
            gap = np.array(
                [[distance_to_rectangle(a[:2], o[:2], o[3], h) for o, h in zip(to, half[w], strict=True)] for a in at]
            )
            wanted = wants[w] if selective else wants[w][:, None]
            candidate = wanted & (gap <= RADIUS) & here[w][:, None] & there[w]
            some = gap[candidate]
            if (np.abs(gap - RADIUS) < 1e-4).any() or (np.diff(np.sort(some)) < 1e-4).any():
                ties += 1  # as where an agent is inside of two boxes at once
                continue
            want = truth(candidate, gap, exclusive)
            equal(held[w], want)
            mine = held[w][:, None] == np.arange(4)
            equal(handled(obs)["you_pull"][w, :, :, 0], mine)
            equal(handled(obs)["obj_pull"][w, :, 0], mine.any(axis=0))
            alone = truth(candidate, gap, False)
            shared += (mine.sum(axis=0) > 1).any()
            taken_away += want != alone
    assert ties < 2 * N_WORLDS
    assert (shared > 3) == (not exclusive)
    assert (taken_away > 3) == exclusive


# --- how it is held ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[False, True], ids=["slides", "free"])
def carrying(request):
    """One or two agents and a box in a room: the environment, 8 worlds of each, `pose` and `step` of batches."""
    env = maax.Base(2, impl="c")
    env.add_module(maax.WallScenarios("empty"))
    env.add_module(maax.Agents({"hiders": 1, "seekers": (0, 1)}))
    env.add_module(maax.Boxes(1, free=request.param))
    env = maax.GrabObjects(env, ["box"])
    reset = jax.jit(jax.vmap(env.reset, in_axes=(0, None)))
    start = [reset(jax.random.split(seeds.key(0), 8), env.default_params.replace(n_seekers=n)) for n in (0, 1)]
    return env, start, jax.jit(jax.vmap(env.base.engine.pose)), jax.jit(jax.vmap(env.step))


def gripping(carrying, gap, n_seekers=0):
    """8 worlds with the box in the middle, and at `gap` metres from its left face an agent, from its right another."""
    env, start, pose, _ = carrying
    state = start[n_seekers]
    agents, box = env.base.agents.qpos_ids, env.base.modules["box"].qpos_ids[0]
    qpos = np.array(state.data.qpos)
    qpos[:, box[:2]] = 3.0
    qpos[:, agents[0, :2]] = 3.0 - 0.25 - gap, 3.05
    if n_seekers:
        qpos[:, agents[1, :2]] = 3.0 + 0.25 + gap, 2.95
    return state.replace(data=pose(state.world.fields, state.data.replace(qpos=jnp.asarray(qpos))))


def run(carrying, state, moves, grab):
    """The state after steps with forces `moves`, and over these (t, 8, ...): qpos of agents, pose of the box, holds."""
    env, _, _, step = carrying
    box, grab = env.base.modules["box"].body_ids[0], jnp.broadcast_to(jnp.asarray(grab), (8, 2))
    seen = []
    for move in moves:
        move = jnp.broadcast_to(jnp.asarray(move, jnp.float32), (8, 2, 3))
        state = step(state, {"move": move, "grab": grab})
        seen.append((state.data.qpos, state.data.xpos, state.data.xquat, state.mechanics["grabs"].held))
    qpos, xpos, xquat, held = (np.array(x) for x in zip(*jax.device_get(seen), strict=True))
    assert not state.metrics["physics_fault"].any()
    yaw = 2 * np.arctan2(xquat[:, :, box, 3], xquat[:, :, box, 0])
    return state, qpos[:, :, env.base.agents.qpos_ids], np.concatenate([xpos[:, :, box, :2], yaw[..., None]], -1), held


def relative(agents, box, i=0):
    """(t, 8, 3): where the box is as agent `i` sees it: x, y, yaw."""
    at = agents[:, :, i]
    to, cos, sin = box[..., :2] - at[..., :2], np.cos(at[..., 3]), np.sin(at[..., 3])
    turned = (box[..., 2] - at[..., 3] + np.pi) % (2 * np.pi) - np.pi
    return np.stack([cos * to[..., 0] + sin * to[..., 1], cos * to[..., 1] - sin * to[..., 0], turned], axis=-1)


@pytest.mark.slow
def test_what_is_held_follows(carrying):
    """Full forces along x and y that change every 20 steps, for 600 steps, against walls too."""
    state = gripping(carrying, 0.2)
    moves = np.zeros((600, 8, 2, 3))
    moves[:, :, 0, :2] = seeds.rng(0).choice([-1.0, 1.0], (30, 8, 2)).repeat(20, axis=0)
    _, agents, box, held = run(carrying, state, moves, [1, 1])
    equal(held, np.broadcast_to([0, -1], held.shape))
    errors = relative(agents, box) - [0.45, -0.05, 0.0]
    off = np.linalg.norm(errors[..., :2], axis=-1) * 1e3
    assert np.median(off) < 15, "mm"
    assert np.quantile(off, 0.99) < 80, "mm"
    assert np.degrees(np.abs(errors[..., 2])).max() < 12
    assert (np.linalg.norm(np.diff(agents[:, :, 0, :2], axis=0), axis=-1).sum(axis=0) > 5).all(), "metres"


def test_the_file_of_a_carrying_world_moves_as_it_does(carrying):
    env, _, _, step = carrying
    state, *_ = run(carrying, gripping(carrying, 0.2), np.tile([[1, 0.5, 0], [0, 0, 0]], (30, 1, 1)), [1, 0])
    model, data = in_plain_mujoco(env, state, world=3)
    assert data.eq_active.any()
    begun = data.qpos.copy()
    move = np.broadcast_to(np.float32([[-1, 0.5, 0.1], [0, 0, 0]]), (8, 2, 3))
    for _ in range(50):
        state = step(state, {"move": move, "grab": np.tile([1, 0], (8, 1))})
        data.ctrl[:] = move[0].ravel()
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, state.data.qpos[3], atol=1e-5)
    assert np.abs(data.qpos - begun).max() > 0.3


def test_what_is_released_stays(carrying):
    state, _, held_box, held = run(carrying, gripping(carrying, 0.2), np.zeros((10, 2, 3)), [1, 0])
    equal(held[-1], [[0, -1]] * 8)
    _, agents, box, held = run(carrying, state, np.tile([[-0.5, 0, 0], [0, 0, 0]], (60, 1, 1)), [0, 0])
    equal(held[-1], [[-1, -1]] * 8)
    assert np.abs(box - held_box[-1])[..., :2].max() < 1e-3
    assert (relative(agents, box)[-1, :, 0] > 0.45 + 0.3).all()


def test_what_is_held_turns_along(carrying):
    """Around the agent, which turns slowly."""
    _, agents, box, _ = run(carrying, gripping(carrying, 0.2), np.tile([[0, 0, 0.15], [0, 0, 0]], (400, 1, 1)), [1, 0])
    errors = np.abs(relative(agents, box) - [0.45, -0.05, 0.0]).max(axis=(0, 1))
    assert (agents[-1, :, 0, 3] > np.pi / 2).all()
    assert errors[:2].max() < 0.02
    assert np.degrees(errors[2]) < 3


def test_two_hold_one(carrying):
    """Both at once: when they pull it apart it stays, when they go the same way it goes along with both."""
    state = gripping(carrying, 0.2, n_seekers=1)
    state, agents, box, held = run(carrying, state, np.tile([[-1, 0, 0], [1, 0, 0]], (60, 1, 1)), [1, 1])
    equal(held, np.zeros_like(held))
    equal(handled(state.obs)["you_pull"], np.ones((8, 2, 1, 1)))
    equal(handled(state.obs)["obj_pull"], np.ones((8, 1, 1)))
    assert np.abs(box[..., :2] - 3).max() < 0.005
    _, agents, box, _ = run(carrying, state, np.tile([[0, 1, 0], [0, 1, 0]], (60, 1, 1)), [1, 1])
    assert (box[-1, :, 1] > 3.5).all()
    for i, want in enumerate(([0.45, -0.05], [-0.45, 0.05])):
        assert np.abs(relative(agents, box, i)[..., :2] - want).max() < 0.02


# --- with teams, locks, vision and preparation ---------------------------------------------------------------------

PREP = 4


@pytest.fixture(scope="module")
def game():
    """2 hiders, a seeker and 2 boxes on an open floor; only what is seen is locked or grabbed, object by object."""
    env = maax.Base(3, impl="c", horizon=1000)
    env.add_module(maax.Agents({"hiders": 2, "seekers": 1}))
    env.add_module(maax.Boxes(2))
    env = maax.LineOfSight(maax.TeamMembership(env), objects=["box"])
    env = maax.LockObjects(env, ["box"], "any", in_vision_only=True)
    env = maax.GrabObjects(env, ["box"], selective=True, in_vision_only=True)
    env = maax.PreparationPhase(env, PREP / 1000)
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(0), 32))
    pose = jax.jit(jax.vmap(env.base.engine.pose))

    def place(states, agents, boxes):
        """The states with agents (32, 3, 3) and boxes (32, 2, 3) at x, y, yaw."""
        qpos = np.array(states.data.qpos)
        for name, poses in (("agent", agents), ("box", boxes)):
            qpos[:, env.base.modules[name].qpos_ids[:, [0, 1, 3]]] = poses
        return states.replace(data=pose(states.world.fields, states.data.replace(qpos=jnp.asarray(qpos))))

    return env, states, place, jax.jit(jax.vmap(env.step))


def order(move=0.0, lock=0, grab=0):
    """Everyone's action in 32 worlds, from what broadcasts to it."""
    return {
        "move": jnp.broadcast_to(jnp.asarray(move, jnp.float32), (32, 3, 3)),
        "lock": jnp.broadcast_to(jnp.asarray(lock, jnp.int32), (32, 3, 2)),
        "grab": jnp.broadcast_to(jnp.asarray(grab, jnp.int32), (32, 3, 2)),
    }


FACING = {"+x": np.pi / 2, "-x": -np.pi / 2}
BOXES = [[2.0, 3.0, 0.0], [4.0, 3.0, 0.0]]
FAR = [5.0, 5.0, 0.0]


def beside(*agents):
    return np.broadcast_to(np.array(agents), (32, 3, 3)), np.broadcast_to(BOXES, (32, 2, 3))


def test_only_what_was_seen_after_the_step_before_is_held_and_locked(game):
    """Agents left of the first box facing anywhere; then turned, which they notice one step later."""
    _, start, place, step = game
    rng = seeds.rng(0)
    yaw = np.linspace(-np.pi, np.pi, 32, endpoint=False) + 0.03
    agents, boxes = (np.array(x) for x in beside([1.55, 3.0, 0.0], [5.0, 4.5, 0.0], FAR))
    agents[:, 0, 2] = rng.permutation(yaw)
    # The heading is yaw - pi / 2, the cone 135 degrees, and the box in direction +x.
    turn = (agents[:, 0, 2] - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi
    ahead = np.abs(turn) <= 3 * np.pi / 8
    assert 8 < ahead.sum() < 24
    state = step(place(start, agents, boxes), order())
    after = step(state, order(lock=1, grab=1))
    equal(after.mechanics["grabs"].held, np.stack([np.where(ahead, 0, -1), -np.ones(32), -np.ones(32)], axis=1))
    equal(after.mechanics["locks"].locked, np.stack([ahead, np.zeros(32)], axis=1))
    agents[:, 0, 2] += np.pi
    late = step(place(state, agents, boxes), order(lock=1, grab=1))
    equal(late.mechanics["grabs"].held[:, 0], np.where(ahead, 0, -1))
    turn = (turn + 2 * np.pi) % (2 * np.pi) - np.pi
    later = step(late, order(lock=1, grab=1))
    equal(later.mechanics["grabs"].held[:, 0], np.where(np.abs(turn) <= 3 * np.pi / 8, 0, -1))
    equal(later.mechanics["locks"].locked[:, 0], ahead | (np.abs(turn) <= 3 * np.pi / 8))


def test_a_locked_object_that_is_held_does_not_move(game):
    """Under both hiders' full force, sideways, forwards and backwards, with twist; unlocked, it goes along."""
    env, start, place, step = game
    poses = beside([1.55, 3.1, FACING["+x"]], [2.45, 2.9, FACING["-x"]], FAR)
    state = step(place(start, *poses), order())
    state = step(state, order(lock=1, grab=1))
    ids = env.base.modules["box"].qpos_ids[0]
    before, worst = np.asarray(state.data.qpos)[:, ids], np.zeros(2)
    rng = seeds.rng(1)
    move = np.zeros((32, 3, 3))
    move[:, :2] = rng.choice([-1.0, 1.0], (32, 1, 3)) * [1, 1, 0.2]
    for _ in range(200):
        state = step(state, order(move, 1, 1))
        equal(state.mechanics["grabs"].held, [[0, 0, -1]] * 32)
        off = np.abs(np.asarray(state.data.qpos)[:, ids] - before).max(axis=0)
        worst = np.maximum(worst, [off[:3].max(), off[3]])
    assert worst[0] < 1e-3
    assert np.degrees(worst[1]) < 0.2
    assert not state.metrics["physics_fault"].any()
    for _ in range(100):
        state = step(state, order(move, 0, 1))
    went = np.linalg.norm(np.asarray(state.data.qpos)[:, ids[:2]] - before[:, :2], axis=1)
    assert (went > 0.1).all()


def test_a_new_hold_begins_where_the_object_is(game):
    """An agent between two boxes takes one, drags it, takes the other instead, then the first again: none jumps."""
    env, start, place, step = game
    agents, boxes = beside([3.0, 3.0, FACING["+x"]], [5.0, 1.0, 0.0], FAR)
    boxes = np.array(boxes)
    boxes[:, :, :2] = [[3.3, 3.43], [3.3, 2.57]]
    state = step(place(start, agents, boxes), order())
    ids = env.base.modules["box"].qpos_ids[:, :2]

    def want(wanted, push=0.0):
        return order([[push, 0, 0]] + [[0, 0, 0]] * 2, grab=[[wanted == 0, wanted == 1]] + [[0, 0]] * 2)

    for wanted, push in ((0, -0.5), (1, -0.5), (0, 0.5), (1, 0.5)):
        here = np.asarray(state.data.qpos)[:, ids]
        for _ in range(20):
            state = step(state, want(wanted))
        equal(state.mechanics["grabs"].held[:, 0], wanted)
        jump = np.linalg.norm(np.asarray(state.data.qpos)[:, ids] - here, axis=-1).max()
        assert jump < 2e-3
        for t in range(55):  # it drags the box, or pushes it, and comes to rest
            state = step(state, want(wanted, push if t < 15 else 0.0))
        went = (np.asarray(state.data.qpos)[:, ids] - here)[:, :, 0]
        assert (went[:, wanted] * np.sign(push) > 0.02).all()


def test_seekers_do_not_grab_in_the_preparation_phase(game):
    _, start, place, step = game
    state = place(start, *beside([1.55, 3.0, FACING["+x"]], FAR, [4.45, 3.0, FACING["-x"]]))
    for t in range(PREP + 3):
        state = step(state, order(lock=1, grab=1))
        if t > 0:  # what was seen after the reset, was so before all were placed
            equal(state.mechanics["grabs"].held, [[0, -1, -1 if t < PREP else 1]] * 32)
            equal(state.mechanics["locks"].locked, [[True, t >= PREP]] * 32)


@pytest.fixture(scope="module")
def plain():
    return maax.TeamMembership(maax.make("standard", impl="c"))


def used():
    env = maax.make("standard", impl="c")
    _ = env.observation_space
    return env


ERRORS = {
    "radius": (lambda e: maax.GrabObjects(e, radius=0), "radius: got 0; takes a positive number"),
    "exclusive": (lambda e: maax.GrabObjects(e, exclusive=1), "exclusive: got 1; takes True or False"),
    "selective": (lambda e: maax.GrabObjects(e, selective="no"), "selective: got 'no'; takes True or False"),
    "vision": (lambda e: maax.GrabObjects(e, in_vision_only=None), "in_vision_only: got None; takes True or False"),
    "unknown": (
        lambda e: maax.GrabObjects(e, ["boxs"]),
        "objects: got 'boxs'; did you mean 'box'? It takes one of ['box', 'ramp']",
    ),
    "not movable": (lambda e: maax.GrabObjects(e, ["walls"]), "objects: got 'walls'; takes one of"),
    "none": (lambda e: maax.GrabObjects(e, []), "objects: got [], which hold no objects; takes others"),
    "none of them": (
        lambda e: maax.GrabObjects(maax.make("standard", impl="c", n_boxes=0), ["box"]),
        "objects: got ['box'], which hold no objects",
    ),
    "no sight": (
        lambda e: maax.GrabObjects(e, in_vision_only=True),
        "GrabObjects: needs LineOfSight; wrap with it first: GrabObjects(LineOfSight(env, ...))",
    ),
    "no sight for locks": (lambda e: maax.LockObjects(e, in_vision_only=True), "LockObjects: needs LineOfSight"),
    "sight of others": (
        lambda e: maax.GrabObjects(maax.LineOfSight(e, objects=["box"]), in_vision_only=True),
        "in_vision_only: LineOfSight does not see 'ramp'; takes what it sees, ['agent', 'box']",
    ),
    "sight of others for locks": (
        lambda e: maax.LockObjects(maax.LineOfSight(e, objects=["ramp"]), in_vision_only=True),
        "in_vision_only: LineOfSight does not see 'box'",
    ),
    "twice": (
        lambda e: maax.GrabObjects(maax.GrabObjects(maax.make("standard", impl="c"))),
        "GrabObjects: env has a wrapper named 'grabs' already",
    ),
    "grabs after preparation": (
        lambda e: maax.GrabObjects(maax.PreparationPhase(e)),
        "GrabObjects: env has PreparationPhase already; wrap with GrabObjects before it",
    ),
    "locks after preparation": (
        lambda e: maax.LockObjects(maax.PreparationPhase(e)),
        "LockObjects: env has PreparationPhase already; wrap with LockObjects before it",
    ),
}


@pytest.mark.parametrize(("call", "message"), ERRORS.values(), ids=ERRORS)
def test_mistakes(call, message, plain):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call(plain)
    assert message in str(error.value)
