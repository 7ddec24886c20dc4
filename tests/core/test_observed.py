"""Observations have axes: what is declared, who sees it, and what is refused."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.layers import observing
from helpers.seeds import key, rng

import maax_mjx as maax
from maax_mjx import Column, Observed
from maax_mjx.common.observed import POSITION, check_shapes, resolved

equal = np.testing.assert_array_equal
GAMES = [name for name in maax.tasks() if name != "standard"]


class Fuel(maax.ObservationWrapper):
    """A number that is each agent's own business; `table` is what it declares of it."""

    def __init__(self, env, table=None, value=None):
        super().__init__(env)
        self.table, self.value = table, value

    def observation(self, state):
        fuel = 10.0 + jnp.arange(self.n_agents) if self.value is None else self.value
        return state.obs | {"fuel": fuel}

    def declared(self):
        return self.env.declared() | ({} if self.table is None else {"fuel": self.table})


@functools.cache
def game(**fields):
    """One environment of every kind for all tests, under whose layers it is traced once."""
    return maax.make("hide_and_seek", impl="c", observations="raw", lock=None, **{"scenario": "empty"} | fields)


@functools.cache
def begun(inner, seed=0):
    """The first state of an environment, compiled once."""
    return inner.reset(key(seed))


def seen_in(env, inner):
    """What agents observe at first in an environment that is `inner` under more layers."""
    return jax.jit(observing(env, inner))(begun(inner)).obs


# --- who sees what -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flat", [False, True])
def test_a_private_number_reaches_its_agent_alone(flat):
    """The leak that began it all: (n_agents,) went to everybody as (n_agents, n_agents)."""
    env = maax.SplitObservations(Fuel(game(), Observed(("agent",))))
    if not flat:
        equal(seen_in(env, game())["fuel"], [10, 11, 12, 13])
        return
    rows = np.asarray(seen_in(maax.FlattenObservations(env), game())["obs"])
    for agent, row in enumerate(rows):
        others = {10.0, 11.0, 12.0, 13.0} - {10.0 + agent}
        assert 10.0 + agent in row
        assert not others & set(row.tolist())


def test_what_is_not_private_is_seen_of_others_in_circulant_order():
    obs = seen_in(maax.SplitObservations(Fuel(game(), Observed(("agent",), private=False))), game())
    equal(obs["fuel_self"], [10, 11, 12, 13])
    equal(obs["fuel"], [[13, 12, 11], [10, 13, 12], [11, 10, 13], [12, 11, 10]])


@pytest.mark.slow
def test_flat_observations_hide_what_is_not_seen_and_name_their_columns():
    few = {"scenario": "empty", "p_door_dropout": 0.0, "box_placement": "uniform", "impl": "c"}
    split, flat = (maax.make("hide_and_seek_quadrant", observations=name, **few) for name in ("split", "flat"))
    # The same game but for its last layer.
    assert [type(layer) for layer in flat.layers[1:]] == [type(layer) for layer in split.layers]
    state = split.reset(key(1))
    seen, vector = state.obs, np.asarray(jax.jit(observing(flat, split))(state).obs["obs"])
    names = flat.observed["obs"].names()
    assert vector.shape == (4, len(names))
    column = {name: i for i, name in enumerate(names)}
    for i in range(2):
        for axis, name in enumerate("xyz"):
            shown = np.where(seen["sees_box"][:, i], seen["box_obs"][:, i, axis], 0.0)
            equal(vector[:, column[f"box_obs[{i}] {name}"]], shown)
    equal(vector[:, column["sees_agent[2]"]], seen["sees_agent"][:, 2])


# --- the table -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("observations", ["flat", "ego"])
@pytest.mark.parametrize("name", GAMES)
def test_everything_in_every_game_is_declared_and_has_its_shape(name, observations):
    """Under the last layers of flat observations are the split ones, and under these the raw ones."""
    env = maax.make(name, impl="c", observations=observations, observe="all")
    levels = [env]
    for other, fields in {"split": {"observe": "all"}, "raw": {}}.items() if observations == "flat" else ():
        kinds = [type(layer) for layer in maax.make(name, impl="c", observations=other, **fields).layers]
        (level,) = (layer.env for layer in env.layers if [type(inner) for inner in layer.env.layers] == kinds)
        levels.append(level)
    for level in levels:
        space = level.observation_space.spaces
        assert set(level.observed) >= set(space)
        check_shapes(level.observed, {key: sub.shape for key, sub in space.items()}, "test")
        text = str(level.describe())
        assert all(name in text for name in space)
        assert "undeclared" not in text


def test_zoo_of_all_modules_is_declared():
    from helpers.zoo import zoo_env

    env = zoo_env()
    shapes = {name: sub.shape for name, sub in env.observation_space.spaces.items()}
    assert set(env.observed) == set(shapes)
    check_shapes(env.observed, shapes, "test")


def test_columns_say_what_stands_in_them():
    """Against the physics itself: of every column that has a place in qpos or qvel."""
    env = game(n_boxes=2, boxsize_obs=True)
    state = env.reset(key(2))
    speeds = rng(3).standard_normal(state.data.qvel.shape).astype(np.float32)
    data = jax.device_get(state.data.replace(qvel=speeds))
    obs = jax.jit(env.base.module_observations)(state.world, data)
    boxes = env.base.modules["box"]
    place, speed = data.qpos[boxes.qpos_ids], data.qvel[boxes.qvel_ids]
    truth = dict(zip(("x", "y", "z"), place.T[:3], strict=True)) | dict(
        zip(("vx", "vy", "vz", "spin"), speed.T, strict=True)
    )
    truth |= {"cos yaw": np.cos(place[:, 3]), "sin yaw": np.sin(place[:, 3]), "size x": np.full(2, 0.5)}
    names = env.observed["box_obs"].names()
    assert set(truth) < set(names)
    for name, values in truth.items():
        np.testing.assert_allclose(obs["box_obs"][:, names.index(name)], values, atol=1e-6)


@pytest.mark.parametrize("axis", ["agents", "boxs", "boxes"])
def test_an_axis_in_the_plural_would_be_another_one(axis):
    table = {"box_mask": Observed(("box",)), "smell": Observed((axis,)), "news": Observed(("news",))}
    with pytest.raises(ValueError, match=f"axes: got '{axis}' for 'smell'; takes '(agent|box)', in the singular"):
        resolved(table)
    assert resolved({name: one for name, one in table.items() if name != "smell"})


def test_masks_are_found_by_name():
    table = resolved({"box_obs": Observed(("box",), POSITION), "box_mask": Observed(("box",)),
                      "sees_box": Observed(("agent", "box"))})  # fmt: skip
    assert (table["box_obs"].present, table["box_obs"].seen) == ("box_mask", "sees_box")
    assert (table["sees_box"].present, table["sees_box"].seen) == (None, None)


# --- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrapper", [maax.SplitObservations, lambda env: maax.FlattenObservations(env)])
def test_an_undeclared_observation_is_refused_with_the_line_that_declares_it(wrapper):
    env = Fuel(maax.SplitObservations(game())) if wrapper is not maax.SplitObservations else Fuel(game())
    with pytest.raises(ValueError, match="'fuel' is observed and not declared") as error:
        wrapper(env)
    text = str(error.value)
    assert "in Fuel: def declared(self): return self.env.declared() | " in text
    line = text.partition("self.env.declared() | ")[2]
    declared = eval(line, {"Observed": Observed, "Column": Column})
    assert declared == {"fuel": Observed(("agent",))}


def test_a_wrapper_that_drops_declarations_is_named():
    class Forgets(maax.ObservationWrapper):
        def observation(self, state):
            return state.obs | {"luck": jnp.zeros(())}

        def declared(self):
            return {"luck": Observed()}

    with pytest.raises(ValueError, match=r"'\w+' is observed, and Forgets leaves out how it was declared; begin what"):
        maax.SplitObservations(Forgets(game()))


def test_an_undeclared_module_is_named():
    class Wind(maax.Module):
        name = "wind"

        def observation_step(self, world, data):
            return {"wind": jnp.zeros(2)}

    env = maax.make("standard", impl="c")
    env.add_module(Wind())
    with pytest.raises(ValueError, match="'wind' is observed and not declared; say whose it is, in Wind"):
        maax.SplitObservations(env)
    assert env.state_shape.obs["wind"].shape == (2,)  # raw stays free of it


@pytest.mark.parametrize(
    ("table", "value", "says"),
    [
        (Observed(("agent",), (Column("a"), Column("b"))), jnp.zeros((4, 3)), "has 3 columns; declared are 2"),
        (Observed(("agent", "box")), jnp.zeros(4), r"has shape \(4,\); declared are 2 axes"),
        (Observed(("agent",)), jnp.zeros(5), "axis 'agent' has length"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(table, value, says):
    with pytest.raises(ValueError, match=f"SplitObservations: .*{says}"):
        maax.SplitObservations(Fuel(game(), table, value))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Observed("agent"), "axes: got 'agent'; takes a tuple"),
        (lambda: Observed(("agent",), ("x",)), "columns: got .* takes a tuple of Column"),
        (lambda: Observed(("agent",), (Column("x"), Column("x"))), r"columns: got \['x'\] twice"),
        (lambda: Column(""), "name: got ''"),
        (lambda: Column("x", scale=0), "scale: got 0"),
    ],
)
def test_wrong_declarations(make, says):
    with pytest.raises(ValueError, match=says):
        make()


def test_two_modules_that_observe_one_name_are_refused():
    class Again(maax.Module):
        name = "again"

        def observation_step(self, world, data):
            return {"agent_pos": jnp.zeros(2)}

    env = maax.make("standard", impl="c")
    env.add_module(Again())
    with pytest.raises(ValueError, match="Again 'again' observes 'agent_pos', as Agents 'agent' does; takes another"):
        env.reset(key(0))
    with pytest.raises(ValueError, match="Again 'again' observes 'agent_pos', as Agents 'agent' does; takes another"):
        maax.make("standard", impl="c", modules=[Again()])

    class Declared(Again):
        def declared(self):
            return {"agent_pos": Observed((), (Column("x"), Column("y")))}

    with pytest.raises(ValueError, match="Declared 'again' observes 'agent_pos', as Agents 'agent' does"):
        maax.make("standard", impl="c").add_module(Declared())


# --- what is chosen, joined, padded ----------------------------------------------------------------------------------


def test_tables_follow_selections_and_joins_and_padding():
    split = maax.SplitObservations(game(n_boxes=2))
    chosen = maax.SelectObservations(split, ["box_obs", "ramp_obs", "agent_qpos_qvel_self", "prep_remaining"])
    assert set(chosen.observed) == {"box_obs", "ramp_obs", "agent_qpos_qvel_self", "prep_remaining"}
    joined = maax.ConcatenateObservations(chosen, {"me": ["agent_qpos_qvel_self", "prep_remaining"]})
    assert joined.observed["me"].names()[-1] == "preparation left"
    padded = maax.SpoofEntities(maax.SplitObservations(game(n_boxes=2)), 5, ["box_obs"], ["box_mask"])
    check_shapes(padded.observed, {k: s.shape for k, s in padded.observation_space.spaces.items()}, "test")
    assert padded.observed["box_obs"].present == "box_mask"
    flat = maax.FlattenObservations(padded)
    assert len(flat.observed["obs"].columns) == flat.observation_space["obs"].shape[1]


# --- masks of a user's own ------------------------------------------------------------------------------------------


class Smell(maax.ObservationWrapper):
    """What agents smell of boxes, which has nothing to do with what they see; nobody smells anything here."""

    def __init__(self, env, seen="smells_box", present=None):
        super().__init__(env)
        self.masks = {"seen": seen, "present": present}

    def observation(self, state):
        smell = jnp.full((self.n_agents, 2, 1), 7.0)
        return state.obs | {"box_smell": smell, "smells_box": jnp.zeros((self.n_agents, 2), bool)}

    def declared(self):
        smell = Observed(("agent", "box"), (Column("smell"),), **self.masks)
        return self.env.declared() | {"box_smell": smell, "smells_box": Observed(("agent", "box"))}


def test_joining_keeps_the_masks_apart():
    """All boxes are in sight and none can be smelt: what is smelt reaches nobody, whatever shares its axis."""
    env = maax.make("hide_and_seek", impl="c", observations="raw", n_boxes=2, cone=6.28, scenario="empty")
    split = maax.SplitObservations(Smell(env))
    assert {"box_obs", "box_smell"} <= set(split.observed)
    flat = maax.FlattenObservations(maax.CriticObservations(split, "team"))
    open_to_all = maax.FlattenObservations(maax.CriticObservations(split, "all"))
    state = split.reset(key(0))
    obs, shown = (jax.jit(observing(env, split))(state).obs for env in (flat, open_to_all))
    assert not (np.asarray(obs["obs"]) == 7).any()
    assert not (np.asarray(obs["critic"]) == 7).any()
    assert (np.asarray(shown["critic"]) == 7).sum() == 8


def test_what_every_agent_has_of_every_object_can_be_public():
    table = Observed(("agent", "box"), (Column("a"),), private=False)
    obs = maax.SplitObservations(Fuel(game(n_boxes=3), table, jnp.ones((4, 3, 1)))).state_shape.obs
    assert (obs["fuel_self"].shape, obs["fuel"].shape) == ((4, 3, 1), (4, 3, 3, 1))


def test_columns_of_one_name_are_not_joined():
    table = Observed(("box",), POSITION)
    obs = maax.SplitObservations(Fuel(game(n_boxes=3), table, jnp.ones((3, 3)))).observed
    assert obs["fuel"].names() == ("x", "y", "z")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Smell(game(n_boxes=2), seen="nothing"), "seen of 'box_smell' is 'nothing', which is not observed"),
        (lambda: Smell(game(n_boxes=2), present="nope"), "present of 'box_smell' is 'nope', which is not observed"),
        (lambda: Smell(game(n_boxes=2), seen="agent_mask"), "has shape .4,.; takes 2 along its last axis"),
        (lambda: Fuel(game(), 3), "declared: got 3 for 'fuel'; takes an Observed"),
        (lambda: Fuel(game(), None, jnp.zeros((4, 4))), "'agent', 'agent'"),
    ],
)
def test_masks_that_are_not_there(make, says):
    with pytest.raises(ValueError, match=says):
        maax.SplitObservations(make())


def test_a_selection_without_its_mask_is_refused():
    split = maax.make("hide_and_seek_quadrant", impl="c", observations="split")
    with pytest.raises(ValueError, match="seen of 'box_obs' is 'sees_box', which is not observed"):
        maax.FlattenObservations(maax.SelectObservations(split, ["box_obs", "box_mask"]))


def test_nothing_is_left_of_what_is_masked_in_vectors():
    """Of agents that are not in play, too."""
    few = {"scenario": "empty", "n_boxes": 1, "n_ramps": 0}
    env = maax.make("tag", impl="c", observations="flat", **few, **{"teams.players": (1, 4)})
    obs = jax.jit(jax.vmap(env.reset))(jax.random.split(key(0), 8)).obs
    mask = np.asarray(obs["obs_mask"])
    absent = ~mask.any(axis=-1)
    assert absent.any()
    assert not absent.all()
    assert not np.asarray(obs["obs"])[~mask].any()
