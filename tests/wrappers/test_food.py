"""Eating against an oracle in plain Python, with a `Script` in place of the physics."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import food_oracle, seeds
from helpers.chance import P_MIN
from scipy import stats

import maax_mjx as maax

N_WORLDS, N_STEPS, N_FOOD, PREP = 24, 60, 4, 20
TEAMS = np.array([0, 0, 0, 1, 1])
HIDERS = TEAMS == 0
NOWHERE = np.array([-9.0, -9.0, 0.15], np.float32)
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


class Script(maax.Wrapper):
    """Starts from one of given worlds, by its key; agents are then where the action says, and have its reward."""

    def __init__(self, env, starts):
        super().__init__(env)
        self.starts = starts

    def begin(self, key, params):
        return jax.tree.map(lambda x: x[jax.random.key_data(key)[-1] % len(x)], self.starts)

    def transition(self, state, action):
        agents, at = self.base.agents, action["at"]
        data = state.data.replace(
            xpos=state.data.xpos.at[agents.body_ids].set(at), qpos=state.data.qpos.at[agents.qpos_ids[:, :3]].set(at)
        )
        able = state.world.active["agent"]
        return state.replace(data=data, reward=action["reward"], step=state.step + 1, can_act=able)


@functools.cache
def script():
    """1 to 3 hiders, 1 or 2 seekers and 1 to 4 pieces near each other."""
    base = maax.Base(len(TEAMS), impl="c", horizon=100)
    base.add_module(maax.WallScenarios("empty"))
    base.add_module(maax.Agents({"hiders": (1, 3), "seekers": (1, 2)}))
    base.add_module(maax.Food((1, N_FOOD), placement_fn=maax.middle_placement(0.2)))
    starts = jax.jit(jax.vmap(base.reset))(jax.random.split(seeds.key(0), N_WORLDS))
    return maax.TeamMembership(Script(base, starts))


def begun(env, n=N_WORLDS):
    return jax.jit(jax.vmap(env.reset))(jax.vmap(jax.random.key)(seeds.seed(0) + jnp.arange(n)))


def around(states, radius, between):
    """(worlds, steps, agents, 3) places: beside a slot of food, or where nothing is.

    None is as far from a piece as the radius, to what float32 can tell.
    """
    rng, food = seeds.rng(1), np.float64(states.world.sites["food"])
    shape = (N_WORLDS, N_STEPS, len(TEAMS))
    piece = food[np.arange(N_WORLDS)[:, None, None], rng.integers(N_FOOD, size=shape)]
    way = rng.normal(size=(*shape, 3))
    way *= (rng.uniform(0, 1.5 * radius, shape) / np.linalg.norm(way, axis=-1))[..., None]
    at = np.where(rng.random(shape)[..., None] < 0.8, piece + way, NOWHERE).astype(np.float32)
    unclear = np.abs(food_oracle.distances(at, food[:, None], between) - radius) < 1e-5
    return np.where(unclear.any(axis=-1)[..., None], NOWHERE, at)


def played(env, radius=0.5, between="centres"):
    """The states at reset, what the script says, and the states after all steps (worlds, steps, ...)."""
    states, rng = begun(env), seeds.rng(2)
    told = {
        "at": around(states, radius, between),
        "eat": (rng.random((N_WORLDS, N_STEPS, len(TEAMS), N_FOOD)) < 0.7).astype(np.int8),
        "reward": rng.normal(size=(N_WORLDS, N_STEPS, len(TEAMS))).astype(np.float32),
    }

    def step(state, action):
        state = env.advance(state, action)  # without the check of the action
        return state, {"obs": state.obs, "reward": state.reward, "metrics": state.metrics}

    run = jax.jit(jax.vmap(lambda state, told: jax.lax.scan(step, state, told)[1]))
    return jax.device_get(states.replace(key=())), told, jax.device_get(run(states, told))


def wanted(start, at, eat, max_health, radius=0.5, respawn_steps=None, rew_type="selfish", split=False,
           between="centres"):  # fmt: skip
    """What the oracle has: health before and after every step, units that everyone ate, and rewards for them."""
    there, playing = start.world.active["food"], start.world.active["agent"]
    asked = (food_oracle.distances(at, start.world.sites["food"][:, None], between) < radius) & (eat > 0)
    asked &= playing[:, None, :, None]
    before, health, units, own = (np.zeros((N_WORLDS, N_STEPS, *more)) for more in ((4,), (4,), (5, 4), (5,)))
    for w in range(N_WORLDS):
        table = food_oracle.Table(there[w], max_health, respawn_steps, split)
        for t in range(N_STEPS):
            before[w, t] = table.health
            eaten = table.step(asked[w, t])
            health[w, t], units[w, t] = table.health, np.array(eaten, float)
            own[w, t] = food_oracle.rewards(eaten, rew_type, TEAMS, playing[w])
    return before, health, units, own


CASES = {
    "one's own, back after 4 steps": {"max_health": 3, "respawn_steps": 4},
    "the team's, never back": {"max_health": 7, "rew_type": "team_mean", "scale": 0.5},
    "from corners": {"max_health": 3, "between": "corners"},
    "units shared, away for a step": {"max_health": 2, "respawn_steps": 1, "split": True, "scale": 2},
    "of a drawn scale": {
        "max_health": 5, "radius": 0.8, "respawn_steps": 6, "rew_type": "team_mean", "scale": (0.5, 2.0),
        "observe_scale": True,
    },
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_health_and_rewards_are_the_oracles(case):
    """At every step; and all that can happen does."""
    options = dict(CASES[case])
    radius, between = options.get("radius", 0.5), options.get("between", "centres")
    start, told, after = played(maax.EatFood(script(), **options), radius, between)
    observed, scale = options.pop("observe_scale", False), np.array(options.pop("scale", 1))
    assert ("food_scale" in after["obs"]) == observed
    if observed:
        scale = after["obs"]["food_scale"]
        equal(scale, np.broadcast_to(start.obs["food_scale"][:, None], scale.shape))
    before, health, units, own = wanted(start, told["at"], told["eat"], **options)
    there, playing = start.world.active["food"], start.world.active["agent"]
    equal(start.obs["food_health"][..., 0], there * options["max_health"])
    equal(after["obs"]["food_health"][..., 0], health)
    close(after["reward"], told["reward"] + scale * own, atol=2e-5)
    equal((after["reward"] - told["reward"]).swapaxes(1, 2)[~playing], 0)

    near = food_oracle.distances(told["at"], start.world.sites["food"][:, None], between) < radius
    near &= told["eat"] > 0
    happened = {
        "eaten": units > 0,
        "several pieces at once": (units > 0).sum(axis=-1) > 1,
        "shared": (units > 0) & (units < 1),
        "empty": (before > 0) & (health == 0),
        "asked for and empty": near & (before == 0)[:, :, None] & there[:, None, None],
        "absent food": near & ~there[:, None, None] & playing[:, None, :, None],
        "absent agents": near & there[:, None, None] & ~playing[:, None, :, None],
    }
    assert all(what.any() for what in happened.values()), {name: what.sum() for name, what in happened.items()}
    assert ((before == 0) & (health > 0)).any() == ("respawn_steps" in options)


def test_food_at_the_radius_is_too_far():
    """In three dimensions; the same place but for the last bit is near enough."""
    env = maax.EatFood(script(), radius=0.5, max_health=9)
    state = begun(env, 1)
    sites = jnp.asarray([[[2.0, 2.0, 0.0625], *[[5.0, 5.0, 0.0625]] * (N_FOOD - 1)]])
    active = state.world.active | {"agent": jnp.ones((1, 5), bool)}
    world = state.world.replace(sites=state.world.sites | {"food": sites}, active=active)
    at = [[2.5, 2, 0.0625], [np.nextafter(np.float32(2.5), 0), 2, 0.0625], [2, 1.5, 0.0625], [2, 2, 0.5625]]
    at = jnp.asarray([[*at, [2.3, 2.3, 0.4]]], jnp.float32)
    action = {"at": at, "eat": jnp.ones((1, 5, N_FOOD), jnp.int8), "reward": jnp.zeros((1, 5))}
    after = jax.jit(jax.vmap(env.advance))(state.replace(world=world), action)
    equal(after.reward[0], [0, 1, 0, 0, 0])
    equal(after.obs["food_health"][0, 0], 8)


@pytest.mark.parametrize("split", [False, True])
def test_nothing_is_left_of_the_last_bite(split):
    """However many share it, and whatever was left: not even what float32 rounds off."""
    n = 12
    base = maax.Base(n, impl="c")
    base.add_module(maax.WallScenarios("empty"))
    base.add_module(maax.Agents(n))
    base.add_module(maax.Food(1))
    shapes = jax.eval_shape(base.reset, jax.random.key(0)).replace(key=jax.random.key(0))
    start = jax.tree.map(
        lambda x: x if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else jnp.zeros(x.shape, x.dtype), shapes
    )
    ones = {"agent": jnp.ones(n, bool), "food": jnp.ones(1, bool)}
    start = start.replace(world=start.world.replace(active=start.world.active | ones), can_act=ones["agent"])
    env = maax.EatFood(Script(base, jax.tree.map(lambda x: x[None], start)), max_health=n, split=split)
    state = env.begin(jax.random.key(0), env.default_params)

    def left(eaters, health):
        meals = state.mechanics["eat_food"].replace(health=health[None].astype(jnp.float32))
        action = {
            "at": jnp.zeros((n, 3)),
            "reward": jnp.zeros(n),
            "eat": (jnp.arange(n) < eaters)[:, None].astype(jnp.int8),
        }
        after = env.advance(state.replace(mechanics=state.mechanics | {"eat_food": meals}), action)
        return after.obs["food_health"][0, 0], after.reward

    eaters, health = (x.ravel() for x in np.meshgrid(np.arange(1, n + 1), np.arange(1, n + 1)))
    got, rewards = jax.jit(jax.vmap(left))(eaters, health)
    taken = np.minimum(1 if split else eaters, health)
    equal(got, health - taken)
    close(rewards, (np.arange(n) < eaters[:, None]) * (taken / eaters)[:, None], atol=1e-6)


def test_every_episode_draws_its_scale():
    """Evenly from the range; and where nobody is told of it, it is the same."""
    low, high = 0.5, 2.0
    env, unseen = (maax.EatFood(script(), scale=(low, high), observe_scale=told) for told in (True, False))
    scales = np.asarray(begun(env, 1_000).obs["food_scale"])
    assert scales.shape == (1_000, 1)
    assert stats.kstest(scales[:, 0], "uniform", (low, high - low)).pvalue > P_MIN
    state = begun(unseen)
    at = np.broadcast_to(state.world.sites["food"][:, :1], (N_WORLDS, 5, 3))
    eat = np.zeros((N_WORLDS, 5, N_FOOD), np.int8)
    eat[..., 0] = 1
    after = jax.jit(jax.vmap(unseen.advance))(state, {"at": at, "eat": eat, "reward": np.zeros((N_WORLDS, 5))})
    close(after.reward, scales[:N_WORLDS] * np.asarray(state.world.active["agent"]), atol=1e-6)
    assert "food_scale" not in after.obs


# --- who eats, and when ----------------------------------------------------------------------------------------


def in_preparation():
    return maax.EatFood(maax.PreparationPhase(script(), PREP / 100), max_health=4, respawn_steps=3)


@pytest.mark.parametrize("masked", [False, True])
def test_food_in_the_preparation_phase(masked):
    """It is paid for, where no mask forbids to eat, and counted apart; the rewards inside are not there."""
    env = maax.MaskPreparationAction(in_preparation(), "eat") if masked else in_preparation()
    start, told, after = played(maax.TrackStats(env))
    preparing = np.arange(N_STEPS) < PREP
    at, eat = told["at"].copy(), told["eat"].copy()
    at[:, :PREP, ~HIDERS] = 0  # the phase zeroes all that seekers do
    eat[:, :PREP] *= not masked
    _, health, units, own = wanted(start, at, eat, 4, respawn_steps=3)
    equal(after["obs"]["food_health"][..., 0], health)
    close(after["reward"], told["reward"] * ~preparing[:, None] + own, atol=2e-5)
    eaten = units.sum(axis=(2, 3)).cumsum(axis=1)
    close(after["metrics"]["food_eaten"], eaten, atol=1e-3)
    at_end = np.where(np.arange(1, N_STEPS + 1) < PREP, 0, eaten[:, PREP - 1 : PREP])
    close(after["metrics"]["food_eaten_prep"], at_end, atol=1e-3)
    equal([start.metrics[name] for name in ("food_eaten", "food_eaten_prep")], 0)
    assert (eaten[:, PREP - 1] > 0).any() != masked
    assert (eaten[:, -1] > eaten[:, PREP - 1]).any()


def test_who_cannot_act_does_not_eat():
    """As seekers in the preparation phase, whose choice the wrapper takes before the phase can zero it."""
    env = maax.EatFood(script())
    state = begun(env)
    at = np.broadcast_to(state.world.sites["food"][:, :1], (N_WORLDS, 5, 3))
    action = {"at": at, "eat": np.ones((N_WORLDS, 5, N_FOOD), np.int8), "reward": np.zeros((N_WORLDS, 5))}
    after = jax.jit(jax.vmap(env.advance))(state.replace(can_act=state.can_act & HIDERS), action)
    eats = np.asarray(after.reward) > 0
    equal(eats, np.asarray(state.world.active["agent"]) & HIDERS)


def test_a_team_that_always_eats_what_it_may():
    """The choice is gone; masks between say what it gets."""
    inside = maax.EatFood(script(), max_health=9, respawn_steps=2)
    env = maax.AlwaysEat(maax.MaskActions(inside, "eat", lambda state: (jnp.arange(5) + state.step) % 3 > 0), "hiders")
    start, told, after = played(env)
    may = ((np.arange(5) + np.arange(N_STEPS)[:, None]) % 3 > 0) & HIDERS
    eat = np.broadcast_to(may[..., None], told["eat"].shape)
    _, health, units, own = wanted(start, told["at"], eat, 9, respawn_steps=2)
    equal(after["obs"]["food_health"][..., 0], health)
    close(after["reward"], told["reward"] + own, atol=2e-5)
    assert (units.sum(axis=(0, 1, 3)) > 5).tolist() == HIDERS.tolist()


def test_who_always_eats():
    env = maax.EatFood(script())
    assert env.action_space["eat"].shape == (5, N_FOOD)
    assert env.acts_on == {"eat": (("food", N_FOOD),)}
    state, action = maax.world_of(begun(env), 0), {"move": np.ones((5, 3), np.float32)}
    for team, slots in {None: HIDERS | ~HIDERS, 0: HIDERS, 1: ~HIDERS, "hiders": HIDERS, "seekers": ~HIDERS}.items():
        always = maax.AlwaysEat(env, team)
        assert set(always.action_space.spaces) == {"move"}
        assert always.acts_on == {}
        told = always.action(state, action)
        equal(told["eat"], slots[:, None] * np.ones(N_FOOD))
        equal(told["move"], action["move"])


def test_an_action_is_masked_in_the_preparation_phase_alone():
    env = maax.MaskPreparationAction(in_preparation(), "eat")
    assert env.action_space == env.env.action_space
    state, rng = maax.world_of(begun(env), 0), seeds.rng(3)
    action = {"move": rng.normal(size=(5, 3)), "eat": rng.integers(1, 3, (5, N_FOOD))}
    for step in (0, 1, PREP - 1, PREP, PREP + 1, 99):
        told = env.action(state.replace(step=np.int32(step)), action)
        equal(told["eat"], action["eat"] * (step >= PREP))
        equal(told["move"], action["move"])


def test_what_is_told_of_food():
    observed = maax.EatFood(script(), observe_scale=True, max_health=30)
    assert {k: observed.observation_space[k].shape for k in ("food_health", "food_scale")} == {
        "food_health": (N_FOOD, 1), "food_scale": (1,),
    }  # fmt: skip
    assert observed.observed["food_health"].axes == ("food",)
    assert observed.observed["food_health"].present == "food_mask"
    assert set(maax.EatFood(script()).observation_space) == set(observed.observation_space) - {"food_scale"}


# --- mistakes --------------------------------------------------------------------------------------------------


def without_teams():
    return script().env


ERRORS = {
    "no food": (lambda e: maax.EatFood(maax.make("standard", impl="c")), "without Food; EatFood takes one with Food"),
    "radius": (lambda e: maax.EatFood(e, radius=0), "radius: got 0; takes a positive number"),
    "health": (lambda e: maax.EatFood(e, max_health=0), "max_health: got 0"),
    "half a unit": (lambda e: maax.EatFood(e, max_health=1.5), "max_health: got 1.5"),
    "respawn": (lambda e: maax.EatFood(e, respawn_steps=0), "respawn_steps: got 0"),
    "reward": (lambda e: maax.EatFood(e, rew_type="joint_mean"), "rew_type: got 'joint_mean'; did you mean"),
    "scale": (lambda e: maax.EatFood(e, scale=(2.0, 1.0)), "scale: got (2.0, 1.0)"),
    "below zero": (lambda e: maax.EatFood(e, scale=-1), "scale: got -1"),
    "split": (lambda e: maax.EatFood(e, split=1), "split: got 1; takes True or False"),
    "observe": (lambda e: maax.EatFood(e, observe_scale="no"), "observe_scale: got 'no'; takes True or False"),
    "no teams": (lambda e: maax.EatFood(without_teams(), rew_type="team_mean"), "EatFood: needs TeamMembership"),
    "twice": (lambda e: maax.EatFood(maax.EatFood(e)), "EatFood: env has a wrapper named 'eat_food' already"),
    "always nothing": (maax.AlwaysEat, "AlwaysEat: needs EatFood; wrap with it first"),
    "nobody": (
        lambda e: maax.AlwaysEat(maax.EatFood(e), "cooks"),
        "team: got 'cooks'; takes one of ['hiders', 'seekers'], or its number",
    ),
    "no third team": (lambda e: maax.AlwaysEat(maax.EatFood(e), 2), "team: got 2; takes one of ['hiders', 'seekers']"),
    "a team without teams": (
        lambda e: maax.AlwaysEat(maax.EatFood(without_teams()), "hiders"),
        "AlwaysEat: needs TeamMembership",
    ),
    "always twice": (
        lambda e: maax.AlwaysEat(maax.AlwaysEat(maax.EatFood(e))),
        "AlwaysEat: env has a wrapper named 'always_eat' already",
    ),
    "masked too late": (
        lambda e: maax.MaskActions(maax.AlwaysEat(maax.EatFood(e)), "eat", lambda state: state.active),
        "action: got 'eat'; takes one of ['move']",
    ),
    "phase outside": (
        lambda e: maax.PreparationPhase(maax.EatFood(e)),
        "PreparationPhase: env has EatFood already; wrap with PreparationPhase before it",
    ),
    "statistics inside": (
        lambda e: maax.EatFood(maax.TrackStats(e)),
        "EatFood: env has TrackStats already; wrap with EatFood before it",
    ),
    "phase of another action": (
        lambda e: maax.MaskPreparationAction(maax.PreparationPhase(e), "eat"),
        "action: got 'eat'; takes one of ['move']",
    ),
    "no phase": (lambda e: maax.MaskPreparationAction(e, "move"), "MaskPreparationAction: needs PreparationPhase"),
    "phase after bins": (
        lambda e: maax.MaskPreparationAction(maax.DiscretizeActions(maax.PreparationPhase(e)), "move"),
        "MaskPreparationAction: env has DiscretizeActions already",
    ),
}


@pytest.mark.parametrize(("call", "message"), ERRORS.values(), ids=ERRORS)
def test_mistakes(call, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call(script())
    assert message in str(error.value)
