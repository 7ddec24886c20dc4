"""Hide and seek with food: who eats what and when, where food lies, and what agents are told of it."""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import food_oracle, layers, seeds, transfer_oracle
from helpers.chance import P_MIN
from scipy import stats

import maax_mjx as maax
from maax_mjx.tasks import observed_by_agents
from maax_mjx.wrappers import find

N, STEPS, PREP, N_FOOD = 36, 23, 8, 4
TEAMS = np.array([0, 0, 1, 1])
HIDERS = TEAMS == 0
MAX_HEALTH, AWAY, RADIUS, SCALE = 3, 3, 0.5, 0.25
CELL, G = 0.2, 30
OPEN = {
    "scenario": "empty", "n_boxes": 0, "n_elongated_boxes": 0, "n_ramps": 0, "lock": None, "grab": None, "lidar": None,
    "observations": "raw", "n_bins": None,
}  # fmt: skip
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


@functools.cache
def env_of(when_caught):
    food = {"max_health": MAX_HEALTH, "respawn_steps": AWAY, "scale": SCALE, "when_caught": when_caught}
    return maax.make(
        "hide_and_seek_food", impl="c", **OPEN, n_hiders=(1, 2), n_seekers=(1, 2), n_frames=4, horizon=STEPS + 1,
        prep_fraction=PREP / (STEPS + 1), **{f"food.{name}": value for name, value in food.items()},
    )  # fmt: skip


def posed(env, states):
    """Everyone beside a piece of food, and looking there, at a hider, or elsewhere."""
    rng, agents = seeds.rng(0), env.base.agents
    qpos, food = np.array(states.data.qpos), np.asarray(states.world.sites["food"])
    for w in range(N):
        first = rng.uniform(0, 2 * np.pi)
        for agent in range(4):
            if not states.world.active["agent"][w, agent]:
                continue
            away = rng.uniform(0.3, 0.45) if w % 2 or agent < 2 else 1.2
            turn = first + [0, np.pi, np.pi / 2, -np.pi / 2][agent]
            out = np.array([np.cos(turn), np.sin(turn)])
            looks = rng.choice([0, np.pi]) if agent < 2 else [0, np.pi, np.pi, np.pi][w % 4]
            yaw = turn + np.pi - looks + np.pi / 2
            qpos[w, agents.qpos_ids[agent]] = [*(food[w, agent, :2] + away * out), 0.15, yaw]
    data = jax.vmap(env.base.engine.pose)(states.world.fields, states.data.replace(qpos=jnp.asarray(qpos)))
    return states.replace(data=data)


@functools.cache
def played(when_caught):
    """The states at first, posed, and after all steps (steps, worlds, ...), in which agents turn about."""
    env = env_of(when_caught)
    start = posed(env, jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(0), N)))
    rng = seeds.rng(1)
    move = np.repeat(rng.uniform(-1, 1, (STEPS // 4 + 1, N, 4, 3)), 4, axis=0)[:STEPS] * [0.2, 0.2, 0.6]

    def step(state, move):
        state = jax.vmap(env.step)(state, {"move": move})
        kept = {name: getattr(state, name) for name in ("obs", "reward", "metrics")}
        return state, kept | {"qpos": state.data.qpos[:, env.base.agents.qpos_ids[:, :3]]}

    run = jax.jit(lambda state, moves: jax.lax.scan(step, state, moves)[1])
    return jax.device_get((start.replace(key=()), run(start, jnp.asarray(move, jnp.float32))))


@pytest.mark.slow
@pytest.mark.parametrize("when_caught", [False, True])
def test_hiders_eat_what_they_see_after_preparation_and_unseen(when_caught):
    """What is left, what is paid, and how much was eaten, at every step; all cases occur."""
    start, after = played(when_caught)
    obs, there = after["obs"], start.world.active["agent"]
    health, own, units = np.zeros((STEPS, N, N_FOOD)), np.zeros((STEPS, N, 4)), np.zeros((STEPS, N))
    clear = np.ones((STEPS, N), bool)
    happened = dict.fromkeys(("eaten", "emptied", "back", "preparing", "unseen food", "caught", "seekers"), 0)
    for w in range(N):
        table = food_oracle.Table(np.ones(N_FOOD, bool), MAX_HEALTH, AWAY)
        for t in range(STEPS):
            away = food_oracle.distances(after["qpos"][t, w], start.world.sites["food"][w])
            near = (away < RADIUS) & there[w, :, None]
            clear[t:, w] &= (np.abs(away - RADIUS) > 1e-5).all()
            seen = obs["sees_food"][t - 1, w] if t else np.zeros((4, N_FOOD), bool)
            caught = t > 0 and obs["sees_agent"][t - 1, w][np.ix_(~HIDERS, HIDERS)].any()
            may = t >= PREP and (when_caught or not caught)
            before = np.array(table.health)
            eaten = table.step(near & seen & HIDERS[:, None] & may)
            health[t, w], units[t, w] = table.health, np.array(eaten, float).sum()
            own[t, w] = food_oracle.rewards(eaten, "team_mean", TEAMS, there[w])
            could = near & (before > 0)
            happened["eaten"] += units[t, w] > 0
            happened["emptied"] += ((before > 0) & (health[t, w] == 0)).sum()
            happened["back"] += ((before == 0) & (health[t, w] > 0)).sum()
            happened["preparing"] += t < PREP and (could & seen)[HIDERS].any() and not caught
            happened["unseen food"] += may and (could & ~seen)[HIDERS].any()
            happened["caught"] += t >= PREP and (could & seen)[HIDERS].any() and caught
            happened["seekers"] += may and (could & seen)[~HIDERS].any()
    assert clear.mean() > 0.9
    equal(obs["food_health"][..., 0][clear], health[clear])
    caught = obs["sees_agent"][:, :, ~HIDERS][..., HIDERS].any(axis=(2, 3))
    game = np.where(caught[..., None], -1.0, 1.0) * np.where(HIDERS, 1, -1) * there
    game[:PREP] = 0
    close(after["reward"][clear], (game + SCALE * own)[clear], atol=1e-5)
    close(after["metrics"]["food_eaten"][clear], units.cumsum(axis=0)[clear], atol=1e-4)
    assert not after["metrics"]["food_eaten_prep"].any()
    assert not own[..., ~HIDERS].any()
    assert all(happened.values()), happened


# --- where food lies -------------------------------------------------------------------------------------------


def cells_of(env, n, key):
    """The lowest cells (n, n_food, 2) of the food of many worlds, which takes one each, and the worlds."""
    worlds = jax.device_get(jax.jit(jax.vmap(lambda key: env.base.reset(key).world))(jax.random.split(key, n)))
    assert worlds.valid.mean() > 0.97
    return np.floor(worlds.sites["food"][..., :2] / CELL).astype(int)[worlds.valid], worlds


def in_the_middle(cells):
    low, high = transfer_oracle.middle_cells(0.25, 1)
    return ((cells >= low) & (cells <= high)).all()


def near(cells, first, radius):
    """Whether each of cells (..., 2) is one of those that the published code draws near another."""
    r = int(np.ceil(radius / CELL))
    return (cells >= np.maximum(first - r, 1)) & (cells <= np.minimum(first + r, G - 1) - 1)


@pytest.mark.slow
def test_groups_lie_around_their_first_pieces():
    """Evenly over the cells there, but for the one that is taken; the first ones in the middle."""
    food = maax.FoodConfig(n_food=6, n_clusters=2)
    options = OPEN | {"n_hiders": 1, "n_seekers": 1, "hider_placement": "uniform", "seeker_placement": "uniform"}
    cells, _ = cells_of(maax.make("hide_and_seek", impl="c", cone=2.0, food=food, **options), 1_500, seeds.key(1))
    for first in (0, 3):
        assert in_the_middle(cells[:, first])
        assert near(cells[:, first + 1 : first + 3], cells[:, first, None], food.together_radius).all()
    assert np.ptp(cells[:, 0], axis=0).min() > 3, "the first is anywhere there"
    assert (np.abs(cells[:, 3] - cells[:, 0]).max(axis=1) > 2).any(), "the second group has a place of its own"
    offsets = cells[:, 1] - cells[:, 0]
    counts = np.zeros((4, 4))
    np.add.at(counts, tuple((offsets + 2).T), 1)
    assert counts[2, 2] == 0
    assert stats.chisquare(np.delete(counts.ravel(), 10)).pvalue > P_MIN


def test_without_a_radius_all_lie_like_the_first():
    options = OPEN | {"food.together_radius": None, "food.n_food": 3}
    cells, _ = cells_of(maax.make("hide_and_seek_food", impl="c", **options), 200, seeds.key(2))
    assert in_the_middle(cells)
    assert (np.abs(cells[:, 1:] - cells[:, :1]).max(axis=(1, 2)) > 2).any()


def test_food_is_in_the_quadrant_where_there_is_one():
    food = maax.FoodConfig(n_food=4, n_clusters=2)
    cells, worlds = cells_of(maax.make("hide_and_seek_quadrant", impl="c", food=food), 64, seeds.key(3))
    quadrant = worlds.plan.quadrant[worlds.valid][:, None]
    first = cells[:, ::2]
    assert ((first >= quadrant[..., :2]) & (first < quadrant[..., 2:])).all()
    assert near(cells[:, 1::2], first, food.together_radius).all()
    assert np.ptp(first[:, 0], axis=0).min() > 3


def test_a_placement_of_ones_own():
    env = maax.make("hide_and_seek_food", impl="c", **OPEN, **{"food.placement": "uniform", "food.n_clusters": 2})
    assert [fn.__name__ for fn in env.base.modules["food"].placement_fns] == [
        "uniform_placement", "published_proximity_placement(0.25, 'food0')",
        "uniform_placement", "published_proximity_placement(0.25, 'food2')",
    ]  # fmt: skip


# --- configs ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def game():
    return maax.make("hide_and_seek_food", impl="c")


def test_the_published_numbers(game):
    eats = find(game, maax.EatFood)
    assert (eats.radius, eats.max_health, eats.respawn_steps, eats.rew_type) == (0.5, 40, 5, "team_mean")
    assert (eats.scale, eats.split, eats.observe_scale) == ((1.0, 1.0), False, False)
    other = find(
        maax.make("hide_and_seek_food", impl="c", **{"food.split": True, "food.observe_scale": True}), type(eats)
    )
    assert (other.split, other.observe_scale) == (True, True)
    config = maax.FoodConfig()
    assert (config.n_clusters, config.together_radius, config.when_caught, config.placement) == (1, 0.25, False, None)
    full = maax.config_of("hide_and_seek_full")
    mine = maax.config_of("hide_and_seek_food")
    assert {f.name for f in dataclasses.fields(mine) if getattr(mine, f.name) != getattr(full, f.name)} == {"food"}


def test_without_food_it_is_the_published_game(game):
    full = maax.make("hide_and_seek_full", impl="c")
    without = maax.make("hide_and_seek_food", impl="c", food=None)
    assert without.action_space == full.action_space == game.action_space
    assert without.observation_space == full.observation_space
    assert [type(layer) for layer in without.layers] == [type(layer) for layer in full.layers]
    assert list(without.base.modules) == list(full.base.modules)
    more = {"food_health", "food_mask", "food_pos", "sees_food"}
    assert set(game.observation_space) == set(full.observation_space) | more
    assert not more & set(full.observation_space)


def test_overrides_reach_what_is_built():
    numbers = {
        "n_food": 3,
        "radius": 0.7,
        "max_health": 9,
        "respawn_steps": None,
        "rew_type": "selfish",
        "scale": (1, 2),
    }
    env = maax.make("hide_and_seek_food", impl="c", **OPEN, **{f"food.{name}": x for name, x in numbers.items()})
    eats = find(env, maax.EatFood)
    assert env.base.modules["food"].n_max == env.observation_space["food_health"].shape[0] == numbers.pop("n_food")
    assert {name: getattr(eats, name) for name in numbers} == numbers


# --- what agents are told --------------------------------------------------------------------------------------


@functools.cache
def told(observations):
    """Food in the worlds that are played, half of it seen, as agents observe it: (before, after, the environment)."""
    raw, (start, _) = env_of(False), played(False)
    rng, env = seeds.rng(4), observed_by_agents(env_of(False), observations)
    obs = start.obs | {
        "sees_food": rng.random((N, 4, N_FOOD)) < 0.5,
        "food_health": rng.integers(1, MAX_HEALTH + 1, (N, N_FOOD, 1)).astype(np.float32),
    }
    start = start.replace(obs=jax.tree.map(jnp.asarray, obs))
    after = jax.jit(jax.vmap(layers.observing(env, raw)))(start)
    return obs, jax.device_get(after.obs), start, env


def test_raw_and_split_observations_of_food():
    assert {"food_health", "food_pos", "food_mask", "sees_food"} <= set(env_of(False).observation_space)
    obs, got, start, _ = told("split")
    playing = np.asarray(start.world.active["agent"])
    for name in ("food_health", "food_pos", "food_mask"):
        equal(got[name][playing], np.broadcast_to(obs[name][:, None], got[name].shape)[playing])
    equal(got["sees_food"][playing], obs["sees_food"][playing])


def test_flat_observations_hide_food_that_is_not_seen():
    obs, got, start, env = told("flat")
    columns = list(env.observed["obs"].names())
    shows = obs["sees_food"] & np.asarray(start.world.active["agent"])[..., None]
    values = np.concatenate([obs["food_health"], obs["food_pos"]], axis=-1)
    for piece in range(N_FOOD):
        names = [f"food_health[{piece}] health", *(f"food_pos[{piece}] {axis}" for axis in "xyz")]
        mine = got["obs"][..., [columns.index(name) for name in names]]
        equal(mine, np.where(shows[:, :, piece, None], values[:, None, piece], 0))


def test_food_in_the_agents_frames():
    """In scales of 3 m, and of a whole piece."""
    obs, got, start, env = told("ego")
    qpos = np.asarray(start.data.qpos)[:, env.base.agents.qpos_ids]
    way = obs["food_pos"][:, None, :, :2] - qpos[:, :, None, :2]
    turn = (qpos[..., 3] - np.pi / 2)[..., None]
    ahead = way[..., 0] * np.cos(turn) + way[..., 1] * np.sin(turn)
    left = way[..., 1] * np.cos(turn) - way[..., 0] * np.sin(turn)
    assert env.observed["food_pos"].names() == ("ahead", "to the left", "distance", "z")
    playing = np.asarray(start.world.active["agent"])
    close(got["food_pos"][playing][..., :2] * 3, np.stack([ahead, left], axis=-1)[playing], atol=1e-4)
    health = np.broadcast_to(obs["food_health"][:, None], (N, 4, N_FOOD, 1)) / MAX_HEALTH
    close(got["food_health"][playing], health[playing], atol=1e-6)


# --- mistakes --------------------------------------------------------------------------------------------------

ERRORS = {
    "no sight": ("hide_and_seek", {"food": maax.FoodConfig()}, "cone: got None in a game with food; takes an angle"),
    "sight left out": ("hide_and_seek_food", {"cone": None}, "cone: got None in a game with food; takes an angle"),
    "nobody eats": ("hide_and_seek_food", {"n_hiders": 0}, "n_hiders: got 0 in a game with food; takes hiders"),
    "too many together": (
        "hide_and_seek_food",
        {"food.n_food": 20},
        "food.n_food: got 20 pieces in a group with together_radius=0.25, which has 16 cells",
    ),
    "groups": (
        "hide_and_seek_food",
        {"food.n_clusters": 3},
        "food.n_clusters: got 3 for n_food=4; takes a number of groups that are equally large",
    ),
    "more groups than food": ("hide_and_seek_food", {"food.n_clusters": 8}, "food.n_clusters: got 8 for n_food=4"),
    "no food": ("hide_and_seek_food", {"food.n_food": 0}, "food.n_food: got 0; takes a whole number of at least 1"),
    "field": ("hide_and_seek_food", {"food.n_fod": 3}, "got 'n_fod'; did you mean 'n_food'"),
    "placement": ("hide_and_seek_food", {"food.placement": "nowhere"}, "food.placement: got 'nowhere'; takes one of"),
    "reward": ("hide_and_seek_food", {"food.rew_type": "both"}, "food.rew_type: got 'both'; takes one of"),
    "radius": ("hide_and_seek_food", {"food.together_radius": 0}, "food.together_radius: got 0; takes a positive"),
    "no group": ("hide_and_seek_food", {"food": 4}, "food: got 4; takes a FoodConfig, or None"),
}


@pytest.mark.parametrize(("name", "options", "message"), ERRORS.values(), ids=ERRORS)
def test_mistakes(name, options, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        maax.make(name, impl="c", **options)
    assert message in str(error.value)


def test_worlds_without_a_quadrant_have_it_around_the_middle():
    """Where a batch has both, and where the quadrant's size is drawn."""
    env = maax.make("hide_and_seek_quadrant", impl="c", scenario=("var_quad", "half"), food=maax.FoodConfig(n_food=1))
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(9), 200))
    x, y = np.asarray(states.world.sites["food"])[:, 0, :2].T
    x0, y0, x1, y1 = (np.asarray(states.world.plan.quadrant) * 0.2).T
    has = x1 > 0
    assert 50 < has.sum() < 150
    assert ((x0 < x) & (x < x1) & (y0 < y) & (y < y1))[has].all()
    assert (np.abs(np.stack([x, y])[:, ~has] - 3) < 1).all()
