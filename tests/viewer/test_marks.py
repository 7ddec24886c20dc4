"""Mechanics that draw themselves: a user's, and several layers of one class."""

from __future__ import annotations

import inspect
import textwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.opengl import skipped_without_opengl
from matplotlib.figure import Figure

import maax_mjx as maax
from maax_mjx.viewer import draw_plan
from maax_mjx.viewer.canvas import Canvas, Marked
from maax_mjx.viewer.marks import marks_for
from maax_mjx.viewer.stage import Stage

CHARGES = np.array([1.0, 0.25, 0.0])


def room(n_agents=3, **options):
    env = maax.Base(n_agents, impl="c", **options)
    env.add_module(maax.WallScenarios("empty", outer="none"))
    env.add_module(maax.Agents(n_agents, maax.uniform_placement))
    return env


@pytest.fixture(scope="module")
def example():
    """The battery of the docstring: (environment, a state with its charges set)."""
    code = inspect.getdoc(maax.marks_of).split("```python\n")[1].split("```")[0]
    names = {"maax": maax, "jnp": jnp}
    exec(textwrap.dedent(code), names)
    env = names["Battery"](room())
    state = env.step(env.reset(seeds.key(0)), {"move": jnp.ones((3, 3))})
    np.testing.assert_allclose(state.mechanics["battery"], 0.99, rtol=1e-6)
    return env, jax.device_get(state.replace(mechanics={"battery": CHARGES}))


def test_the_example_of_the_docstring_draws_a_battery_over_every_agent(example):
    env, state = example
    frame = Stage(env).frame(state)
    bars = {line.name: line for line in frame.lines if line.role == "mark"}
    labels = {label.name: label for label in frame.labels if label.role == "label"}
    assert {label.text for label in labels.values()} == {"100%", "25%", "0%"}
    for agent, charge in enumerate(CHARGES):
        (ends,) = bars[f"battery:bar{agent}"].points
        assert ends[1, 0] - ends[0, 0] == pytest.approx(0.4 * charge)
        over = labels[f"battery:charge{agent}"].position - state.data.xpos[env.base.agents.body_ids[agent]]
        np.testing.assert_allclose(over, [0.0, 0.0, 0.5], atol=1e-6)


@pytest.mark.parametrize("view", ["plan", "3d"])
def test_the_battery_is_in_the_pixels_where_the_agent_is(example, view):
    """What changes in the picture with one agent's charge lies as the agents do."""
    env, state = example
    places = np.array([[1.5, 1.5], [4.5, 1.5], [3.0, 4.5]])
    xpos = np.array(state.data.xpos)
    xpos[env.base.agents.body_ids, :2] = places

    def picture(charges):
        shown = state.replace(data=state.data.replace(xpos=xpos), mechanics={"battery": charges})
        return maax.render(env, shown, view=view, size=(300, 300), camera="top").astype(int)

    with skipped_without_opengl():
        full = picture(np.ones(3))
    found = []
    for agent in range(3):
        y, x = np.nonzero(np.abs(picture(np.where(np.arange(3) == agent, 0.25, 1.0)) - full).max(axis=-1) > 40)
        assert len(x) > 5
        found.append([x.mean(), -y.mean()])
    ways, expected = np.diff(found, axis=0), np.diff(places, axis=0)
    scale = np.linalg.norm(ways) / np.linalg.norm(expected)
    assert 300 / 6 * 0.7 < scale < 300 / 6 * 1.1, "a floor of 6 m takes most of the picture"
    np.testing.assert_allclose(ways, scale * expected, atol=0.3 * scale)


def test_a_plan_has_the_bars_and_the_labels(example):
    env, state = example
    ax = Figure().add_subplot()
    draw_plan(ax, env, state)
    assert sorted(text.get_text() for text in ax.texts) == ["0%", "100%", "25%"]
    for agent, charge in enumerate(CHARGES):
        start = state.data.xpos[env.base.agents.body_ids[agent], 0] - 0.2
        ends = [line.get_xdata() for line in ax.lines]
        assert any(np.allclose(xs, [start, start + 0.4 * charge], atol=1e-5) for xs in ends), agent


def test_the_battery_is_in_a_replay(example, monkeypatch):
    """Every bar and every charge is a node of the page's scene, and is moved while it plays."""
    viser = pytest.importorskip("viser")
    nodes = {}

    def keeps(add):
        def kept(scene, name, *args, **options):
            nodes[name] = add(scene, name, *args, **options)
            return nodes[name]

        return kept

    for method in ("add_label", "add_line_segments"):
        monkeypatch.setattr(viser.SceneApi, method, keeps(getattr(viser.SceneApi, method)))
    env, state = example
    maax.replay(env, [state, state.replace(step=state.step + 60, mechanics={"battery": CHARGES / 2})])
    for agent, charge in enumerate(CHARGES / 2):
        assert nodes[f"/world0/battery_charge{agent}"].text == f"{charge:.0%}"
        (ends,) = nodes[f"/world0/battery_bar{agent}"].points
        assert ends[1, 0] - ends[0, 0] == pytest.approx(0.4 * charge, abs=1e-3)


class Painted(maax.Wrapper):
    """A wrapper that does nothing."""


def test_words_tints_and_parts_in_place_of_others(example):
    class Painting(Painted):
        name = "painting"

    @maax.marks_of(Painting)
    def paint(layer, state, canvas):
        canvas.write("painted")
        canvas.note("of late")
        canvas.tint("agent", 1, (1.0, 0.0, 0.0, 1.0), 1.0)
        canvas.replace("agent0:hand_left", "box", (0.1, 0.2, 0.3), (1.0, 2.0, 3.0), (0.0, 1.0, 0.0, 1.0))
        canvas.replace("nobody", "sphere", (0.1,), (1.0, 2.0, 3.0), (0.0, 1.0, 0.0, 1.0))
        canvas.solid("cone", "sector", (0.5, 0.3), canvas.position(0), (0.0, 0.0, 1.0, 0.5))

    env = Painting(room())
    state = jax.device_get(env.reset(seeds.key(0)))
    frame = Stage(env).frame(state)
    parts = {part.name: part for part in frame.parts}
    assert frame.text[0].endswith("of late")
    assert frame.text[-1] == "painted"
    assert parts["agent1"].shape.rgba == (1.0, 0.0, 0.0, 1.0)
    assert parts["agent0"].shape.rgba == pytest.approx(env.base.agents.colours[0])
    hand = parts["agent0:hand_left"]
    assert (hand.role, hand.shape.kind, hand.shape.size) == ("hand", "box", (0.1, 0.2, 0.3))
    np.testing.assert_array_equal(hand.position, [1.0, 2.0, 3.0])
    assert "nobody" not in parts
    assert parts["painting:cone"].role == "mark"
    assert maax.render(env, state, view="plan", size=(64, 64)).std() > 0
    assert paint is not None, "the decorator gives back what it decorates"


def test_subclasses_are_drawn_as_the_nearest_class_is():
    class Under(Painted):
        pass

    class Over(Under):
        pass

    class Own(Under):
        pass

    said = []
    maax.marks_of(Under)(lambda layer, state, canvas: said.append(("under", type(layer).__name__)))
    maax.marks_of(Own)(lambda layer, state, canvas: said.append(("own", type(layer).__name__)))
    env = Own(Over(Under(room())))
    Stage(env).frame(jax.device_get(env.reset(seeds.key(0))))
    assert said == [("under", "Under"), ("under", "Over"), ("own", "Own")]
    assert len({mark.layer for mark in marks_for(env)}) == 3, "layers without a name have one for their marks"


def test_a_class_of_marks_is_made_once_for_every_layer():
    class Counted(Painted):
        pass

    made, drawn = [], []

    @maax.marks_of(Counted)
    class Marks:
        def __init__(self, layer):
            made.append(layer)

        def __call__(self, state, canvas):
            drawn.append(self)

    inside = Counted(room())
    env = Counted(inside)
    state, stage = jax.device_get(env.reset(seeds.key(0))), Stage(env)
    stage.frame(state)
    stage.frame(state)
    assert made == [inside, env]
    assert len(drawn) == 4
    assert len(set(drawn)) == 2


def test_marks_of_a_sense_are_drawn_where_a_picture_asks_for_them():
    class Smell(Painted):
        pass

    @maax.marks_of(Smell, sense="vision")
    def draw(layer, state, canvas):
        canvas.write("smells")

    env = Smell(room())
    state = jax.device_get(env.reset(seeds.key(0)))
    assert "smells" not in Stage(env).frame(state).text
    assert "smells" in Stage(env, vision=True).frame(state).text
    with pytest.raises(ValueError, match="lidar: got True, and env has no Lidar; takes True"):
        Stage(env, lidar=True)


def test_two_layers_of_locks_are_drawn_each_with_its_own():
    """Boxes by one layer, ramps by another: every padlock is on what its layer locks, by whom it says."""
    env = maax.TeamMembership(maax.make("standard", impl="c", n_hiders=2, n_seekers=1, n_boxes=1, n_ramps=1))
    env = maax.LockObjects(env, objects=["box"], action_name="box_lock")
    env = maax.LockObjects(env, objects=["ramp"], action_name="ramp_lock")
    state = jax.device_get(env.reset(seeds.key(0)))
    locked = {}
    for name, owner in (("box_locks", 2), ("ramp_locks", 1)):
        memory = state.mechanics[name]
        locked[name] = memory.replace(owner=np.array([owner]), locked=np.array([True]))
    frame = Stage(env).frame(state.replace(mechanics=state.mechanics | locked))
    locks = {label.name: label for label in frame.labels if label.role == "lock"}
    assert set(locks) == {"box_locks:box0", "ramp_locks:ramp0"}
    for name, kind, agent in (("box_locks:box0", "box", 2), ("ramp_locks:ramp0", "ramp", 1)):
        body = state.data.xpos[env.base.modules[kind].body_ids[0]]
        np.testing.assert_allclose(locks[name].position[:2], body[:2], atol=2e-3)
        assert locks[name].rgba == pytest.approx(env.base.agents.colours[agent])


def test_agents_have_their_names_and_the_colour_of_their_team():
    env = maax.make("tag", impl="c")
    base = room(3)
    teams = maax.TeamMembership(base, team_index=[1, 0, 1])
    players = [f"player_{i}" for i in range(4)]
    for made, names in ((env, players), (teams, ["team_1_0", "team_0_0", "team_1_1"])):
        frame = Stage(made).frame(jax.device_get(made.reset(seeds.key(0))))
        labels = {label.name: label for label in frame.labels if label.role == "name"}
        for slot, name in enumerate(names):
            (team,) = (team for team in made.teams.values() if slot in team.slots)
            label = labels[f"agent{slot}:name"]
            assert (label.text, label.rgba) == (name, pytest.approx(team.colour))
            assert made.agent_names[slot] == name
        words = " ".join(frame.text)
        assert all(name in words for name in made.teams)


def test_tag_marks_who_is_it():
    env = maax.make("tag", impl="c")
    state = jax.device_get(env.reset(seeds.key(0)))
    for it in range(env.n_agents):
        now = state.replace(mechanics=state.mechanics | {"tag": state.mechanics["tag"].replace(it=np.array(it))})
        (disc,) = Stage(env).frame(now).named("it")
        over = disc.position - state.data.xpos[env.base.agents.body_ids[it]]
        np.testing.assert_allclose(over, [0.0, 0.0, 0.2], atol=1e-6)


def test_capture_the_flag_marks_flags_scores_and_who_is_out():
    env = maax.make("capture_the_flag", impl="c")
    state = jax.device_get(env.reset(seeds.key(0)))
    out = np.array([False, False, True, False])
    game = state.mechanics["capture_the_flag"].replace(carrier=np.array([-1, 1]), out=out, score=np.array([1, 2]))
    frame = Stage(env).frame(state.replace(mechanics=state.mechanics | {"capture_the_flag": game}))
    parts = {part.name: part for part in frame.parts}
    assert frame.text[-1] == "score  blues 1 : reds 2"
    bases, carrier = state.world.sites["flag"], state.data.xpos[env.base.agents.body_ids[1]]
    for flag, (team, foot) in enumerate(zip(env.teams.values(), (bases[0], carrier), strict=True)):
        np.testing.assert_allclose(parts[f"capture_the_flag:{flag}:pole"].position[:2], foot[:2], atol=1e-6)
        assert parts[f"capture_the_flag:{flag}:cloth"].shape.rgba == pytest.approx(team.colour)
        assert parts[f"flag{flag}"].shape.rgba == pytest.approx(team.colour)
    for slot, is_out in enumerate(out):
        own = pytest.approx(env.base.agents.colours[slot])
        assert (parts[f"agent{slot}"].shape.rgba != own) == is_out


@pytest.fixture(scope="module")
def dinner():
    """Two pieces of food of 4 units, and a third that may be there: (environment, a state in which it is not)."""
    env = maax.Base(3, impl="c")
    env.add_module(maax.WallScenarios("empty", outer="none"))
    env.add_module(maax.Agents(3, [maax.at_placement(x, 5.2) for x in (0.7, 3.0, 5.3)]))
    env.add_module(maax.Food((2, 3), placement_fn=[maax.at_placement(*at) for at in ((1.5, 1.5), (4.5, 3.0), (3, 1))]))
    env = maax.EatFood(env, max_health=4)
    state = jax.device_get(env.reset(seeds.key(0)))
    active = state.world.active | {"food": np.array([True, True, False])}
    return env, state.replace(world=state.world.replace(active=active))


def eaten(state, health, units=0.0):
    meals = state.mechanics["eat_food"].replace(health=np.array(health), eaten=np.array([units, units, 0.0]))
    return state.replace(mechanics=state.mechanics | {"eat_food": meals})


def test_food_darkens_as_it_is_eaten(dinner):
    env, state = dinner
    fresh, half = (Stage(env).frame(eaten(state, health, 1.5)) for health in ([4.0, 4.0, 0.0], [4.0, 2.0, 0.0]))
    colours = [{part.name: np.array(part.shape.rgba) for part in frame.parts} for frame in (fresh, half)]
    assert half.text[-1] == "eaten 3"
    np.testing.assert_allclose(colours[1]["food0"], colours[0]["food0"])
    assert colours[1]["food1"][:3].sum() < colours[0]["food1"][:3].sum() - 0.1
    empty = {part.name: np.array(part.shape.rgba) for part in Stage(env).frame(eaten(state, [4.0, 0.0, 0.0])).parts}
    assert empty["food1"][:3].sum() < colours[1]["food1"][:3].sum() - 0.1
    assert "food2" not in empty


@pytest.mark.parametrize("view", ["plan", "3d"])
def test_eaten_food_is_in_the_pixels_where_it_lies(dinner, view):
    env, state = dinner

    def picture(health, units=0.0):
        shown = eaten(state, health, units)
        return maax.render(env, shown, view=view, size=(300, 300), camera="top").astype(int)

    with skipped_without_opengl():
        full = picture([4.0, 4.0, 0.0])
    found = []
    for health in ([0.0, 4.0, 0.0], [4.0, 0.0, 0.0]):
        y, x = np.nonzero(np.abs(picture(health) - full).max(axis=-1) > 20)
        assert len(x) > 3
        found.append([x.mean(), -y.mean()])
    way, expected = np.diff(found, axis=0)[0], np.diff(state.world.sites["food"][:2, :2], axis=0)[0]
    scale = np.linalg.norm(way) / np.linalg.norm(expected)
    assert 300 / 6 * 0.7 < scale < 300 / 6 * 1.1, "a floor of 6 m takes most of the picture"
    np.testing.assert_allclose(way, scale * expected, atol=0.3 * scale)


class Drawn(Painted):
    """A wrapper with marks."""


maax.marks_of(Drawn)(lambda layer, state, canvas: None)


WRONG = {
    "twice": (lambda: maax.marks_of(Drawn), "mechanic: got Drawn, which <lambda> draws already; takes a class without"),
    "one of ours": (lambda: maax.marks_of(maax.Tag), "mechanic: got Tag, which draw_it draws already"),
    "a module": (lambda: maax.marks_of(maax.Agents), "mechanic: got Agents; takes a subclass of Wrapper"),
    "an instance": (lambda: maax.marks_of(Drawn(room())), "mechanic: got Drawn; takes a subclass of Wrapper"),
    "no class": (lambda: maax.marks_of("tag"), "mechanic: got 'tag'; takes a subclass of Wrapper"),
    "not called": (lambda: maax.marks_of(Painted)(3), "marks_of: got 3; takes a function"),
    "sense": (lambda: maax.marks_of(Painted, sense="smell"), "sense: got 'smell'; takes one of"),
}


@pytest.mark.parametrize("case", WRONG)
def test_registrations_that_are_refused(case):
    call, message = WRONG[case]
    with pytest.raises(ValueError, match=message):
        call()


RED, HERE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
WRONG_MARKS = {
    "kind": (lambda c: c.solid("a", "cube", (1.0,), HERE, RED), "kind: got 'cube'; takes one of"),
    "size": (lambda c: c.solid("a", "box", (1.0, 1.0), HERE, RED), r"size: got \(1.0, 1.0\); takes 3 finite numbers"),
    "position": (lambda c: c.label("a", "text", (0.0, 0.0)), r"position: got \(0.0, 0.0\); takes 3 finite numbers"),
    "nan": (lambda c: c.label("a", "text", (0.0, 0.0, np.nan)), "position: got .* takes 3 finite numbers"),
    "colour": (lambda c: c.label("a", "text", HERE, "red"), "colour: got 'red'; takes 4 finite numbers"),
    "ends": (lambda c: c.line("a", [HERE], RED), r"ends: got the shape \(1, 3\); takes \(2, 3\) metres"),
    "width": (lambda c: c.line("a", [HERE, HERE], RED, width=0), "width: got 0; takes a positive number"),
    "tinted kind": (lambda c: c.tint("robot", 0, RED, 1.0), r"kind: got 'robot'; takes one of \['agent'\]"),
    "share": (lambda c: c.tint("agent", 0, RED, 2.0), r"share: got 2.0; takes a number in \[0, 1\]"),
}


@pytest.mark.parametrize("case", WRONG_MARKS)
def test_marks_that_are_refused(case, example):
    env, state = example
    call, message = WRONG_MARKS[case]
    with pytest.raises(ValueError, match=message):
        call(Canvas(Stage(env).subject, state, Marked(), "mine"))


def test_a_mistake_in_marks_names_whose_they_are(monkeypatch):
    class Careless(maax.ObservationWrapper):
        name = "careless"

        def observation(self, state):
            return state.obs

    @maax.marks_of(Careless)
    def draw(layer, state, canvas):
        return {}["no such key"]

    env = Careless(maax.make("tag", impl="c"))
    with pytest.raises(ValueError, match="marks of 'careless': KeyError: 'no such key'"):
        Stage(env).frame(jax.device_get(env.reset(jax.random.key(0))))
