"""Every mistake of a user is refused where it is made, in words that name the argument, what it got and what it takes.

Under jit, where values cannot be seen, a bad value is contained in the world that it was given to.
"""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx import Agents, Base, Boxes, DomainParams, Ramps, WallScenarios, WorldParams, Worlds
from maax_mjx.worldgen import Geom

NAN = float("nan")


def cases(table):
    """{id: (call, fragments of the message...)} as parameters."""
    params = [pytest.param(call, fragments, id=name) for name, (call, *fragments) in table.items()]
    return pytest.mark.parametrize(("call", "fragments"), params)


def refuses(call, fragments, *args, error=ValueError):
    with pytest.raises(error) as caught:
        call(*args)
    assert type(caught.value) is error
    for fragment in fragments:
        assert fragment in str(caught.value)


def standard(**overrides):
    return maax.make("standard", impl="c", **overrides)


def base(n_agents, *modules, **arguments):
    env = Base(n_agents, impl="c", **arguments)
    for module in modules:
        env.add_module(module)
    return env


def shared_module():
    boxes = Boxes(1)
    base(1, boxes)
    base(1, boxes)


def in_quadrant(*walls):
    return base(1, *walls, Agents(1, maax.quad_placement))


def placed(weights):
    """A world whose agent is placed by a function that returns something."""
    return base(1, Agents(1, lambda layout, cells: weights)).reset(seeds.key(0))


COUNT = "takes a whole number in [0, 10000], or (low, high) with low <= high"
MOST = "takes a whole number in [1, 10000]"
ONE = "takes a whole number of at least 1"
POSITIVE = "takes a positive number"
NO_QUAD = ("placement_fn: got", "Agents", "there is none", 'add WallScenarios(scenario="quad")')
NO_DOOR = ("door_size: got 15 cells", "takes 0 to 13")
NO_ROOM = ("boxes: got 54 objects", "50 boxes", "the floor takes 46", "754 free")
COLOURS = "takes 2 colours of four numbers in [0, 1], one each"


class Misspelt(maax.RewardWrapper):
    def rewards(self, state):
        return state.reward


class Shapeless(maax.Entities):
    kind = "blob"


class Bare(maax.Sites):
    kind = "goal"


class Goal(Bare):
    rgba = (1.0, 1.0, 1.0, 1.0)


class Spaced(Goal):
    kind = "my thing"


class Unmade(maax.Entities):
    kind = "unmade"

    def __init__(self):
        self.n = 1


class Balls(maax.Entities):
    """Balls of 2 m in places of 0.4 m."""

    kind = "ball"

    def __init__(self, n_balls):
        super().__init__(n_balls, (0.4, 0.4, 0.4), maax.uniform_placement, free=True)

    def make(self, name):
        return Geom("sphere", (2.0,), name=name, free=True)


CONSTRUCTION = {
    "no reward": (lambda: Misspelt(standard()), "reward: Misspelt has none", "a RewardWrapper with a method"),
    "no observe": (lambda: maax.StateWrapper(standard()), "observe: StateWrapper has none"),
    "no observation": (lambda: maax.ObservationWrapper(standard()), "observation: ObservationWrapper has none"),
    "no action": (lambda: maax.ActionWrapper(standard()), "action: ActionWrapper has none"),
    "nothing made": (
        lambda: Shapeless(1, (0.1, 0.1, 0.1), maax.uniform_placement),
        "make: Shapeless has none",
        "a method make(name) that returns an object",
    ),
    "larger than its place": (
        lambda: base(1, Balls(1)),
        "make: Balls returned an object of 2 x 2 x 2 m",
        "takes one no larger than the extent that Balls has, 0.4 x 0.4 x 0.4 m",
    ),
    "not made": (lambda: base(1, Unmade()), "module: Unmade was not made; takes a first line super().__init__(...)"),
    "game with a space": (
        lambda: maax.register("my game", lambda config: None, maax.StandardConfig),
        "name: got 'my game'; takes a name without spaces",
    ),
    "number as the key of an action": (lambda: standard().sample_action(0), "key: got 0; takes a typed key"),
    "number as the key of actions": (lambda: Worlds(standard(), 2).sample_action(0), "key: got 0; takes a typed key"),
    "whose are too many": (
        lambda: base(4, Agents(4), Boxes(400)),
        "n_boxes: got 404 objects in all (4 agents, 400 boxes)",
    ),
    "scenario": (
        lambda: WallScenarios("quda"),
        "scenario: got 'quda'",
        "['empty', 'half', 'quad', 'random', 'screens', 'tri', 'var_quad']",
        "did you mean 'quad'?",
    ),
    "boxes negative": (lambda: Boxes(-1), "n_boxes: got -1", COUNT),
    "boxes reversed": (lambda: Boxes((3, 1)), "n_boxes: got (3, 1)", COUNT),
    "boxes fraction": (lambda: Boxes(1.5), "n_boxes: got 1.5", COUNT),
    "boxes three numbers": (lambda: Boxes((0, 1, 2)), "n_boxes: got (0, 1, 2)", COUNT),
    "agents none": (lambda: Agents(0), "n_agents: got 0", MOST),
    "agents range": (lambda: Agents((1, 2)), "n_agents: got (1, 2)", MOST),
    "base agents": (lambda: Base(-1), "n_agents: got -1", MOST),
    "seekers": (lambda: standard(n_seekers=1.5), "n_seekers: got 1.5", COUNT),
    "no team": (lambda: standard(n_hiders=0, n_seekers=0), "n_hiders, n_seekers: got 0 and 0", "at least one agent"),
    "agents disagree": (lambda: base(2, Agents(3)), "n_agents", "Base got 2, Agents got 3", "both take the same"),
    "placement list": (lambda: Boxes(2, [maax.uniform_placement]), "placement_fn: got a list of 1", "a list of 2"),
    "placement elements": (lambda: Boxes(2, [3, 3]), "placement_fn: got 3", "takes a function (layout, cells)"),
    "placement number": (lambda: Boxes(2, 3), "placement_fn: got 3", "takes"),
    "placement None": (lambda: Ramps(1, None), "placement_fn: got None", "takes"),
    "placement string": (lambda: Boxes(4, "quad"), "placement_fn: got 'quad'", "takes"),
    "quadrant without walls": (in_quadrant, *NO_QUAD),
    "quadrant of empty": (lambda: in_quadrant(WallScenarios("empty")), *NO_QUAD),
    "quadrant too late": (lambda: base(1, Agents(1, [maax.outside_quad_placement]), WallScenarios()), *NO_QUAD),
    "colours": (lambda: Agents(2, colours=[(1, 1, 1, 1)]), "colours: got [(1, 1, 1, 1)]", COLOURS),
    "box size": (lambda: Boxes(1, box_size=-0.5), "box_size: got -0.5", POSITIVE),
    "box friction": (lambda: Boxes(1, box_friction=-1.0), "box_friction: got -1.0", "takes"),
    "ramp friction": (lambda: Ramps(1, ramp_friction="ice"), "ramp_friction: got 'ice'", "takes"),
    "door too wide": (lambda: standard(door_size=15), *NO_DOOR),
    "door of a small grid": (lambda: base(1, WallScenarios("quad", 4), grid_size=8), "door_size: got 4", "0 to 2"),
    "door negative": (lambda: WallScenarios("quad", -1), "door_size: got -1", "takes a whole number of at least 0"),
    "no room": (lambda: standard(n_boxes=50, n_ramps=0), *NO_ROOM),
    "no room for one": (
        lambda: base(1, Boxes(1, box_size=7.0)),
        "boxes: got an object of 35 x 35 cells",
        "takes up to 30 x 30",
    ),
    "parameter twice": (
        lambda: base(2, Agents({"boxes": 2}), Boxes((1, 4))),
        "module: Boxes has a parameter 'n_boxes', as Agents has",
    ),
    "team name": (lambda: Agents({"my team": 2}), "n_agents: got a team named 'my team'", "identifiers"),
    "teams of none": (lambda: Agents({"hiders": 0}), "n_agents: got no agents in team 'hiders'", "takes at least one"),
    "team range": (lambda: Agents({"hiders": (3, 1)}), "n_agents['hiders']: got (3, 1)", "low <= high"),
    "too many rooms": (lambda: base(1, maax.RandomWalls(14)), "n_rooms: got 14", "takes at most 9 of min_room_size 6"),
    "narrow door": (lambda: base(1, WallScenarios(), grid_size=100), "an opening of 0.18 m", "at least 0.32 m"),
    "probabilities nan": (
        lambda: WallScenarios(["quad", "tri"], probabilities=[NAN, 1]),
        "probabilities: got [nan, 1]",
    ),
    "probabilities string": (lambda: WallScenarios(["quad", "tri"], probabilities="ab"), "probabilities: got 'ab'"),
    "scenario number": (lambda: WallScenarios(5), "scenario: got 5", "takes one of"),
    "dropout without quadrant": (
        lambda: WallScenarios("half", p_door_dropout=0.5),
        "p_door_dropout: got 0.5",
        "takes 0",
    ),
    "outer": (lambda: WallScenarios(outer="fence"), "outer: got 'fence'", "takes one of"),
    "no outer walls to drop": (lambda: WallScenarios(outer="none", prob_outside_walls=0.5), "there are no outer walls"),
    "elongated": (lambda: Boxes(2, n_elongated_boxes=3), "n_elongated_boxes: got 3", "takes at most 2"),
    "mass": (lambda: Boxes(1, box_mass=(2.0, 1.0)), "box_mass: got (2.0, 1.0)", "low <= high"),
    "damping": (lambda: Agents(1, damping=-1), "damping: got -1", "at least 0"),
    "gear": (lambda: Agents(1, gear=0), "gear: got 0", POSITIVE),
    "diameter": (lambda: maax.Cylinders(1, diameter=-1), "diameter: got -1", POSITIVE),
    "floor friction": (lambda: maax.FloorAttributes("ice"), "friction: got 'ice'", "takes a number"),
    "floor colour": (lambda: maax.FloorAttributes(rgba=5), "rgba: got 5", "four numbers"),
    "gravity": (lambda: maax.WorldConstants(NAN), "gravity: got nan", "takes a finite number"),
    "teams in a list": (lambda: Agents([2, 1]), "n_agents: got [2, 1]", "numbers by team"),
    "colour of a site": (
        lambda: Bare(1, (1, 1, 1), maax.uniform_placement, 0.1),
        "rgba: Bare has none",
        "four numbers",
    ),
    "extent of a site": (
        lambda: Goal(1, 0.5, maax.uniform_placement, 0.1),
        "extent: got 0.5",
        "three positive numbers",
    ),
    "height of a site": (lambda: Goal(1, (1, 1, 1), maax.uniform_placement, "low"), "height: got", "takes"),
    "name of a kind": (
        lambda: Spaced(1, (1, 1, 1), maax.uniform_placement, 0.1),
        "kind: Spaced has 'my thing'",
        "identifier",
    ),
    "food size": (lambda: maax.Food(1, food_size=0), "food_size: got 0", POSITIVE),
    "floor range": (lambda: Base(1, floor_size=(6.0, 4.0)), "floor_size: got (6.0, 4.0)", "low <= high"),
    "in the quadrant": (
        lambda: base(1, WallScenarios(), Boxes(20, maax.all_of(maax.quad_placement, maax.uniform_placement))),
        "placement_fn: got 20 objects (20 boxes) of 180 cells in the quadrant",
    ),
    "horizon": (lambda: standard(horizon=0), "horizon: got 0", ONE),
    "n_frames": (lambda: standard(n_frames=0), "n_frames: got 0", ONE),
    "grid_size": (lambda: standard(grid_size=7), "grid_size: got 7", "takes a whole number in [8, 1000]"),
    "floor_size": (lambda: standard(floor_size=0), "floor_size: got 0", POSITIVE),
    "floor_size nan": (lambda: standard(floor_size=NAN), "floor_size: got nan", POSITIVE),
    "impl": (lambda: maax.make("standard", impl="nonsense"), "impl: got 'nonsense'", "takes one of", "'c'", "'jax'"),
    "timestep": (lambda: WorldParams(timestep=0.0), "timestep: got 0.0", POSITIVE),
    "timestep nan": (lambda: WorldParams(timestep=NAN), "timestep: got nan", POSITIVE),
    "timestep infinite": (lambda: WorldParams(timestep=float("inf")), "timestep: got inf", POSITIVE),
    "timestep string": (lambda: WorldParams(timestep="fast"), "timestep: got 'fast'", POSITIVE),
    "margin on the device": (
        lambda: standard(world_params=WorldParams(placement_margin=0.5)),
        "placement_margin: got 0.5",
        "takes 0 here",
    ),
    "iterations": (lambda: WorldParams(iterations=0), "iterations: got 0", ONE),
    "iterations fraction": (lambda: WorldParams(iterations=1.5), "iterations: got 1.5", ONE),
    "ls_iterations": (lambda: WorldParams(ls_iterations=-2), "ls_iterations: got -2", ONE),
    "gravity nan": (lambda: WorldParams(gravity=NAN), "gravity: got nan", "takes"),
    "world_params": (lambda: standard(world_params=3), "world_params: got 3", "takes"),
    "module": (lambda: base(1, 3), "module: got 3", "takes a Module"),
    "module class": (lambda: base(1, Agents), "module: got <class", "takes a Module"),
    "module twice": (lambda: base(1, Agents(1), Agents(1)), "module: got a second 'agent'", "takes one of each"),
    "module of another": (shared_module, "module: this Boxes belongs to another environment", "make a new one"),
    "task": (lambda: maax.make("standrad"), "name: got 'standrad'", "takes one of", "did you mean 'standard'?"),
    "keyword": (lambda: standard(n_box=2), "make('standard'): got 'n_box'", "takes one of", "did you mean 'n_boxes'"),
    "jitted name": (lambda: maax.jitted("standrad"), "name: got 'standrad'", "did you mean 'standard'?"),
    "yaw of agents": (lambda: Agents(1, random_yaw="no"), "random_yaw: got 'no'", "takes True or False"),
    "polar": (lambda: Boxes(1, polar_obs="no"), "polar_obs: got 'no'", "takes True or False"),
    "low walls": (lambda: WallScenarios(low_outside_walls=1), "low_outside_walls: got 1", "takes True or False"),
    "horizon too long": (lambda: Base(1, horizon=2**31), "horizon: got 2147483648", "32 bits"),
    "immunity": (lambda: maax.config_of("tag", immunity=2**40), "immunity: got 1099511627776", "32 bits"),
    "iterations too many": (lambda: WorldParams(iterations=10**10), "iterations: got 10000000000", "32 bits"),
    "floor too large": (lambda: Base(1, floor_size=1e9), "floor_size: got 1000000000.0", "up to 1000"),
    "rect complex": (lambda: maax.RestrictAgentsRect(standard(), (0, 0, 1, 1j)), "rect: got (0, 0, 1, 1j)", "takes x0"),
    "params of nothing": (lambda: DomainParams(3), "ranges: got 3", "takes a dict"),
    "placement of text": (
        lambda: placed("ab"),
        "returned a str; takes",
        "takes an array of weights (30, 30)",
    ),
    "placement of a list": (lambda: placed([[1] * 30] * 30), "returned a list; takes", "an array"),
    "placement complex": (
        lambda: placed(np.ones((30, 30), complex)),
        "returned complex128[30, 30]; takes",
        "placement_fn of",
    ),
    "placement shape": (lambda: placed(np.ones((3, 3))), " returned weights of shape (3, 3); takes", "(30, 30)"),
    "devices fraction": (
        lambda: Worlds(standard(), 2, devices=2.5),
        "devices: got 2.5",
        "takes None, 'all', or a number",
    ),
    "devices of None": (lambda: Worlds(standard(), 2, devices=[None]), "devices: got [None]", "takes None, 'all'"),
    "jitted nonsense": (lambda: maax.jitted(3), "env: got 3", "takes an environment or one of ["),
    "jitted overrides": (lambda: maax.jitted(standard(), horizon=3), "overrides: got ['horizon']", "with a name"),
    "worlds of nonsense": (lambda: Worlds("standard", 4), "env: got 'standard'", "takes an environment"),
    "worlds none": (lambda: Worlds(standard(), 0), "n_worlds: got 0", ONE),
}


@cases(CONSTRUCTION)
def test_refused_at_construction(call, fragments):
    refuses(call, fragments)


def test_limits_themselves_are_taken():
    standard(n_boxes=42, n_ramps=0)
    standard(n_boxes=np.int64(2), n_ramps=(0, 0), horizon=1, n_frames=1, door_size=13)
    standard(scenario="empty", door_size=15)
    base(2, Agents(2), Boxes((0, 2), [maax.uniform_placement] * 2), grid_size=8, floor_size=2.5)
    WorldParams(timestep=1e-4, gravity=0.0, iterations=1, ls_iterations=1)


def test_an_environment_needs_agents():
    env = base(2, WallScenarios())
    expected = ["got no agents", "add_module(Agents(2, ...))"]
    refuses(env.reset, expected, seeds.key(0), error=RuntimeError)
    env.add_module(Agents(2))  # the attempt leaves it usable


@pytest.fixture(scope="module")
def small():
    """One agent and 0 to 2 boxes on an open floor."""
    return base(1, Agents(1), Boxes((0, 2)))


@pytest.fixture(scope="module")
def kit(env_c, env_ranges, small, batch_reset):
    """What the calls below are made with."""
    key = seeds.key(0)
    batch = batch_reset(env_c, jax.random.split(key, 3))
    worlds = Worlds(small, 3)
    return SimpleNamespace(
        env=env_c,
        ranges=env_ranges,
        batch=batch,
        one=jax.jit(lambda states: jax.tree.map(lambda x: x[0], states))(batch),
        move=np.zeros((4, 3), np.float32),
        nan=np.full((4, 3), NAN, np.float32),
        key=key,
        raw=jax.random.PRNGKey(0),
        jitted=maax.jitted(env_c),
        jitted_ranges=maax.jitted(env_ranges),
        small=small,
        worlds=worlds,
        states=worlds.reset(key),
        moves=np.zeros((3, 1, 3), np.float32),
    )


def step(k, action):
    return k.env.step(k.one, action)


def jitted_step(k, action):
    return k.jitted[1](k.one, action)


def worlds_step(k, action):
    return k.worlds.step(k.states, action)


RAW = ("key: got an array of uint32", "takes a typed key, jax.random.key(seed)")
KEYS = ("key: got 3 keys", "takes one key")
HOLDS_NAN = ("action: 'move' holds NaN", "takes numbers in [-1, 1]")
ABOVE = ("params: n_boxes is (1, 9)", "0 <= low <= high <= 3")
ABOVE_SMALL = ("params: n_boxes is (1, 9)", "0 <= low <= high <= 2")
REVERSED = ("params: n_boxes is (2, 1)", "0 <= low <= high <= 3")


def still(k, keep):
    return k.worlds.rollout(k.states, lambda obs, key: {"move": k.moves}, 1, key=k.key, keep=keep)


def nothing(env):
    return env.default_params.replace(prob_outside_walls=NAN)


BATCH_OF_PARAMS = ("params: prob_outside_walls has shape (3, 2)", "takes (2,)")
FOREIGN = (
    "params: got ranges for ['n_agents', 'n_boxes']",
    "takes exactly ['n_boxes', 'n_hiders', 'n_ramps', 'n_seekers', 'p_door_dropout', 'prob_outside_walls']",
)
SINGLE = ("world: got 0", "single world", "takes None")
BATCH = "the state is a batch and takes an index below 3"


def boxes(env, value):
    return env.default_params.replace(n_boxes=value)


def floats(env, value):
    return DomainParams({**env.default_params, "n_boxes": np.array(value)})


def one_of_three(env, value):
    return DomainParams({**per_world(env, 3), "n_boxes": jnp.array([(0, 2), value, (0, 2)])})


def per_world(env, n):
    return jax.tree.map(lambda x: jnp.tile(x, (n, 1)), env.default_params)


CALLS = {
    "action shape": (lambda k: step(k, {"move": k.move[:3]}), "action: 'move' has shape (3, 3)", "takes (4, 3)"),
    "action missing": (lambda k: step(k, {}), "action: got []", "takes exactly ['move']"),
    "action extra": (lambda k: step(k, {"move": k.move, "grab": k.move}), "action: got ['grab', 'move']", "['move']"),
    "action array": (lambda k: step(k, k.move), "action: got ndarray", "takes a dict with ['move']"),
    "action list": (
        lambda k: step(k, {"move": [[0.0] * 3] * 4}),
        "action: 'move' is a list",
        "takes an array of numbers",
    ),
    "action complex": (lambda k: step(k, {"move": k.move * 1j}), "action: 'move' is complex64[4, 3]", "takes an array"),
    "action objects": (lambda k: step(k, {"move": k.move.astype(object)}), "action: 'move' is object[4, 3]", "takes"),
    "jitted list": (lambda k: jitted_step(k, {"move": [[0.0] * 3] * 4}), "action: 'move' is a list", "takes an array"),
    "worlds list": (lambda k: worlds_step(k, {"move": [[[0.0] * 3]] * 3}), "'move' is a list", "takes an array"),
    "action nan": (lambda k: step(k, {"move": jnp.asarray(k.nan)}), *HOLDS_NAN),
    "jitted nan": (lambda k: jitted_step(k, {"move": jnp.asarray(k.nan)}), *HOLDS_NAN),
    "worlds shape": (lambda k: worlds_step(k, {"move": k.move}), "'move' has shape (4, 3)", "takes (3, 1, 3)"),
    "worlds nan": (lambda k: worlds_step(k, {"move": k.moves + np.float32(NAN)}), *HOLDS_NAN),
    "worlds nan in jax": (lambda k: worlds_step(k, {"move": jnp.asarray(k.moves).at[2, 0, 1].set(NAN)}), *HOLDS_NAN),
    "key raw": (lambda k: k.env.reset(k.raw), *RAW),
    "key number": (lambda k: k.env.reset(0), "key: got 0", "takes a typed key"),
    "key jitted": (lambda k: k.jitted[0](k.raw), *RAW),
    "key under jit": (lambda k: jax.jit(k.env.reset)(k.raw), *RAW),
    "key of worlds": (lambda k: k.worlds.reset(k.raw), *RAW),
    "keys": (lambda k: k.env.reset(jax.random.split(k.key, 3)), *KEYS),
    "keys of worlds": (lambda k: k.worlds.reset(jax.random.split(k.key, 3)), *KEYS),
    "params name": (lambda k: k.ranges.default_params.replace(n_box=1), "got 'n_box'", "did you mean 'n_boxes'?"),
    "params reversed": (lambda k: k.ranges.check_params(boxes(k.ranges, (2, 1))), *REVERSED),
    "params above": (lambda k: k.ranges.check_params(boxes(k.ranges, (1, 9))), *ABOVE),
    "params below": (lambda k: k.ranges.check_params(boxes(k.ranges, (-1, 2))), "n_boxes is (-1, 2)", "0 <= low"),
    "params of one world": (lambda k: k.worlds.reset(k.key, one_of_three(k.small, (0, 9))), "n_boxes is (0, 9)"),
    "params reversed in one": (
        lambda k: k.worlds.reset(k.key, one_of_three(k.small, (2, 1))),
        "n_boxes is (2, 1)",
    ),
    "params above in reset": (lambda k: k.ranges.reset(k.key, boxes(k.ranges, (1, 9))), *ABOVE),
    "params reversed in jitted": (lambda k: k.jitted_ranges[0](k.key, boxes(k.ranges, (2, 1))), *REVERSED),
    "params above in jitted": (lambda k: k.jitted_ranges[0](k.key, boxes(k.ranges, (1, 9))), *ABOVE),
    "params in worlds": (lambda k: k.worlds.reset(k.key, boxes(k.small, (1, 9))), *ABOVE_SMALL),
    "params in with_params": (lambda k: k.worlds.with_params(k.states, boxes(k.small, (1, 9))), *ABOVE_SMALL),
    "params shape": (lambda k: k.ranges.check_params(boxes(k.ranges, (0, 1, 2))), "n_boxes has shape (3,)", "(2,)"),
    "params dict": (lambda k: k.env.reset(k.key, {"n_boxes": (1, 1)}), "params: got dict", "takes env.default_params"),
    "params foreign": (lambda k: k.env.reset(k.key, k.small.default_params), *FOREIGN),
    "params foreign in worlds": (lambda k: k.worlds.with_params(k.states, k.env.default_params), "takes exactly"),
    "params fraction": (lambda k: k.ranges.check_params(boxes(k.ranges, (0.5, 2.7))), "n_boxes", "0.5"),
    "params too large": (lambda k: boxes(k.ranges, 2**40), "n_boxes: got 1099511627776", "32 bits"),
    "params ragged": (lambda k: boxes(k.ranges, [[1], [1, 2]]), "n_boxes: got [[1], [1, 2]]", "takes a whole number"),
    "params complex": (lambda k: k.ranges.default_params.replace(p_door_dropout=1j), "p_door_dropout: got 1j", "takes"),
    "params list": (
        lambda k: k.ranges.check_params(DomainParams({**k.ranges.default_params, "n_boxes": [0, 1]})),
        "params: n_boxes is a list",
        "takes an array",
    ),
    "keep None": (lambda k: still(k, None), "keep: got None", "takes a tuple of names"),
    "keep number": (lambda k: still(k, 3), "keep: got 3", "takes a tuple of names"),
    "params string": (lambda k: boxes(k.ranges, "few"), "n_boxes", "few"),
    "params None": (lambda k: boxes(k.ranges, None), "n_boxes", "None"),
    "params nan": (lambda k: k.ranges.check_params(floats(k.ranges, (NAN, 1.0))), "n_boxes", "nan"),
    "params float": (lambda k: k.ranges.check_params(floats(k.ranges, (0.5, 1.0))), "n_boxes", "0.5"),
    "params of a batch": (lambda k: k.ranges.reset(k.key, per_world(k.ranges, 3)), *BATCH_OF_PARAMS),
    "params with nan": (lambda k: k.env.check_params(nothing(k.env)), "prob_outside_walls is (nan, nan)", "takes"),
    "params of 4 worlds": (
        lambda k: k.worlds.reset(k.key, per_world(k.small, 4)),
        "params: n_agents has shape (4, 2)",
        "takes",
        "(4, 2)",
    ),
    "states of others": (lambda k: k.worlds.step(k.one, {"move": k.moves}), "states: got", "takes"),
    "mjcf of a batch": (lambda k: maax.to_mjcf(k.env, k.batch), "world: got None", BATCH),
    "mjcf above": (lambda k: maax.to_mjcf(k.env, k.batch, 3), "world: got 3", BATCH),
    "mjcf below": (lambda k: maax.to_mjcf(k.env, k.batch, -4), "world: got -4", BATCH),
    "mjcf of one": (lambda k: maax.to_mjcf(k.env, k.one, 0), *SINGLE),
    "mjcf fraction": (lambda k: maax.to_mjcf(k.env, k.batch, 1.5), "world: got 1.5", "takes"),
    "mjcf bool": (lambda k: maax.to_mjcf(k.env, k.batch, True), "world: got True", "takes"),
}


@cases(CALLS)
def test_refused_at_call(call, fragments, kit):
    refuses(call, fragments, kit)


def test_donated_states_are_not_used_again(kit):
    states = kit.worlds.reset(kit.key)
    later = kit.worlds.step(states, {"move": kit.moves})
    expected = ["states", "donated", "donate=False"]
    refuses(kit.worlds.step, expected, states, {"move": kit.moves}, error=RuntimeError)
    assert kit.worlds.step(later, {"move": kit.moves}).step.tolist() == [2, 2, 2]


def test_params_of_the_caller_are_not_donated(kit):
    params = per_world(kit.small, 3)
    states = kit.worlds.with_params(kit.worlds.reset(kit.key), params)
    states = kit.worlds.step(states, {"move": kit.moves})
    assert params["n_boxes"].tolist() == [[0, 2]] * 3


def test_params_out_of_bounds_under_jit_give_an_invalid_world(small, batch_reset):
    keys = jax.random.split(seeds.key(0), 3)
    for value, valid in [((1, 9), False), ((2, 1), False), ((-1, 1), False), ((2, 2), True)]:
        state = batch_reset(small, keys, boxes(small, value))
        assert state.world.valid.tolist() == [valid] * 3
        assert state.metrics["layout_invalid"].tolist() == [not valid] * 3


def test_nan_under_jit_is_a_fault_of_its_world_alone(kit, batch_step):
    move = seeds.rng(0).uniform(-1, 1, (3, 4, 3)).astype(np.float32)
    states = batch_step(kit.env, kit.batch, {"move": move})
    clean = batch_step(kit.env, states, {"move": move})
    assert not clean.done.any()
    assert not clean.metrics["physics_fault"].any()
    bad = move.copy()
    bad[1, 2, 0] = NAN
    faulty = batch_step(kit.env, states, {"move": bad})
    assert faulty.truncated.tolist() == [False, True, False]
    assert faulty.terminated.tolist() == [False] * 3
    assert faulty.metrics["physics_fault"].tolist() == [False, True, False]
    for name in ("data", "obs", "reward", "metrics", "step"):
        for a, b in zip(jax.tree.leaves(getattr(clean, name)), jax.tree.leaves(getattr(faulty, name)), strict=True):
            assert np.isfinite(b).all()
            np.testing.assert_array_equal(np.asarray(a)[[0, 2]], np.asarray(b)[[0, 2]])
    np.testing.assert_array_equal(faulty.data.qpos[1], states.data.qpos[1])
    assert not np.array_equal(clean.data.qpos[1], states.data.qpos[1])
    again = batch_step(kit.env, faulty, {"move": move})
    assert not again.metrics["physics_fault"].any()
