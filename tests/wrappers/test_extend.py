"""Games are open: modules and layers are put in between, and a game can be looked at, copied and saved."""

from __future__ import annotations

import copy
import pickle
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.pages import BLOCKS

import maax_mjx as maax
from maax_mjx.common.observed import flag
from maax_mjx.worldgen import Geom
from maax_mjx.wrappers import find

equal = np.testing.assert_array_equal
SMALL = {"impl": "c", "n_boxes": 1, "n_ramps": 0, "lidar": None}


class Flashlight(maax.StateWrapper):
    """What agents see by, as long as its battery lasts: one unit, of which a step takes `drain`."""

    name = "flashlight"
    requires = (maax.LineOfSight,)

    def __init__(self, env, drain=0.5):
        super().__init__(env)
        self.drain = drain

    def begin(self, key, params):
        return self.observe(self.remember(self.env.begin(key, params), jnp.ones(self.n_agents)))

    def transition(self, state, action):
        left = jnp.maximum(state.mechanics[self.name] - self.drain, 0.0)
        return self.observe(self.remember(self.env.advance(state, action), left))

    def observe(self, state):
        left = state.mechanics[self.name]
        state = self.inner(maax.LineOfSight).blind(state, left <= 0)
        sight = state.mechanics["line_of_sight"]
        dark = {name: seen & (left > 0)[:, None] for name, seen in sight.items()}
        mechanics = state.mechanics | {"line_of_sight": dark}
        return state.replace(obs=state.obs | {"battery": left[:, None]}, mechanics=mechanics)

    def declared(self):
        return self.env.declared() | {"battery": maax.Observed(("agent",), flag("battery"))}


class Post(maax.Module):
    """A post that stands on the floor."""

    name = "post"

    def build_step(self, floor, grid_size):
        floor.append(Geom("box", (0.1, 0.1, 1.0), name="post"), placement_xy=(0.5, 0.5))


@pytest.fixture(scope="module")
def lit():
    return maax.make("hide_and_seek_quadrant", inside={"HideAndSeekReward": Flashlight}, **SMALL)


class Court(maax.Base):
    """A base that adds modules of its own."""

    def __init__(self):
        super().__init__(1, impl="c")
        for module in (maax.WallScenarios("empty"), maax.Agents(1), Post()):
            self.add_module(module)


def names(env):
    return [type(layer).__name__ for layer in reversed(env.layers)]


def test_a_layer_in_between_is_seen_by_those_around_it(lit):
    plain = maax.make("hide_and_seek_quadrant", **SMALL)
    assert [name for name in names(lit) if name != "Flashlight"] == names(plain)
    assert names(lit).index("Flashlight") == names(lit).index("HideAndSeekReward") - 1
    # The layers outside know it: agents get the battery as one of their own arrays.
    assert lit.observation_space["battery"].shape == (4, 1)
    assert "battery" not in plain.observation_space.spaces


def test_a_flashlight_inside_the_reward_decides_who_is_seen(lit):
    """With a battery for one step, nobody is seen after the second, so that hiders win from then on."""
    prep = find(lit, type(next(layer for layer in lit.layers if layer.name == "preparation"))).n_steps

    def play(key):
        state = lit.reset(key)
        state = state.replace(step=jnp.asarray(prep, state.step.dtype))
        still = {name: jnp.zeros(space.shape, int) for name, space in lit.action_space.spaces.items()}
        still["move"] = jnp.full_like(still["move"], 5)
        first = lit.step(state, still)
        return first, lit.step(first, still)

    first, second = jax.vmap(play)(jax.random.split(seeds.key(0), 32))
    sees = first.mechanics["line_of_sight"]["sees_agent"]
    assert bool(sees.any()), "somebody sees somebody in one of 32 worlds"
    assert not bool(second.mechanics["line_of_sight"]["sees_agent"].any())
    hiders = list(lit.teams["hiders"].slots)
    inside = ~np.asarray(second.metrics["physics_fault"])
    rewards = np.asarray(second.reward)[inside][:, hiders]
    equal(np.sign(rewards[rewards > -5]), 1)  # a penalty of 10 for leaving the floor aside


def test_modules_are_copied_into_a_game_below_its_layers():
    post = Post()
    env = maax.make("tag", impl="c", modules=[post])
    assert env.base.model.geom("post").id >= 0
    assert post._owner is None, "the module that was given is as it was"
    twin = maax.make("tag", maax.config_of(env))
    assert list(twin.base.modules) == [*maax.make("tag", impl="c").base.modules, "post"]


def test_what_is_given_stays_as_it_was():
    env = maax.make("hide_and_seek", impl="c", cone=2.0)
    before = names(env), list(env.base.modules), env.base.model.neq
    more = maax.extended(env, [Post()], outside={"locks": lambda e: maax.GrabObjects(e, objects=("box",))})
    assert (names(env), list(env.base.modules), env.base.model.neq) == before
    assert names(more).index("GrabObjects") == names(more).index("LockObjects") + 1
    assert more.base.model.neq > env.base.model.neq
    # One set of equalities for the locks, though layers were made anew.
    assert sum(name.startswith("locks") for name in more.base.modules) == 1


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"inside": {"HideAndSeekRewards": Flashlight}}, "inside: .*did you mean 'HideAndSeekReward'"),
        ({"inside": [Flashlight]}, "inside: got .*; takes a dict from names to a function or a list, each a function"),
        ({"outside": {"locks": "Flashlight"}}, "outside: got {'locks': 'Flashlight'}; takes a dict"),
        ({"outside": {"locks": lambda env: None}}, "outside: got None from .*; takes a function that"),
        ({"inside": {"LineOfSight": Flashlight}}, "Flashlight: needs LineOfSight; wrap with it first"),
        ({"outside": {"preparation": maax.LockObjects}}, "action_name: got 'lock', which env has already"),
        ({"modules": Post()}, r"modules: got Post\(\); takes a list, each a Module"),
        ({"modules": [Flashlight]}, "modules: got .*Flashlight.*; takes a list, each a Module"),
    ],
)  # fmt: skip
def test_what_cannot_be_put_in_is_refused(given, says):
    with pytest.raises(ValueError, match=says):
        maax.make("hide_and_seek_quadrant", **SMALL, **given)


@pytest.mark.usefixtures("little_garbage")
def test_a_module_after_wrappers_is_refused_with_what_to_do():
    env = maax.make("hide_and_seek", impl="c")
    with pytest.raises(ValueError, match=r"module: got Post\(\) .*LockObjects.* wraps; .*make\(name, modules"):
        env.base.add_module(Post())


def test_two_layers_of_a_class_are_told_apart_by_name():
    env = maax.TeamMembership(maax.make("standard", impl="c"))
    env = maax.LockObjects(env, objects=("box",))
    env = maax.LockObjects(env, objects=("ramp",), action_name="lock_ramp")
    with pytest.raises(ValueError, match=r"inside: got 'LockObjects', .* are 2; takes one of \['lock_ramps'"):
        maax.extended(env, inside={"LockObjects": maax.LineOfSight})
    assert names(maax.extended(env, inside={"lock_ramps": maax.LineOfSight}))[1:3] == ["LockObjects", "LineOfSight"]


@pytest.mark.slow
def test_agents_turn_the_door_of_the_page_and_light_fades():
    """The page's classes in a game of two agents; one pushes the panel's end, and it turns that way."""
    names: dict = {"__name__": "page"}
    exec(BLOCKS["layers-0"].partition("env = maax.make(")[0], names)
    modules, inside = [names["RevolvingDoor"]()], {"HideAndSeekReward": names["Flashlight"]}
    game = SMALL | {"n_boxes": 0, "lock": None, "grab": None, "n_bins": None, "observations": "raw"}
    game |= {"n_hiders": 1, "n_seekers": 1, "prep_fraction": 0.0}
    env = maax.make("hide_and_seek_quadrant", door_size=5, modules=modules, inside=inside, **game)
    door, agents = env.base.modules["revolving_door"], env.base.agents.qpos_ids[:, :2]

    def play(key, side):
        state = env.reset(key)
        at, angle = state.data.xpos[door.body[0], :2], state.data.qpos[door.angle[0]]
        along = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        across = jnp.stack([-along[1], along[0]])
        place = at + 0.35 * along - side * 0.35 * across
        places = jnp.stack([place, jnp.array([0.5, 5.5])])  # the other one out of the way
        data = state.data.replace(qpos=state.data.qpos.at[agents].set(places))
        state = state.replace(data=env.base.engine.pose(state.world.fields, data))
        push = jnp.zeros((2, 3)).at[0, :2].set(side * across)
        after, _ = jax.lax.scan(lambda s, _: (env.step(s, {"move": push}), None), state, length=6)
        is_at_door = jnp.linalg.norm(at - state.world.plan.doors[:, :2], axis=1).min() < 1e-4
        turned = after.data.qpos[door.angle[0]] - angle
        return turned * side, is_at_door, after.obs["battery"][:, 0], after.metrics["physics_fault"]

    keys = jax.random.split(seeds.key(5), 8)
    turned, is_at_door, left, fault = jax.jit(jax.vmap(play))(keys, jnp.array([1.0, -1.0] * 4))
    assert is_at_door.all()
    assert (turned > 0.2)[~fault].all()
    np.testing.assert_allclose(left[:, 0], 1 - 6 * env.base.dt / 4, atol=1e-5)  # full force on one axis
    np.testing.assert_allclose(left[:, 1], 1.0, atol=1e-6)


# --- looking at, copying and saving ----------------------------------------------------------------------------------


def test_an_environment_says_in_one_line_what_it_is(lit):
    text = repr(maax.make("hide_and_seek", impl="c", n_boxes=3, **{"lock.radius": 0.3}))
    assert "\n" not in text
    assert text.startswith("<hide_and_seek(n_boxes=3, impl='c', lock.radius=0.3): 4 agents; modules walls, agent")
    assert "engine c" in text
    assert "layers TeamMembership, AgentAgentContactMask2D, LockObjects" in text
    assert "Flashlight" in repr(lit)
    assert repr(maax.Base(2, impl="c")).startswith("<Base: 2 agents")


def test_the_config_of_a_game_is_known(lit):
    config = maax.config_of(lit)
    assert config.n_boxes == 1
    assert config.inside == {"HideAndSeekReward": Flashlight}
    assert maax.config_of(Flashlight(maax.make("hide_and_seek", impl="c", cone=2.0)), n_boxes=4).n_boxes == 4
    with pytest.raises(ValueError, match=r"config_of: got <Base: 2 agents.*>, which has no config"):
        maax.config_of(maax.Base(2, impl="c"))


def handmade():
    env = maax.Base(2, impl="c", floor_size=5.0)
    for module in (maax.WallScenarios("empty"), maax.Agents(2), maax.Boxes(1)):
        env.add_module(module)
    return maax.LockObjects(maax.TeamMembership(env), objects=("box",), radius=0.4)


def test_a_game_with_one_more_module_is_not_that_game_any_more():
    env = maax.make("standard", impl="c")
    env.add_module(Post())
    assert "post" in pickle.loads(pickle.dumps(env)).base.modules
    with pytest.raises(ValueError, match=r"config_of: got .*, which has no config"):
        maax.config_of(env)


def test_a_subclass_that_adds_modules_can_be_pickled():
    twin = pickle.loads(pickle.dumps(Court()))
    assert list(twin.modules) == ["walls", "agent", "post"]


def test_texts_have_no_addresses():
    config = maax.config_of("standard", box_placement=partial(maax.quad_placement))
    assert "0x" not in repr(maax.make("standard", config, impl="c"))


def test_wrappers_that_were_refused_wrap_nothing():
    env = maax.make("standard", impl="c")
    with pytest.raises(ValueError, match="needs TeamMembership") as kept:
        maax.HideAndSeekReward(env)
    env.add_module(Post())
    assert kept is not None


@pytest.mark.slow
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize(
    "make", [lambda: maax.make("hide_and_seek", impl="c", n_boxes=2), handmade], ids=["game", "handmade"]
)
def test_copies_and_pickles_of_environments_play_alike(make, copied):
    env = make()
    twin = copied(env)
    assert names(twin) == names(env)
    assert twin.base is not env.base
    state, other = jax.jit(env.reset)(seeds.key(3)), jax.jit(twin.reset)(seeds.key(3))
    for x, y in zip(jax.tree.leaves(state.obs), jax.tree.leaves(other.obs), strict=True):
        equal(x, y)


def test_two_modules_that_name_an_object_alike_are_refused():
    class Pole(Post):
        """Another module's post."""

        name = "pole"

    env = maax.Base(1, impl="c")
    for module in (maax.WallScenarios("empty"), maax.Agents(1), Post(), Pole()):
        env.add_module(module)
    with pytest.raises(ValueError, match="modules: got 'post' and 'pole', which both name an object 'post'"):
        _ = env.model
