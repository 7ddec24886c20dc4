"""Placements that cannot succeed: refused when an environment is composed, or named when a batch is drawn."""

from __future__ import annotations

import contextlib
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.core.places import check_places
from maax_mjx.layout import Layout
from maax_mjx.layout import walls as wall_layout
from maax_mjx.layout.scenarios import scenario_by_name
from maax_mjx.parallel.shards import METHODS, Shards

N = 45
CENTRE, UNIFORM = maax.centre_placement, maax.uniform_placement


def compose(*modules, scenario="empty", **options):
    n_agents = next((m.n_max for m in modules if isinstance(m, maax.Agents)), 1)
    env = maax.Base(n_agents, impl="c", **options)
    for module in (maax.WallScenarios(scenario), *modules):
        env.add_module(module)
    return env


def drawn(walls, grid_size, extent, fn):
    """Whether a world's own draw finds a place beside walls."""
    layout = Layout.empty(grid_size, 6.0)
    layout = layout.replace(
        grid=wall_layout.mark(wall_layout.mark(layout.grid, walls), wall_layout.outer_walls(grid_size))
    )
    return bool(layout.place("it", jnp.zeros(3, jnp.uint32), jnp.full(2, extent), fn)[2])


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["empty", "half", "quad"])
def test_a_place_is_refused_where_no_world_has_it(scenario):
    """Boxes of any size at any point or in any central square, against the draw of a world on the device."""
    rng, grid_size, accepted = seeds.rng(21), 25, []
    key = jax.random.key(0)
    walls = scenario_by_name(scenario).draw(key, key, grid_size, None).walls
    for i in range(N):
        fn = (
            CENTRE,
            maax.at_placement(*rng.uniform(0.05, 6.5, 2).tolist()),
            maax.middle_placement(float(rng.uniform(0.05, 0.6))),
        )[i % 3]
        extent = float(np.float32(rng.uniform(0.1, 2.5)))
        with contextlib.suppress(ValueError):
            boxes = maax.Boxes(1, fn, box_size=extent)
            check_places(boxes, [maax.WallScenarios(scenario)], grid_size, (6.0, 6.0))
            accepted.append(i)
        assert (i in accepted) == drawn(walls, grid_size, extent, fn), (extent, fn.__name__)
    assert 2 < len(accepted) < N - 2


NO_PLACE = "for {}, which has no place in any world"


@pytest.mark.parametrize(
    ("modules", "options", "message"),
    [
        ([maax.Agents(2, CENTRE)], {}, NO_PLACE.format("agent1")),
        ([maax.Boxes(1, CENTRE), maax.Agents(1, CENTRE)], {}, NO_PLACE.format("agent0")),
        ([maax.Boxes((1, 2), CENTRE), maax.Agents(1)], {}, NO_PLACE.format("box1")),
        ([maax.Agents(1, CENTRE)], {"scenario": "quad"}, "got centre_placement " + NO_PLACE.format("agent0")),
        (
            [maax.Agents(1), maax.Boxes(1, CENTRE, random_yaw=True)],
            {"scenario": "quad"},
            "got centre_placement " + NO_PLACE.format("box0"),
        ),
        ([maax.Agents(1, maax.at_placement(7, 3))], {}, "got at_placement(7, 3) " + NO_PLACE.format("agent0")),
        ([maax.Agents(1, maax.at_placement(1e30, 3))], {}, "got at_placement(1e+30, 3) " + NO_PLACE.format("agent0")),
        ([maax.Agents(1, maax.at_placement(9, 3))], {"floor_size": (6.0, 8.0)}, NO_PLACE.format("agent0")),
        ([maax.Boxes(1, maax.middle_placement(0.05))], {}, NO_PLACE.format("box0")),
        ([maax.Agents(1, maax.all_of(CENTRE, UNIFORM))], {"scenario": "quad"}, NO_PLACE.format("agent0")),
        ([maax.Agents(1, maax.all_of(CENTRE, maax.at_placement(1, 1)))], {}, NO_PLACE.format("agent0")),
        (
            [maax.Boxes(1), maax.Agents(1, maax.proximity_placement(1.0, "box1"))],
            {},
            "got proximity_placement(1, 'box1') for agent0, and no 'box1' is placed before it; takes one of ['box0']",
        ),
        ([maax.Agents(1, maax.proximity_placement(1.0, "box0")), maax.Boxes(1)], {}, "no 'box0' is placed before it"),
        ([maax.Agents(2, maax.proximity_placement(1.0, "agent1"))], {}, "for agent0, and no 'agent1' is placed"),
        ([maax.Boxes(2, maax.separation_placement(9.0)), maax.Agents(1)], {}, "for box1, and the floor"),
        ([maax.Boxes(1), maax.Agents(1, maax.all_of(UNIFORM, maax.separation_placement(9.0)))], {}, "are 8.49 m"),
        (
            [maax.Agents(1, maax.any_of(UNIFORM, maax.room_placement(2)))],
            {"scenario": ("half", "empty")},
            "room_placement(2)) for agent0; worlds of this environment have 2 rooms at most",
        ),
        (
            [maax.Agents(1, maax.all_of(UNIFORM, maax.any_of(maax.proximity_placement(1.0, "x"), UNIFORM)))],
            {},
            "no 'x' is placed before it",
        ),
    ],
)
def test_what_can_never_be_placed_is_refused(modules, options, message):
    with warnings.catch_warnings(action="error"), pytest.raises(ValueError) as error:  # noqa: PT011
        compose(*modules, **options)
    assert message in str(error.value)


def test_a_placement_of_other_arguments_is_refused():
    def lately(layout):
        return layout

    with pytest.raises(ValueError, match=r"placement_fn: got lately\(layout\); takes a function \(layout, cells\)"):
        maax.Boxes(1, lately)


@pytest.mark.parametrize(
    ("modules", "options"),
    [
        ([maax.Boxes((0, 1), CENTRE), maax.Agents(1, CENTRE)], {}),
        ([maax.Agents(1, CENTRE)], {"scenario": ("quad", "empty")}),
        ([maax.Agents(1, CENTRE)], {"scenario": "var_quad"}),
        ([maax.Agents(1, maax.at_placement(7, 3))], {"floor_size": (6.0, 8.0)}),
        ([maax.Boxes(1, CENTRE, box_size=(0.1, 7.0)), maax.Agents(1, CENTRE)], {"floor_size": 16.0}),
        ([maax.Agents(2, maax.proximity_placement(1.0, "agent0"))], {}),
        ([maax.Agents(1, maax.all_of(CENTRE, maax.middle_placement(0.5)))], {}),
        ([maax.Boxes((0, 1)), maax.Agents(1, maax.separation_placement(9.0))], {}),
        ([maax.Boxes(2, maax.separation_placement(9.0)), maax.Agents(1)], {"floor_size": (6.0, 8.0)}),
        ([maax.Agents(1, maax.any_of(UNIFORM, maax.separation_placement(9.0)))], {}),
        ([maax.Agents(1, maax.room_placement(1))], {"scenario": ("half", "empty")}),
    ],
)
def test_what_some_worlds_have_a_place_for_is_accepted(modules, options):
    compose(*modules, **options)


def test_the_share_of_invalid_layouts_and_the_placement_to_blame_are_said_once():
    """The centre is free in one of two scenarios, and every world draws one of them."""
    env = compose(maax.Boxes(1), maax.Agents(1, CENTRE), scenario=("empty", "half"))
    worlds = maax.Worlds(env, 200)
    with pytest.warns(UserWarning, match="Worlds: ") as caught:
        states = worlds.reset(seeds.key(22))
    share = float((~np.asarray(states.world.valid)).mean())
    assert 0.2 < share < 0.8
    message = str(caught[0].message)
    assert len(caught) == 1
    assert f"{share:.0%} of 200 layouts are invalid" in message
    assert "agent0 (centre_placement) in 100% of them" in message
    assert "box0" not in message
    with warnings.catch_warnings(action="error"):
        worlds.reset(seeds.key(23))


def test_layouts_that_are_all_invalid_are_refused():
    worlds = maax.Worlds(compose(maax.Agents(2, maax.separation_placement(8.4))), 4)
    with pytest.raises(ValueError, match=r"none of 204 layouts is valid; no place was found for agent1 \(separa"):
        worlds.reset(seeds.key(24))


def test_nothing_is_said_of_valid_layouts(env_c):
    with warnings.catch_warnings(action="error"):
        states = maax.Worlds(env_c, 4).reset(seeds.key(25))
    assert np.asarray(states.world.valid).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_batch_is_read_on_the_host(method):
    shards = Shards(6, method=method)
    index, double = shards.on_host(shards.compile(lambda i: (i, jnp.stack([i, 2 * i], axis=1)), ())())
    np.testing.assert_array_equal(index, np.arange(6))
    np.testing.assert_array_equal(double, np.stack([np.arange(6), 2 * np.arange(6)], axis=1))
