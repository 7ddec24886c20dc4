"""The published games, `published=True`: where things start, against rejection sampling in NumPy, and what it sets."""

from __future__ import annotations

import json
import os
from dataclasses import fields, replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.benchmarks import published as begun
from maax_mjx.benchmarks import published_oracle as oracle
from maax_mjx.benchmarks.published_oracle import FULL, QUADRANT, G
from maax_mjx.cli import main
from maax_mjx.tasks.food import FoodConfig
from maax_mjx.tasks.published import as_published
from maax_mjx.wrappers import find

N = int(os.environ.get("MAAX_TEST_WORLDS", 1_500))
"""Worlds of ours, a multiple of 500."""
N_ORACLE = 2 * N
P_MIN = 1e-4
"""The p-value of a whole table, by Bonferroni: its smallest one times their number."""
GAMES = [QUADRANT, FULL]


# --- where things start ----------------------------------------------------------------------------------------


@cache
def made(game, published=True):
    return maax.make(game, impl="c", published=published)


@cache
def starts(game, published=True, n=N):
    """How worlds of ours begin."""
    return begun.starts(made(game, published), game, n, seeds.key(0))


@cache
def published(game):
    """How the published code's worlds begin."""
    return oracle.starts(seeds.rng(1), game, N_ORACLE)


def p_values(ours, theirs):
    """Of every statistic: that of two-sample Kolmogorov-Smirnov tests, and of chi-square tests for counts."""
    ours, theirs = oracle.statistics(ours), oracle.statistics(theirs)
    assert set(ours) == set(theirs)
    return {name: begun.p_value(ours[name], theirs[name]) for name in ours}


@pytest.mark.slow
@pytest.mark.parametrize("game", GAMES)
def test_worlds_begin_as_published(game):
    """Counts, areas of rooms, doors, places, distances of team-mates, and doorways."""
    found = p_values(starts(game), published(game))
    worst = min(found, key=found.get)
    assert found[worst] * len(found) > P_MIN, (worst, found[worst])
    assert len(found) == {QUADRANT: 22, FULL: 73}[game]


@pytest.mark.slow
@pytest.mark.parametrize("game", GAMES)
def test_nothing_starts_where_the_published_code_never_tries(game):
    """To the cell, where a distribution of hundreds would not tell one cell from the next."""
    worlds, none = starts(game), np.zeros(2)
    first = oracle.lowest(worlds.agent)
    for kind, sizes in (("agent", oracle.AGENT), ("box", worlds.sizes), ("ramp", oracle.RAMP)):
        place = getattr(worlds, kind)
        sizes = np.broadcast_to(sizes, place.shape)
        for i in range(place.shape[1]):
            there = ~np.isnan(place[:, i, 0])
            rows = zip(oracle.lowest(place[there, i]), sizes[there, i], first[there], strict=True)
            for cell, size, agents in rows:
                anchor = agents[i - 1] if kind == "agent" and i % 2 else none
                ranges = oracle.ranges_of(game, kind, i, size, anchor)
                assert any(all(a <= c < b for c, (a, b) in zip(cell, r, strict=True)) for r in ranges), (kind, i, cell)


@pytest.mark.slow
def test_what_starts_in_doorways():
    """In a quarter of the full game's worlds with doors: long boxes, agents in a fortieth; nothing else fits there."""
    worlds = starts(FULL)
    with_doors = ~np.isnan(worlds.doorways).all(axis=(1, 2))
    shares = {}
    for kind in ("agent", "box", "ramp"):
        others = {other: np.full_like(getattr(worlds, other), np.nan) for other in ("agent", "box", "ramp")}
        alone = replace(worlds, **others | {kind: getattr(worlds, kind)})
        assert not oracle.in_doorway(alone)[~with_doors].any()
        shares[kind] = oracle.in_doorway(alone)[with_doors].mean()
    assert shares == pytest.approx({"agent": 0.025, "box": 0.22, "ramp": 0}, abs=0.06)
    assert 0 < shares["agent"] < 0.06
    assert shares["ramp"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("game", GAMES)
def test_by_default_things_start_elsewhere(game):
    """Not in doorways; at the edges, up to the wall of the quadrant, and team-mates in a disc of 0.5 m."""
    worlds = starts(game, published=False)
    assert not oracle.in_doorway(worlds).any()
    ends = oracle.lowest(worlds.ramp) + oracle.cells_of(oracle.RAMP)
    if game == QUADRANT:
        assert ends.max() == G - 1, "beside the outer wall"
        assert (oracle.lowest(worlds.box) + oracle.cells_of(oracle.CUBE))[..., 1].max() == G // 2
    else:
        assert np.nanmin(oracle.lowest(worlds.ramp)[~worlds.closed]) == 0
        assert ends[~worlds.closed].max() == G
        mates = np.linalg.norm(worlds.agent[:, 1::2] - worlds.agent[:, ::2], axis=-1)
        assert mates.max() <= 0.5
        assert np.linalg.norm(starts(game).agent[:, 1::2] - starts(game).agent[:, ::2], axis=-1).max() > 0.8
    found = p_values(worlds, published(game))
    assert min(found.values()) < 1e-9


# --- what is set -----------------------------------------------------------------------------------------------

FIELDS = {
    "arms": True, "inertial_reach": True, "in_doorways": True, "may_leave": True, "placement_tries": 10,
    "cone_between": "corners", "lidar.capped": False, "lock.method": "joint_range", "lock.soft": True,
    "grab.soft": True, "world_params.iterations": 100,
}  # fmt: skip
PLACED = {
    QUADRANT: {
        "hider_placement": "published_uniform", "seeker_placement": "published_outside_quad",
        "box_placement": "published_quad", "ramp_placement": "published_uniform",
    },
    FULL: {
        "hider_placement": "published_team", "seeker_placement": "published_team",
        "box_placement": "published_uniform", "ramp_placement": "published_uniform",
    },
}  # fmt: skip
DEFAULTS = {
    "arms": False, "inertial_reach": False, "in_doorways": False, "may_leave": False, "placement_tries": None,
    "cone_between": "centres", "lidar.capped": True, "lock.method": "equality", "lock.soft": False,
    "grab.soft": False, "world_params.iterations": 20,
}  # fmt: skip


def built(env):
    """The fields of an environment that have a published form, as it was built."""
    lock, grab = find(env, maax.LockObjects)._slots, find(env, maax.GrabObjects)._slots
    base = env.base
    return {
        "arms": base.agents.arms,
        "inertial_reach": base.modules["ramp"].inertial_reach,
        "in_doorways": base.modules["walls"].in_doorways,
        "may_leave": base.may_leave,
        "placement_tries": base.placement_tries,
        "cone_between": find(env, maax.LineOfSight).between,
        "lidar.capped": find(env, maax.Lidar).capped,
        "lock.method": lock.method,
        "lock.soft": lock.soft,
        "grab.soft": grab.soft,
        "world_params.iterations": base.model.opt.iterations,
    }


@pytest.mark.parametrize("game", GAMES)
def test_published_is_all_the_fields_by_hand(game):
    """No more and no less; and the default has none of them."""
    by_hand = maax.config_of(game, published=True, **FIELDS, **PLACED[game])
    assert as_published(maax.config_of(game, published=True)) == by_hand
    assert as_published(by_hand) == by_hand
    assert built(made(game)) == FIELDS
    assert built(made(game, published=False)) == DEFAULTS
    assert not FIELDS.items() & DEFAULTS.items()


def test_what_is_given_stays_as_it_is_given():
    config = as_published(
        maax.config_of("hide_and_seek_full", published=True, placement_tries=3, ramp_placement="centre",
                       **{"world_params.iterations": 7, "grab": None})
    )  # fmt: skip
    assert (config.placement_tries, config.world_params.iterations) == (3, 7)
    assert config.lock.soft
    assert config.grab is None
    assert config.ramp_placement == "centre"


@pytest.mark.parametrize("task", ["lock_and_return", "sequential_lock", "blueprint", "shelter"])
def test_transfer_tasks_take_the_same_details(task):
    env = maax.make(task, impl="c", published=True)
    assert built(env) == FIELDS
    assert built(maax.make(task, impl="c")) == DEFAULTS
    assert as_published(maax.config_of(task, published=True)).agent_placement == "published_uniform"


def test_rooms_are_those_of_the_published_code():
    """By name, alone or in a list; functions stay."""
    ramps = as_published(maax.config_of("sequential_lock", published=True).completed()).ramp_placement
    assert ramps == ["published_room0", "published_room1", "published_room2"]
    config = as_published(
        maax.config_of("lock_all", published=True, scenario="tri", box_placement="middle").completed()
    )
    assert config.agent_placement == "published_rooms_in_turn"
    assert config.box_placement == "middle"
    assert as_published(maax.config_of("lock_all", scenario="tri").completed()).agent_placement == "rooms_in_turn"


def test_published_food_is_eaten_from_the_corner():
    fed = "hide_and_seek_food"
    assert maax.config_of(fed).food.between == "centres"
    assert as_published(maax.config_of(fed, published=True)).food.between == "corners"
    assert find(maax.make(fed, impl="c", published=True), maax.EatFood).between == "corners"


@pytest.mark.parametrize("game", GAMES)
def test_the_model_is_the_published_one(game):
    """Welds and joint ranges with MuJoCo's softness, arms that collide, 100 iterations."""
    model = made(game).base.model
    assert set(model.eq_type.tolist()) == {1}, "welds"
    boxes = [model.joint(f"box0:{name}").id for name in ("x", "y", "z", "yaw")]
    assert model.jnt_limited[boxes].all()
    soft = np.array([0.9, 0.95, 0.001, 0.5, 2])
    for solref, solimp in ((model.eq_solref, model.eq_solimp), (model.jnt_solref[boxes], model.jnt_solimp[boxes])):
        assert (solref == [0.02, 1]).all()
        assert (solimp == soft).all()
    assert model.geom("agent3:hand_left").contype[0] == 1
    assert model.opt.iterations == 100


def anywhere(layout, cells):
    return jnp.ones((G, G))


def built_without(config):
    env = maax.make(FULL, config, impl="c", published=True, food=None)
    return [kind for kind in (maax.LockObjects, maax.Lidar, maax.GrabObjects) if find(env, kind) is None]


def test_what_is_left():
    """Parts that are left out, placements that the published code does not have, numbers, and food."""
    own = {
        "hider_placement": anywhere, "box_placement": "centre", "ramp_placement": "middle",
        "lock": None, "lidar": None, "food": FoodConfig(), "n_boxes": (4, 9), "n_hiders": (1, 3), "grab.radius": 0.4,
    }  # fmt: skip
    given = maax.config_of(FULL, published=True, **own)
    config = as_published(given)
    assert config.seeker_placement == "published_team"
    assert config.grab == replace(given.grab, soft=True)
    assert config.world_params == replace(given.world_params, iterations=100)
    changed = {f.name for f in fields(config) if getattr(config, f.name) != getattr(given, f.name)}
    assert changed == {name.split(".")[0] for name in FIELDS} - {"lock", "lidar"} | {"seeker_placement", "food"}
    assert config.food == replace(given.food, between="corners")
    assert built_without(given) == [maax.LockObjects, maax.Lidar]


@pytest.mark.parametrize("game", ["hide_and_seek", "tag", "standard"])
def test_other_games_were_not_published(game):
    with pytest.raises(ValueError, match=rf"make\('{game}'\): got 'published'; takes one of \["):
        maax.make(game, published=True)


def test_published_is_yes_or_no():
    with pytest.raises(ValueError, match="published: got 1; takes True or False"):
        maax.make(FULL, published=1)


def test_the_command_takes_it(capsys):
    main(["info", QUADRANT, "--env.published", "True", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["fields"]["published"] is True
    main(["info", QUADRANT, "--json"])
    assert json.loads(capsys.readouterr().out)["fields"]["published"] is False


# --- on the way ------------------------------------------------------------------------------------------------


@cache
def stepped(game, published=True):
    env = made(game, published)
    return env, jax.jit(jax.vmap(env.reset)), jax.jit(jax.vmap(env.step)), jax.jit(jax.vmap(env.base.engine.pose))


def still(env, n):
    return {name: np.zeros((n, *env.action_space[name].shape), int) + 5 * (name == "move") for name in env.action_space}


@pytest.mark.slow
@pytest.mark.parametrize("published", [True, False])
def test_an_agent_may_leave_the_arena(published):
    """1 m outside, below the floor, above the walls: it goes on and pays; by default such worlds are cut off."""
    env, reset, step, pose = stepped(QUADRANT, published)
    states = reset(jax.random.split(seeds.key(0), 5))
    x, y, z, _ = env.base.agents.qpos_ids[0]
    qpos = np.array(states.data.qpos)
    qpos[0, x], qpos[1, y], qpos[2, x], qpos[2, z], qpos[3, z] = -1.0, 7.0, -1.0, -2.0, 3.5
    states = states.replace(data=pose(states.world.fields, states.data.replace(qpos=jnp.asarray(qpos))))
    states = step(states.replace(step=jnp.full(5, 40)), still(env, 5))
    away = np.array([True, True, True, True, False]) & (not published)
    np.testing.assert_array_equal(states.metrics["physics_fault"], away)
    np.testing.assert_array_equal(states.truncated, away)
    if published:
        np.testing.assert_array_equal(np.asarray(states.reward)[:, 0] < -8, [True, True, True, False, False])
        broken = states.replace(data=states.data.replace(qvel=states.data.qvel.at[1].set(np.nan)))
        np.testing.assert_array_equal(
            step(broken, still(env, 5)).metrics["physics_fault"], [False, True, False, False, False]
        )


@cache
def few(impl):
    """A small game of the published kind: two hiders who see, hold and lock, and arms that touch."""
    env = maax.make(
        QUADRANT, impl=impl, published=True, n_seekers=0, n_boxes=2, n_ramps=0, n_frames=5, observations="raw",
        stats=False, rect=None,
    )  # fmt: skip
    return env, jax.jit(env.reset)(seeds.key(3)), jax.jit(env.step)


@cache
def first_steps(impl):
    """Positions after each of four steps in which one box is carried and the other is locked, and what is sensed."""
    env, state, step = few(impl)
    base, qpos = env.base, np.array(state.data.qpos)
    agents, boxes = (base.modules[name].qpos_ids for name in ("agent", "box"))
    qpos[agents[:, :2]] = [[1.0, 1.45], [1.355, 1.45]]
    qpos[boxes[:, :2]] = [[1.0, 1.0], [1.62, 0.98]]
    state = state.replace(data=jax.jit(base.engine.pose)(state.world.fields, state.data.replace(qpos=qpos)))
    state = jax.jit(find(env, maax.LineOfSight).observe)(state)
    action = {"move": np.array([[3, 7, 5], [5, 6, 5]]), "grab": np.array([1, 0]), "lock": np.array([0, 1])}
    trail = []
    for _ in range(4):
        state = step(state, action)
        trail.append(np.asarray(state.data.qpos))
    mechanics = state.mechanics["grabs"].held, state.mechanics["locks"].locked
    return np.array(trail), jax.device_get(mechanics), jax.device_get(state.obs)


@pytest.mark.slow
@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_engines_take_the_same_first_steps(impl):
    """As `c` does: 20 physics steps of a carried box, a locked one, and two agents whose arms press."""
    if impl == "warp":
        pytest.importorskip("warp")
    (trail, (held, locked), obs), (ours, mechanics, sensed) = first_steps("c"), first_steps(impl)
    np.testing.assert_array_equal(held, [0, -1])
    np.testing.assert_array_equal(locked, [False, True])
    np.testing.assert_array_equal(mechanics[0], held)
    np.testing.assert_array_equal(mechanics[1], locked)
    np.testing.assert_allclose(ours, trail, atol=1e-3)
    np.testing.assert_allclose(sensed["lidar"], obs["lidar"], atol=1e-2)
