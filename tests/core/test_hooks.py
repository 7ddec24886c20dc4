"""Mistakes in modules and wrappers of one's own: each a sentence that names the class, where it is made."""

from __future__ import annotations

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.worldgen import Geom, ObjFromXML

FILE = """<mujoco><worldbody>
  <body name="annotation:outer_bound"><geom type="box" pos="0 0 .3" size=".4 .4 .3"/></body>
  <body name="main" pos="0 0 .3">{joints}{geoms}</body>
</worldbody></mujoco>"""
SLIDE = '<joint name="{}" type="slide" axis="{}"/>'
SLIDES = SLIDE.format("x", "1 0 0") + SLIDE.format("y", "0 1 0") + SLIDE.format("z", "0 0 1")
YAW = '<joint name="yaw" type="hinge" axis="0 0 2"/>'
GEOM = '<geom name="{}" type="box" size=".1 .1 .1"/>'
GOOD, BOX = SLIDES + YAW, GEOM.format("main")


class Things(maax.Entities):
    """What `made` makes by name, or what a file describes."""

    kind = "thing"

    def __init__(self, made, **options):
        super().__init__(1, (0.8, 0.8, 0.6), maax.uniform_placement, **options)
        self.made = made

    def make(self, name):
        return self.made(name)


def from_file(tmp_path, joints=GOOD, geoms=BOX):
    path = tmp_path / "thing.xml"
    path.write_text(FILE.format(joints=joints, geoms=geoms))
    return lambda name: ObjFromXML(path, name)


def add(module):
    env = maax.Base(1, impl="c")
    env.add_module(maax.Agents(1))
    env.add_module(module)
    return env


INSTEAD = r"What moves otherwise, as a door does on its hinge, is a subclass of Module"
TAKES = "takes 'x', 'y', 'z', slides along the axes, and 'yaw', a hinge about z, in this order"


@pytest.mark.parametrize(
    ("joints", "got"),
    [
        (YAW, "['yaw']"),
        ("", "[]"),
        (SLIDES, "['x', 'y', 'z']"),
        (YAW + SLIDES, "['yaw', 'x', 'y', 'z']"),
        (GOOD + '<joint name="lid" axis="1 0 0"/>', "['x', 'y', 'z', 'yaw', 'lid']"),
        (SLIDES + '<joint name="yaw" axis="1 0 0"/>', "['x', 'y', 'z', 'yaw']"),
        ('<freejoint name="free"/>', "['free']"),
    ],
)
def test_entities_with_other_joints_are_refused_when_they_are_added(tmp_path, joints, got):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        add(Things(from_file(tmp_path, joints)))
    message = str(error.value)
    assert message.startswith(f"make: Things(free=False) returned a body with the joints {got}; takes")
    assert TAKES in message
    assert INSTEAD in message


def test_joints_that_fit_are_taken(tmp_path):
    assert add(Things(from_file(tmp_path))).model.nq == 8
    free = lambda name: Geom("box", (0.3, 0.3, 0.3), name=name, free=True)  # noqa: E731
    assert add(Things(free, free=True)).model.nq == 4 + 7
    with pytest.raises(ValueError, match=r"Things\(free=True\) returned .* takes 'free', a free joint"):
        add(Things(from_file(tmp_path), free=True))


INNER = '<body name="lid"><joint name="hinge" type="ball"/>' + GEOM.format("lid") + "</body>"


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (lambda path: lambda name: None, "make: Things returned None; takes an object of maax_mjx.worldgen"),
        (lambda path: lambda name: Geom("sphere", (0.2,), name="ball"), "returned an object named 'ball'; takes one"),
        (lambda path: from_file(path, geoms=GEOM.format("top")), "without a geom named 'thing0'; takes one"),
        (
            lambda path: from_file(path, geoms=BOX + INNER),
            "returned an object with 'thing0:hinge', a ball joint; takes",
        ),
    ],
)
def test_what_make_returns_is_checked(tmp_path, made, says):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        add(Things(made(tmp_path)))
    assert says in str(error.value)


class Wind(maax.Module):
    """A module with the hooks that it is given."""

    name = "wind"

    def __init__(self, layout_step=None, observation_step=None):
        self.layout_hook, self.observation_hook = layout_step, observation_step

    def layout_step(self, key, layout, params):
        return layout if self.layout_hook is None else self.layout_hook(layout)

    def observation_step(self, world, data):
        return {} if self.observation_hook is None else self.observation_hook()


def put(name, value):
    return lambda layout: layout.replace(fields=layout.fields | {name: value})


OVERLAY = 'in which worlds do not differ; name its rows in Wind.overlay: {"dof_damping": ids}'
STEPS = {
    "None": (lambda layout: None, "layout_step: Wind returned None; takes the layout that it was given"),
    "a written field": (put("dof_damping", jnp.ones(4)), f"layout_step: Wind uses the field 'dof_damping', {OVERLAY}"),
    "a read field": (lambda layout: layout.fields["dof_damping"], f"Wind uses the field 'dof_damping', {OVERLAY}"),
    "rows of a field": (
        put("body_gravcomp", jnp.ones(1)),
        "layout_step: Wind returned 'body_gravcomp' with the shape (1,); takes (3,), the whole field",
    ),
    "some of qpos": (
        lambda layout: layout.replace(qpos=layout.qpos[:2]),
        "layout_step: Wind returned 'qpos' with the shape (2,); takes (8,), the whole field",
    ),
}


@pytest.mark.parametrize(("hook", "says"), STEPS.values(), ids=STEPS)
def test_layouts_are_checked(hook, says):
    env = maax.Base(1, impl="c")
    for module in (maax.Agents(1), maax.Boxes(1), Wind(hook)):
        env.add_module(module)
    with pytest.raises(ValueError) as error:  # noqa: PT011
        env.reset(seeds.key(0))
    assert says in str(error.value)


def test_other_key_errors_of_a_module_stay_what_they_are():
    with pytest.raises(KeyError, match="gust"):
        add(Wind(lambda layout: {}["gust"])).reset(seeds.key(0))


OBSERVED = {
    "None": (lambda: None, "returned None; takes a dict of arrays by name"),
    "an array": (lambda: jnp.ones(2), "takes a dict of arrays by name"),
    "a number": (lambda: {"speed": 0.5}, "returned 0.5 as 'speed'; takes an array"),
    "a list": (lambda: {"speed": [0.5]}, "returned list as 'speed'; takes an array"),
    "a number as name": (lambda: {3: jnp.ones(2)}, "returned an array under 3; takes names as text"),
}


class Sees(maax.ObservationWrapper):
    """Observes what it is given."""

    def __init__(self, env, hook):
        super().__init__(env)
        self.hook = hook

    def observation(self, state):
        return self.hook()


@pytest.mark.parametrize(("hook", "says"), OBSERVED.values(), ids=OBSERVED)
def test_observations_are_checked(hook, says):
    env = add(Wind(observation_step=hook))
    with pytest.raises(ValueError, match="observation_step: Wind ") as error:
        _ = env.observation_space
    assert says in str(error.value)
    with pytest.raises(ValueError, match="observation: Sees ") as error:
        _ = Sees(add(Wind()), hook).observation_space
    assert says in str(error.value)


def test_numpy_arrays_are_observations():
    assert add(Wind(observation_step=lambda: {"wind": np.ones(2)})).observation_space["wind"].shape == (2,)


class Nameless(maax.Module):
    """A module without a name."""


class Kindless(maax.Entities):
    """Entities without a kind."""


def test_modules_have_names_and_entities_kinds():
    with pytest.raises(ValueError, match="name: Nameless has None; takes a text of its own, in the class: name = "):
        add(Nameless())
    with pytest.raises(
        ValueError, match=r"kind: Kindless has None; takes a Python identifier such as .table., in the class"
    ):
        Kindless(1, (1, 1, 1), maax.uniform_placement)
    with pytest.raises(ValueError, match=r"kind: .* has 'team'; takes a Python"):
        type("Teams", (maax.Entities,), {"kind": "team"})(1, (1, 1, 1), maax.uniform_placement)


class Forgetful(maax.Wrapper):
    """A wrapper that keeps something without a name."""

    def begin(self, key, params):
        return self.remember(self.env.begin(key, params), jnp.zeros(2))


def test_a_wrapper_that_remembers_has_a_name():
    with pytest.raises(ValueError, match=r"remember: Forgetful has no name, .* name = 'forgetful'"):
        _ = Forgetful(add(Wind())).observation_space


class Smoke(maax.StateWrapper):
    """Blinds everybody."""

    def observe(self, state):
        return self.inner(maax.LineOfSight).blind(state, self.playing(state))


def test_senses_are_blinded_where_they_are_still_there():
    seeing = maax.LineOfSight(add(Wind()), objects=())
    assert Smoke(seeing).observation_space["sees_agent"].shape == (1, 1)
    with pytest.raises(ValueError, match="blind: 'sees_agent' of LineOfSight is not observed any more; put what"):
        _ = Smoke(maax.SelectObservations(seeing, ["agent_pos"])).observation_space


class ForgetsObserve(maax.StateWrapper):
    def observe(self, state):
        return None


class ForgetsTransition(maax.Wrapper):
    def transition(self, state, action):
        self.env.advance(state, action)


class ForgetsBegin(maax.Wrapper):
    def begin(self, key, params):
        self.env.begin(key, params)


class ForgetsAction(maax.ActionWrapper):
    def action(self, state, action):
        return None


class ForgetsReward(maax.RewardWrapper):
    def reward(self, state):
        return None


class OneReward(maax.RewardWrapper):
    def reward(self, state):
        return state.reward.sum()


class Counts(maax.RewardWrapper):
    def reward(self, state):
        return jnp.where(state.reward > 0, 1, 0)


def test_rewards_that_are_whole_numbers_count_as_floats():
    """A loop over steps keeps the types of what it began with."""
    env = Counts(maax.make("tag", impl="c", n_boxes=0, n_ramps=0, scenario="empty"))

    def plays(key):
        return env.step(env.reset(key), env.sample_action(key))

    assert jax.eval_shape(plays, seeds.key(0)).reward.dtype == jnp.float32


class FewActions(maax.ActionWrapper):
    def action(self, state, action):
        return {"move": action["move"][:2]}


class EndsOfAgents(maax.StateWrapper):
    def observe(self, state):
        return state.replace(terminated=jnp.ones(4, bool))


class EndOfNumbers(maax.StateWrapper):
    def observe(self, state):
        return state.replace(truncated=state.data.qpos[0])


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (FewActions, "action: FewActions returned 'move' of shape (2, 3); takes (4, 3), as what it wraps"),
        (EndsOfAgents, "terminated: EndsOfAgents returned bool[4]; takes one bool for the world"),
        (EndOfNumbers, "truncated: EndOfNumbers returned float32[]; takes one bool for the world"),
        (ForgetsObserve, "observe: ForgetsObserve returned None; takes the state of what it wraps"),
        (ForgetsTransition, "transition: ForgetsTransition returned None; takes the state of what it wraps"),
        (ForgetsBegin, "begin: ForgetsBegin returned None; takes the state of what it wraps"),
        (ForgetsAction, "action: ForgetsAction returned None; takes the action of what it wraps, a dict of ['move']"),
        (ForgetsReward, "reward: ForgetsReward returned None; takes an array (4,), one number for each agent"),
        (OneReward, "reward: OneReward returned"),
    ],
)
def test_wrappers_that_return_nothing_are_named(kind, message):
    env = kind(maax.make("tag", impl="c", n_boxes=0, n_ramps=0, scenario="empty"))

    def plays(key):
        return env.step(env.reset(key), env.sample_action(key))

    with pytest.raises(ValueError, match=re.escape(message)):
        jax.eval_shape(plays, seeds.key(0))


def test_an_overlay_of_no_field_is_refused():
    class Bends(maax.Module):
        name = "bends"

        @property
        def overlay(self):
            return {"geom_sise": [0]}

    env = maax.Base(1, impl="c")
    for module in (maax.WallScenarios("empty"), maax.Agents(1), Bends()):
        env.add_module(module)
    with pytest.raises(ValueError, match=r"overlay: Bends has 'geom_sise', which is no field.*such as 'geom_size'"):
        env.reset(seeds.key(0))


class Tires(maax.Wrapper):
    """Begins to remember at the first step."""

    name = "tires"

    def transition(self, state, action):
        return self.remember(self.env.advance(state, action), jnp.zeros(self.base.n_agents))


def test_a_memory_that_begin_does_not_give_is_refused(env_c):
    env = Tires(env_c)
    states = maax.Worlds(env, 2).reset(seeds.key(0))
    says = "remember: got a memory of Tires at a step, and not from begin; takes one from both: begin returns"
    with pytest.raises(ValueError, match=says):
        maax.Worlds(env, 2).step(states, maax.Worlds(env, 2).sample_action(seeds.key(1)))


def test_what_is_wrapped_gets_no_modules(env_c):
    says = r'add_module: got Boxes for TeamMembership, .* maax\.make\("tag", modules=\[\.\.\.\]\)'
    with pytest.raises(ValueError, match=says):
        maax.TeamMembership(env_c).add_module(maax.Boxes(1))


class HalfTires(maax.StateWrapper):
    """Has a transition of its own, and no begin."""

    def transition(self, state, action):
        return self.env.advance(state, action)


def test_a_kind_of_wrapper_without_its_method_is_refused_where_it_is_made(env_c):
    with pytest.raises(ValueError, match=r"^observe: HalfTires has none; takes a StateWrapper with a method of this"):
        HalfTires(env_c)
