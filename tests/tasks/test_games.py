"""The games by name: registry, configs, OpenAI's two games number for number in what is built, what agents observe.

What is broken in the published MAax (the predecessor in Brax), and which test fails when it is broken here:

    observations frozen at reset by wrappers: test_wrappers.py::test_observations_are_of_the_state_after_the_step
    ... in every game: test_games.py::test_every_game
    reward and action wrappers that cannot be called: test_wrappers.py::test_ones_own_wrapper
    bins of actions: test_wrappers.py::test_discrete_actions
    every reward type is selfish; teams of unequal size: test_wrappers.py::test_rewards
    the reward of the wrappers inside is dropped: test_wrappers.py::test_rewards
    contact at a distance of 3 m: test_wrappers.py::test_contact_and_team_sizes
    RestrictAgentsRect has no body: test_wrappers.py::test_rectangle
    the rest of the preparation is no share: test_wrappers.py::test_preparation
    seekers act in the preparation: test_wrappers.py::test_preparation
    preparation and statistics branch on traced values: test_games.py::test_preparation_and_statistics_under_jit
    statistics read observations: test_games.py::test_preparation_and_statistics_under_jit
    locking does not run: test_locks.py::test_a_locked_object_is_held
    one action for all locks does not run: test_locks.py::test_all_at_once_and_owners_are_drawn_among_those_who_want
    no grabbing: test_games.py::test_locks_and_holds_are_at_their_objects
    masks of actions do not run under jit: test_stats_and_masks.py::test_mask_actions
    masks of unseen actions do not run under jit: test_stats_and_masks.py::test_mask_unseen_action
    no vision, no lidar: test_senses.py::test_line_of_sight_is_the_cone_and_mj_ray
    split and select fail after the first step: test_games.py::test_every_game
    padding fails after the first step: test_wrappers.py::test_split_spoof_join_flatten
    flattening gives a dict: test_games.py::test_flat_observations
"""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.tasks import GrabConfig, StandardConfig, TagConfig, observed_by_agents, registry, standard
from maax_mjx.wrappers import find

NAMES = ["capture_the_flag", "hide_and_seek", "hide_and_seek_full", "hide_and_seek_quadrant", "standard", "tag"]
OPENAI = ["hide_and_seek_quadrant", "hide_and_seek_full"]
REACH, CELL = 0.25, 0.2
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


def make(name, **overrides):
    return maax.make(name, impl="c", **overrides)


@pytest.fixture(scope="module")
def game():
    """The games as they are by default, each built once."""
    return cache(make)


# --- names and configs -----------------------------------------------------------------------------------------


def test_names():
    assert set(NAMES) <= set(maax.tasks())
    assert maax.tasks() == sorted(maax.tasks())


def test_overrides_reach_what_is_built():
    dotted = {"lock.radius": 0.3, "lock.objects": ("box",), "world_params.gravity": -5.0}
    env = make("hide_and_seek", n_boxes=(1, 4), horizon=30, **dotted)
    equal(env.default_params["n_boxes"], [1, 4])
    assert env.base.model.opt.gravity[2] == -5.0
    assert env.base.model.opt.timestep == 0.005
    assert env.base.horizon == 30
    locks = find(env, maax.LockObjects)
    assert [m.name for m in locks.modules] == ["box"]
    assert locks._reach._radius == 0.3
    assert locks.lock_type == "team"


def test_a_config_to_start_from():
    config = maax.config_of("hide_and_seek", n_ramps=2, **{"lock.lock_type": "any"})
    env = maax.make("hide_and_seek", config, impl="c", **{"lock.per_object": False})
    assert env.base.modules["ramp"].n_max == 2
    assert find(env, maax.LockObjects).lock_type == "any"
    assert not find(env, maax.LockObjects).per_object
    assert config.impl == "auto"
    assert config.lock.per_object
    assert maax.config_of("hide_and_seek").lock.lock_type == "team"


def test_groups_can_be_left_out_and_put_in():
    bare = make("hide_and_seek", lock=None, stats=False, observations="raw")
    assert [type(w).__name__ for w in bare.layers] == [
        "PreparationPhase",
        "HideAndSeekReward",
        "AgentAgentContactMask2D",
        "TeamMembership",
    ]
    grab = GrabConfig(radius=0.4, selective=True)
    assert make("hide_and_seek", grab=grab).action_space["grab"].shape == (4, 2)


@pytest.mark.parametrize("name", NAMES)
def test_configs_are_frozen(name):
    config = maax.config_of(name)
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.n_boxes = 3
    assert maax.config_of(name, n_boxes=3).n_boxes == 3
    assert hash(config.lock) if getattr(config, "lock", None) else True


HNS = "make('hide_and_seek')"
MISTAKES = {
    "name": (lambda: maax.make("hide_and_sek"), ["name: got 'hide_and_sek'", "did you mean 'hide_and_seek'"]),
    "name of a config": (lambda: maax.config_of("tagg"), ["name: got 'tagg'", "did you mean 'tag'?"]),
    "field": (lambda: maax.make("hide_and_seek", n_bin=3), [f"{HNS}: got 'n_bin'", "did you mean 'n_bins'"]),
    "field of a config": (lambda: maax.config_of("tag", imunity=3), ["got 'imunity'", "did you mean 'immunity'"]),
    "field of a group": (
        lambda: maax.make("hide_and_seek", **{"lock.radios": 1}),
        [f"{HNS}, lock: got 'radios'", "did you mean 'radius'?"],
    ),
    "group": (
        lambda: maax.make("hide_and_seek", **{"lok.radius": 1}),
        [f"{HNS}: got 'lok.radius'", "did you mean 'lock.radius'"],
    ),
    "into None": (
        lambda: maax.make("hide_and_seek", **{"grab.radius": 1}),
        [f"{HNS}: got 'grab.radius', but grab is None, which has no fields; give grab a GrabConfig first"],
    ),
    "into a number": (
        lambda: maax.make("tag", **{"n_boxes.low": 1}),
        ["make('tag'): got 'n_boxes.low', but n_boxes is (1, 3), which has no fields"],
    ),
    "deeper": (
        lambda: maax.make("hide_and_seek", **{"lock.radius.x": 1}),
        [f"{HNS}, lock: got 'radius.x', but radius is 0.25, which has no fields"],
    ),
    "dot at the end": (lambda: maax.make("tag", **{"n_boxes.": 1}), ["got 'n_boxes.'", "has no fields"]),
    "group and dot": (lambda: maax.make("hide_and_seek", **{"lock.": 1}), [f"{HNS}, lock: got ''", "takes one of"]),
    "value in a group": (lambda: maax.make("tag", **{"world_params.gravity": "up"}), ["gravity: got 'up'"]),
    "no group": (lambda: maax.make("hide_and_seek", lock=True), ["lock: got True; takes a LockConfig, or None"]),
    "dict for a group": (lambda: maax.make("hide_and_seek", rect={}), ["rect: got {}; takes a RectConfig, or None"]),
    "other group": (lambda: maax.make("hide_and_seek", lidar=GrabConfig()), ["takes a LidarConfig, or None"]),
    "config of another": (
        lambda: maax.make("tag", maax.config_of("standard")),
        ["config: got StandardConfig;", "takes a TagConfig for 'tag'"],
    ),
    "config class": (lambda: maax.make("tag", TagConfig), ["config: got the class TagConfig", "takes a TagConfig"]),
    "observations": (lambda: maax.make("tag", observations="all"), ["observations: got 'all'", "takes one of"]),
    "observe": (lambda: maax.make("tag", observe="both"), ["observe: got 'both'", "'self', 'team'"]),
    "critic of raw ones": (
        lambda: maax.make("tag", observations="raw", observe="all"),
        ["observe: got 'all' with observations='raw'; takes 'self' there"],
    ),
}


@pytest.mark.parametrize(("call", "fragments"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes(call, fragments):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call()
    for fragment in fragments:
        assert fragment in str(error.value)


# --- games of one's own ----------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class HarvestConfig(StandardConfig):
    """A user's own."""

    n_food: int = 3
    scenario: str = "empty"


@dataclasses.dataclass
class Thawed:
    n_food: int = 3


@dataclasses.dataclass(frozen=True)
class Unfinished:
    n_food: int


def harvest(config):
    base = standard(config)
    base.add_module(maax.Food(config.n_food))
    return maax.TeamMembership(base)


@pytest.fixture
def registered(monkeypatch):
    """A registry of its own for the test."""
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))


def test_a_game_of_ones_own(registered):
    maax.register("harvest", harvest, HarvestConfig)
    assert "harvest" in maax.tasks()
    env = make("harvest", n_food=5, **{"world_params.timestep": 0.002})
    assert isinstance(env, maax.TeamMembership)
    assert env.observation_space["food_pos"].shape == (5, 3)
    assert env.base.model.opt.timestep == 0.002
    assert maax.config_of("harvest").n_food == 3
    with pytest.raises(ValueError, match="did you mean 'n_food'"):
        maax.make("harvest", n_fod=1)
    maax.register("harvest", harvest, HarvestConfig)  # again, as a cell of a notebook does


REFUSED = {
    "taken": (("tag", harvest, HarvestConfig), "name: got 'tag'; takes a name that is not taken"),
    "empty": (("", harvest, HarvestConfig), "name: got ''"),
    "number": ((3, harvest, HarvestConfig), "name: got 3"),
    "build": (("a", "harvest", HarvestConfig), "build: got 'harvest'; takes a function"),
    "not frozen": (("a", harvest, Thawed), "takes a class made by dataclass(frozen=True)"),
    "no dataclass": (("a", harvest, dict), "config: got <class 'dict'>; takes a class made by"),
    "no argument": (("a", lambda: 0, HarvestConfig), "build: got <lambda>(); takes a function (config) -> environment"),
    "an object": (("a", harvest, HarvestConfig()), "config: got HarvestConfig("),
    "without defaults": (("a", harvest, Unfinished), "config: got Unfinished, with fields without defaults"),
}


@pytest.mark.parametrize(("arguments", "message"), REFUSED.values(), ids=REFUSED)
def test_refused_games(arguments, message, registered):
    before = maax.tasks()
    with pytest.raises(ValueError) as error:  # noqa: PT011
        maax.register(*arguments)
    assert message in str(error.value)
    assert maax.tasks() == before


def test_a_game_that_builds_something_else(registered):
    maax.register("odd", lambda config: 3, HarvestConfig)
    with pytest.raises(ValueError, match="build: got 3 from that of 'odd'; takes a function from a config to an env"):
        maax.make("odd")


# --- OpenAI's numbers ------------------------------------------------------------------------------------------

BOTH = {
    "timestep": 0.005,
    "gravity": -50.0,
    "n_frames": 15,
    "floor": 6.0,
    "grid": 30,
    "agent": 4,
    "teams": [0, 0, 1, 1],
    "friction of floor": {0.2},
    "friction of wall": {0.01},
    "friction of agent": {0.01},
    "friction of box": {0.2},
    "friction of ramp": {0.01},
    "gear": {90.0},  # 100, of which actions reach 0.9
    "damping of agent": {(10.0, 10.0, 1.0, 10.0)},  # x, y, z, yaw
    "damping of box": {(0.01,) * 4},
    "damping of ramp": {(0.1,) * 4},
    "mass of agent": {1.0},
    "mass of box": {1.0},
    "mass of ramp": {1.0},
    "radius of agents": 0.15,
    "half of boxes": (0.25, 0.25, 0.25),
    "ramp": (0.5, 0.5, 0.5),
    "wall heights": {0.5, 4.0},
    "door cells": 2,
    "bins": 11,
    "lock": ("team", REACH, True),  # all_lock_team_specific, seen only; one choice for all in reach
    "lock of agents": (4,),
    "grab": (REACH, False, True),
    "grab of agents": (4,),
    "grabbed": ["box", "ramp"],
    "cone": 3 * np.pi / 4,
    "lidar": (30, 6.0, "world", None),
    "reward": ("team_zero_sum", "vision", 1.0),
    "penalty": 10.0,
}
NUMBERS = {
    "hide_and_seek_quadrant": BOTH
    | {
        "horizon": 80,
        "prep": 32,
        "locked": ["box"],
        "rect": (0.1, 0.1, 5.9, 5.9),
        "objects too": True,
        "ranges": {
            "n_hiders": (2, 2),
            "n_seekers": (2, 2),
            "n_boxes": (2, 2),
            "n_ramps": (1, 1),
            "p_door_dropout": (0.5, 0.5),
            "prob_outside_walls": (1.0, 1.0),
        },
        "scenario": ["quad"],
    },
    "hide_and_seek_full": BOTH
    | {
        "horizon": 240,
        "prep": 96,
        "locked": ["box", "ramp"],
        "rect": (-6.0, -6.0, 12.0, 12.0),
        "objects too": False,
        "ranges": {
            "n_hiders": (2, 2),
            "n_seekers": (2, 2),
            "n_boxes": (3, 9),
            "n_elongated_boxes": (3, 9),
            "n_ramps": (2, 2),
            "n_rooms": (1, 4),
            "prob_outside_walls": (0.5, 0.5),
        },
        "friction of wall": {1.0},  # the random walls of the published code are made without one
        "scenario": ["random"],
    },
}


def built(env):
    """The numbers of the table, from the model, the spaces and the wrappers."""
    base, model = env.base, env.base.model
    kinds = ("floor", "wall", "agent", "box", "ramp")

    def of(kind, n, names, values):
        rows = [values(i) for i in range(n) if names(i).name.startswith(kind)]
        assert rows, kind
        return set(rows)

    def number(x):
        return round(float(x), 7)

    joints = {}
    for i in range(model.njnt):
        body = model.body(model.jnt_bodyid[i]).name
        joints.setdefault(body, []).append(number(model.dof_damping[model.jnt_dofadr[i]]))
    walls, locks, grabs = base.modules["walls"], find(env, maax.LockObjects), find(env, maax.GrabObjects)
    lidar, reward, rect = (find(env, kind) for kind in (maax.Lidar, maax.HideAndSeekReward, maax.RestrictAgentsRect))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[0])
    corners = model.mesh_vert @ turn.reshape(3, 3).T
    numbers = {
        "timestep": model.opt.timestep,
        "gravity": model.opt.gravity[2],
        "n_frames": base.n_frames,
        "horizon": base.horizon,
        "floor": 2 * model.geom("floor").size[0],
        "grid": base.grid_size,
        "agent": base.n_agents,
        "teams": find(env, maax.TeamMembership).team_index.tolist(),
        "gear": {number(x) for x in model.actuator_gear[:, 0]},
        "radius of agents": model.geom("agent0").size[0],
        "half of boxes": tuple(model.geom("box0").size.tolist()),
        "ramp": tuple(np.round(np.ptp(corners, axis=0), 6).tolist()),
        "wall heights": {
            2 * model.geom(i).size[2] for i in range(model.ngeom) if model.geom(i).name.startswith("wall")
        },
        "door cells": walls.door_size,
        "scenario": walls.scenarios,
        "ranges": {name: tuple(round(float(x), 6) for x in pair) for name, pair in env.default_params.items()},
        "lock": (locks.lock_type, locks._reach._radius, locks._reach._sight is not None),
        "lock of agents": env.action_space["lock"].shape,
        "locked": [m.name for m in locks.modules],
        "grab": (grabs._reach._radius, grabs.exclusive, grabs._reach._sight is not None),
        "grab of agents": env.action_space["grab"].shape,
        "grabbed": [m.name for m in grabs.modules],
        "cone": 2 * find(env, maax.LineOfSight).half_cone,
        "lidar": (lidar.n_rays, lidar.range, lidar.frame, lidar.compress),
        "reward": (reward.rew_type, reward.by, reward.scale),
        "rect": tuple(rect.rect.tolist()),
        "penalty": rect.penalty,
        "objects too": rect.penalize_objects_out,
        "prep": find(env, maax.PreparationPhase).n_steps,
    }
    bins = env.action_space["move"].nvec
    assert bins.shape == (4, 3)
    numbers["bins"] = int(bins.min()) if bins.min() == bins.max() else bins
    for kind in kinds:
        friction = of(kind, model.ngeom, model.geom, lambda i: number(model.geom_friction[i, 0]))
        numbers[f"friction of {kind}"] = friction
    for kind in kinds[2:]:
        numbers[f"mass of {kind}"] = of(kind, model.nbody, model.body, lambda i: number(model.body_mass[i]))
        numbers[f"damping of {kind}"] = {tuple(x) for body, x in joints.items() if body.startswith(kind)}
    return numbers


@pytest.mark.parametrize("name", OPENAI)
def test_the_numbers_of_openai(name, game):
    got, want = built(game(name)), NUMBERS[name]
    assert set(got) == set(want)
    wrong = {key: (got[key], want[key]) for key in want if got[key] != want[key]}
    assert wrong == {}


@pytest.mark.parametrize("name", OPENAI)
def test_wrappers_of_openai_in_order(name, game):
    """Rewards and the rectangle inside the preparation, so that both are zero in it; bins outside."""
    kinds = [type(w).__name__ for w in game(name).layers][::-1]
    inner = ["TeamMembership", "AgentAgentContactMask2D", "LineOfSight", "Lidar", "LockObjects", "GrabObjects"]
    outer = ["HideAndSeekReward", "RestrictAgentsRect", "PreparationPhase", "TrackStats", "DiscretizeActions"]
    assert kinds[:11] == inner + outer


SHAPES = {
    "hide_and_seek_quadrant": {"box_obs": (4, 2, 9 + 3 + 2), "ramp_obs": (4, 1, 9 + 2), "sees_box": (4, 2)},
    "hide_and_seek_full": {"box_obs": (4, 9, 9 + 3 + 3 + 2), "ramp_obs": (4, 2, 9 + 3 + 2), "sees_box": (4, 9)},
}


@pytest.mark.parametrize("name", OPENAI)
def test_shapes_of_openai(name, game):
    """Boxes: place and motion, 9, and extents, 3, where elongated ones are; locks, 3; holds, 2."""
    shapes = {key: x.shape for key, x in game(name).observation_space.items()}
    alike = {"agent_qpos_qvel_self": (4, 8), "agent_qpos_qvel": (4, 3, 8), "lidar": (4, 30, 1), "sees_agent": (4, 3)}
    want = SHAPES[name] | alike | {"prep_remaining": (4, 1), "agent_team_self": (4, 1), "contact_mask": (4, 3)}
    assert {key: shapes[key] for key in want} == want
    assert not {"agent_pos", "agent_angle", "box_lock", "ramp_lock", "box_pull", "ramp_pull"} & set(shapes)


# --- played ----------------------------------------------------------------------------------------------------

GAMES = [name for name in NAMES if name != "standard"]
BATCH = dict.fromkeys(GAMES, 4) | dict.fromkeys(OPENAI, 64)


@pytest.fixture(scope="module")
def played(game):
    """By name: the game, the actions, and the states of a batch at reset and after each of two steps, on the host; and
    the first of these on the device, with the step.

    All agents want to lock and grab.
    """

    @cache
    def play(name):
        env = game(name)
        keys = jax.random.split(seeds.key(0), BATCH[name])
        reset, step, sample = (jax.jit(jax.vmap(f)) for f in (env.reset, env.step, env.sample_action))
        states, actions = [reset(keys)], []
        for t in range(2):
            action = jax.device_get(sample(jax.random.split(seeds.key(t), BATCH[name])))
            action |= {key: np.ones_like(action[key]) for key in ("lock", "grab") if key in action}
            states.append(step(states[-1], action))
            actions.append(action)
        return env, actions, [jax.device_get(state.replace(key=())) for state in states], (states[0], step)

    return play


@pytest.mark.slow
@pytest.mark.parametrize("name", GAMES)
def test_every_game(name, played):
    """Observations are in their space and of the state after the step; rewards are finite."""
    env, actions, trail, _ = played(name)
    agents = env.base.agents
    for t, state in enumerate(trail):
        for w in range(BATCH[name]):
            assert env.observation_space.contains({key: x[w] for key, x in state.obs.items()})
        assert all(np.isfinite(x).all() for x in state.obs.values())
        assert state.reward.shape == (BATCH[name], env.base.n_agents)
        assert np.isfinite(state.reward).all()
        assert (state.step == t).all()
        assert not any(state.metrics[key].any() for key in ("physics_fault", "layout_invalid", "contact_overflow"))
        own = np.concatenate([state.data.qpos[:, agents.qpos_ids], state.data.qvel[:, agents.qvel_ids]], axis=2)
        assert state.world.active["agent"].all()
        for w, i in np.ndindex(own.shape[:2]):
            told = state.obs["agent_qpos_qvel_self" if "agent_qpos_qvel_self" in state.obs else "obs"][w, i]
            assert (np.lib.stride_tricks.sliding_window_view(told, 8) == own[w, i]).all(axis=1).any()
    assert (trail[1].data.qpos[:, agents.qpos_ids] != trail[0].data.qpos[:, agents.qpos_ids]).any()
    for action in actions:
        assert env.action_space.contains({key: x[0] for key, x in action.items()})


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in GAMES if name.startswith("hide")])
def test_preparation_and_statistics_under_jit(name, played):
    """Seekers' motors rest and nobody is rewarded; statistics are of the state, whatever is observed."""
    env, _, trail, _ = played(name)
    ctrl = env.base.agents.ctrl_ids
    for state in trail[1:]:
        assert not state.data.ctrl[:, ctrl[2:]].any()
        assert state.data.ctrl[:, ctrl[:2]].any()
        assert not state.reward.any()
        for kind, module in (("box", "box"), ("ramp", "ramp")):
            way = np.linalg.norm(centres(env, state, module) - centres(env, trail[0], module), axis=-1)
            way = np.where(state.world.active[kind], way, 0)
            close(state.metrics[f"max_{kind}_move"], way.max(axis=1), atol=1e-6)
        before = trail[int(state.step[0]) - 1]
        ran = np.linalg.norm(centres(env, state, "agent") - centres(env, before, "agent"), axis=-1)
        ran += before.metrics["distance_run"]
        assert ran.any()
        close(state.metrics["distance_run"], ran, atol=1e-6)


def centres(env, state, name):
    """(worlds, n, 2) metres."""
    return np.asarray(state.data.qpos)[:, env.base.modules[name].qpos_ids[:, :2]]


@pytest.mark.slow
def test_where_things_start_in_the_quadrant(played):
    """Hiders anywhere, seekers outside the quadrant, boxes inside, ramps anywhere; one door or two, alike often."""
    env, _, trail, _ = played("hide_and_seek_quadrant")
    start = trail[0]
    low, high = start.world.plan.quadrant[:, None, :2] * CELL, start.world.plan.quadrant[:, None, 2:] * CELL

    def inside(xy):
        return ((xy > low) & (xy < high)).all(axis=-1)

    agents, boxes, ramps = (inside(centres(env, start, name)) for name in ("agent", "box", "ramp"))
    assert not agents[:, 2:].any()
    assert boxes.all()
    for anywhere in (agents[:, :2], ramps):
        assert 0.05 < anywhere.mean() < 0.5
    doors = start.world.plan.door_mask.sum(axis=1)
    assert set(doors) == {1, 2}
    assert 0.2 < (doors == 1).mean() < 0.8


@pytest.mark.slow
def test_where_things_start_in_the_full_game(played):
    """Everyone within 0.5 m of the first of the team; the first anywhere; outer walls in half of the worlds."""
    env, _, trail, _ = played("hide_and_seek_full")
    xy = centres(env, trail[0], "agent")
    for first in (0, 2):
        assert np.linalg.norm(xy[:, first + 1] - xy[:, first], axis=-1).max() <= 0.5
        assert (xy[:, first].min(axis=0) < 1.5).all()
        assert (xy[:, first].max(axis=0) > 4.5).all()
    outer = (trail[0].world.plan.wall_heights == 4.0).any(axis=1)
    assert 0.2 < outer.mean() < 0.8
    assert set(trail[0].world.plan.room_mask.sum(axis=1)) == {1, 2, 3, 4}
    assert trail[0].world.active["ramp"].all()
    assert set(trail[0].world.active["box"].sum(axis=1)) == set(range(3, 10))


@pytest.mark.slow
@pytest.mark.parametrize("name", OPENAI)
def test_locks_and_holds_are_at_their_objects(name, played):
    """All want to lock and hold in the first step; only hiders may, as it is the preparation. Nothing is turned yet.

    One hider stands beside a box and looks at it, the other beside a ramp. Nobody handles what it does not see.
    """
    env, actions, trail, (state, step) = played(name)
    start, n, agents = trail[0], BATCH[name], env.base.agents
    data, worlds = state.data, np.arange(n)
    for hider, module, of in ((0, "box", 2), (1, "ramp", env.base.modules["ramp"].n_max)):
        beside = centres(env, start, module)[worlds, worlds % of] + [0.45, 0]
        ids = agents.qpos_ids[hider, :2]
        yaw = agents.qpos_ids[hider, 3]
        data = data.replace(qpos=data.qpos.at[:, ids].set(beside).at[:, yaw].set(-np.pi / 2))
    data = jax.jit(jax.vmap(env.base.engine.pose))(state.world.fields, data)
    looked = jax.jit(jax.vmap(find(env, maax.LineOfSight).observe))(state.replace(data=data))
    start = state.replace(data=data, mechanics=looked.mechanics)
    after = jax.device_get(step(start, actions[0]).obs)
    xy = centres(env, start, "agent")
    away = {}
    for kind, module in (("box", "box"), ("ramp", "ramp")):
        half = np.full((1, 1, 2), 0.25)
        if kind == "box" and name == "hide_and_seek_full":
            half = start.world.extents["box"][..., :2] / 2
        gap = np.abs(xy[:, :, None] - centres(env, start, module)[:, None]) - half[:, None]
        distance = np.linalg.norm(np.maximum(gap, 0), axis=-1)
        seen = np.asarray(start.mechanics["line_of_sight"][f"sees_{module}"])
        away[kind] = np.where(np.asarray(start.world.active[kind])[:, None] & seen, distance, np.inf)
    held = np.concatenate([away["box"], away["ramp"]], axis=2)[:, :2]
    nearest, reached = held.argmin(axis=2), held.min(axis=2) <= REACH
    assert reached.sum() > n
    first = {"box": 0, "ramp": away["box"].shape[2]}
    n_locked = 0
    for kind in ("box", "ramp"):
        obs, near = after[f"{kind}_obs"], away[kind][:, :2] <= REACH
        columns = obs[..., -5:] if kind == "box" or name == "hide_and_seek_full" else obs[..., -2:]
        for w, k in np.ndindex(*near.shape[::2]):
            mine = reached[w] & (nearest[w] == first[kind] + k)
            equal(columns[w, :, k, -2], [*mine, False, False])
            equal(columns[w, :, k, -1], [mine.any()] * 4)
            if columns.shape[-1] == 5:
                locked = near[w, :, k].any()
                n_locked += locked
                owners = columns[w, :, k, 0]
                assert owners.sum() == locked
                assert not owners[2:].any()
                assert not owners[:2][~near[w, :, k]].any()
                equal(columns[w, :, k, 1], [locked, locked, False, False])
                equal(columns[w, :, k, 2], [locked] * 4)
    assert n_locked > n / 2
    assert {0, 1, first["ramp"]} <= set(nearest[reached])


# --- what agents observe ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def told():
    """`told(name, observations, ...)`: made-up observations of a game, and what its agents make of them; no physics."""

    @cache
    def raw(name):
        env = make(name, observations="raw")
        shape = jax.eval_shape(env.reset, seeds.key(0))
        mechanics = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shape.mechanics)
        return env, shape.replace(step=jnp.zeros((), jnp.int32), mechanics=mechanics)

    def tell(name, observations, observe="self"):
        env, state = raw(name)
        rng = seeds.rng(0)
        obs = {
            key: rng.random(x.shape) < 0.5 if x.dtype == np.int8 else rng.normal(size=x.shape).astype(np.float32)
            for key, x in env.observation_space.items()
        }
        active = rng.random(env.base.n_agents) < 0.6
        world = state.world.replace(active=state.world.active | {"agent": jnp.asarray(active)})
        state = state.replace(obs={key: jnp.asarray(x) for key, x in obs.items()}, world=world)
        told = observed_by_agents(env, observations, observe)
        for layer in told.layers[::-1][len(env.layers) :]:
            state = layer.observe(state)
        return obs, {key: np.asarray(x) for key, x in state.obs.items()}, active

    return tell


def split_oracle(name, obs):
    """What each agent gets, as a list of dicts."""
    n = len(obs["agent_mask"])
    own = ["agent_qpos_qvel", "agent_team", "agent_mask"]
    own += {"tag": ["is_it"], "capture_the_flag": ["carries", "is_out"]}.get(name, [])
    per_agent = ("prep_remaining", "team_size", "lidar", "sees_box", "sees_ramp", "flag_is_own", "score_is_own")
    agents = []
    for i in range(n):
        others = [(i - j) % n for j in range(1, n)]
        mine = {}
        for key, x in obs.items():
            if key in own:
                mine[f"{key}_self"], mine[key] = x[i], np.stack([x[j] for j in others])
            elif key in ("contact_mask", "sees_agent"):
                mine[key] = np.array([x[i, j] for j in others])
            elif key in per_agent:
                mine[key] = x[i]
            elif not key.endswith(("_lock", "_pull")) and key not in ("agent_pos", "agent_angle"):
                mine[key] = x
        for kind in ("box", "ramp"):
            for what in ("lock", "pull"):
                if f"{kind}_{what}" in obs:
                    pairs = zip(mine[f"{kind}_obs"], obs[f"{kind}_{what}"][i], strict=True)
                    mine[f"{kind}_obs"] = np.array([[*row, *extra] for row, extra in pairs], np.float32)
        agents.append(mine)
    return agents


@pytest.mark.parametrize("name", GAMES)
def test_split_observations(name, told):
    obs, got, _ = told(name, "split")
    want = split_oracle(name, obs)
    assert set(got) == set(want[0])
    for i, mine in enumerate(want):
        for key, x in mine.items():
            equal(got[key][i], x, err_msg=key)


@pytest.mark.parametrize("name", GAMES)
def test_flat_observations(name, told):
    """All by name in one vector; zero is what is not seen, where there is vision, and all of agents that do not play.

    A critic sees the same unhidden.
    """
    obs, got, active = told(name, "flat", observe="all")
    vectors, masks, whole, hidden = [], [], [], 0
    for mine in split_oracle(name, obs):
        whole.append(np.concatenate([np.float32(mine[key]).ravel() for key in sorted(mine)]))
        seen = {"box_obs": "sees_box", "ramp_obs": "sees_ramp"}
        seen |= dict.fromkeys(("agent_qpos_qvel", "agent_team"), "sees_agent")
        shows = {key: np.ones(np.shape(x), bool) for key, x in mine.items()}
        for key, mask in seen.items():
            if mask in mine:
                shows[key] = np.stack([x & shown for x, shown in zip(shows[key], mine[mask], strict=True)])
                mine[key] = np.stack([x if shown else 0 * x for x, shown in zip(mine[key], mine[mask], strict=True)])
                hidden += (~mine[mask]).sum()
        vectors.append(np.concatenate([np.float32(mine[key]).ravel() for key in sorted(mine)]))
        masks.append(np.concatenate([shows[key].ravel() for key in sorted(mine)]))
    equal(got["obs"], np.where(active[:, None], vectors, 0))
    equal(got["obs_mask"], np.array(masks) & active[:, None])
    assert (hidden > 0) == (name in OPENAI)
    equal(got["critic"][:, : len(whole[0])], whole)
    assert set(got) == {"obs", "obs_mask", "critic"}


def test_raw_observations_are_left():
    env = make("hide_and_seek_quadrant", observations="raw")
    assert isinstance(env, maax.DiscretizeActions)


# --- what was broken -------------------------------------------------------------------------------------------


def test_the_tests_named_above_are_there():
    named = re.findall(r"(test_\w+\.py)::(test_\w+)", __doc__)
    assert len(named) > 15
    for file, test in named:
        assert f"def {test}(" in next(Path(__file__).parents[1].rglob(file)).read_text(), test
