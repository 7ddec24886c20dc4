"""Scenarios and placements that users add, by name."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from scipy import ndimage

import maax_mjx as maax
from maax_mjx.layout import (
    HORIZONTAL,
    VERTICAL,
    Rooms,
    Walls,
    placement_by_name,
    register_placement,
    register_scenario,
    scenario_names,
)
from maax_mjx.layout import placements as placement_registry
from maax_mjx.layout import scenarios as scenario_registry

N = 200
FLOOR, CELL, PIXEL, RADIUS = 6.0, 0.2, 0.05, 0.15


def cross(key, grid_size):
    m, last = grid_size // 2, grid_size - 1
    axes = [VERTICAL, VERTICAL, HORIZONTAL, HORIZONTAL]
    walls = Walls.create(axes, line=[m] * 4, start=[0, m, 0, m], end=[m, last, m, last])
    rooms = [(0, 0, m, m), (m, 0, last, m), (0, m, m, last), (m, m, last, last)]
    return Rooms.create(walls, rooms)


def crossing(key, grid_size):
    """Two whole walls that cross."""
    m, last = grid_size // 2, grid_size - 1
    return Rooms.create(Walls.create([VERTICAL, HORIZONTAL], [m, m], [0, 0], [last, last]), [(0, 0, m, m)])


def corner(key, grid_size):
    """A quadrant at low x, low y, of a third or a half of the floor."""
    size = jnp.where(jax.random.bernoulli(key), grid_size // 2, grid_size // 3)
    walls = Walls.create([VERTICAL, HORIZONTAL], [size, size], [0, 0], [size, size])
    return Rooms.create(walls, [(0, 0, size, size)], quadrant=True)


def sometimes(key, grid_size):
    """A wall across the floor, in half of the worlds."""
    rooms = Rooms.create(Walls.create([HORIZONTAL], [grid_size // 2], [0], [grid_size - 1]), [(0, 0, 5, 5)])
    return rooms.replace(walls=rooms.walls.replace(present=jax.random.bernoulli(key)[None]))


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The registries are as they were when a test is over."""
    monkeypatch.setattr(scenario_registry, "_SCENARIOS", dict(scenario_registry._SCENARIOS))
    monkeypatch.setattr(placement_registry, "_PLACEMENTS", dict(placement_registry._PLACEMENTS))
    register_scenario("cross", cross, n_walls=4, n_rooms=4, shortest_wall=lambda grid_size: (grid_size + 1) // 2)
    register_scenario("crossing", crossing, n_walls=2, n_rooms=1, shortest_wall=lambda grid_size: grid_size // 2)
    register_scenario(
        "corner", corner, n_walls=2, n_rooms=1, quadrant_cells=lambda grid_size: (grid_size // 3 - 1) ** 2
    )
    register_scenario("sometimes", sometimes, n_walls=1, n_rooms=1, fixed_doors=False)


def base(scenario, *modules, agents=None, **options):
    env = maax.Base(2, impl="c")
    for module in (maax.WallScenarios(scenario, **options), maax.Agents(2) if agents is None else agents, *modules):
        env.add_module(module)
    return env


def drawn(env):
    return jax.device_get(jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(0), N)))


def solid(rects):
    """(n, n) bool: pixels whose middle is in one of the rectangles."""
    middle = (np.arange(round(FLOOR / PIXEL)) + 0.5) * PIXEL
    out = np.zeros((len(middle),) * 2, bool)
    for x0, y0, x1, y1 in rects:
        out |= ((middle > x0) & (middle < x1))[:, None] & ((middle > y0) & (middle < y1))
    return out


@pytest.mark.slow
def test_a_scenario_of_ones_own_is_played():
    room = maax.room_placement
    env = maax.make("hide_and_seek", impl="c", scenario="cross", hider_placement=room(3), seeker_placement=room(0))
    states = drawn(env)
    assert "cross" in scenario_names()
    assert states.world.valid.all()
    plan = states.world.plan
    assert plan.door_mask.all()
    for i in range(0, N, 10):
        walls = plan.walls[i][plan.wall_mask[i]]
        free = ndimage.distance_transform_edt(~solid(walls)) * PIXEL > RADIUS + PIXEL / 2
        assert ndimage.label(free)[1] == 1, "every room can be reached"
    agents = states.data.qpos[:, env.base.agents.qpos_ids[:, :2]]
    assert (agents[:, :2] > FLOOR / 2).all()
    assert (agents[:, 2:] < FLOOR / 2 + CELL).all()


def test_no_door_lies_where_walls_cross():
    plan = drawn(base("crossing")).world.plan
    assert plan.door_mask.all()
    middle = (15 + 0.5) * CELL
    away = np.abs(plan.doors[..., :2] - middle).max(axis=-1) - plan.doors[..., 2] / 2
    assert away.min() > 0.04, "the opening ends before the other wall, half a cell thick"
    assert (plan.doors[:, 0, 1] < middle).any()
    assert (plan.doors[:, 0, 1] > middle).any()


@pytest.mark.slow
def test_a_quadrant_of_ones_own():
    """Doors drop out of it and things go into it, also beside another scenario."""
    placement = [maax.quad_placement, maax.outside_quad_placement]
    env = base(["corner", "empty"], agents=maax.Agents(2, placement), p_door_dropout=0.5)
    world = drawn(env).world
    ours = world.plan.scenario == 0
    assert ours.any()
    assert not ours.all()
    assert set(world.plan.door_mask[ours].sum(axis=1)) == {1, 2}
    assert {tuple(q) for q in world.plan.quadrant[ours]} == {(1, 1, 10, 10), (1, 1, 15, 15)}
    position = drawn(env).obs["agent_pos"][ours, :, :2]
    inside = (position < world.plan.quadrant[ours][:, None, 2:] * CELL).all(axis=-1)
    assert inside[:, 0].all()
    assert not inside[:, 1].any()


@pytest.mark.slow
def test_doors_that_may_be_missing_have_a_mask():
    obs = drawn(base("sometimes")).obs
    assert set(obs["door_mask"].ravel()) == {False, True}
    assert (obs["door_obs"][~obs["door_mask"]] == 0).all()
    assert "door_mask" not in drawn(base("cross")).obs


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "quad"}, "name: got 'quad'; takes a name that is not taken, as are"),
        ({"name": "cross", "draw": lambda key, grid_size: cross(key, grid_size)}, "name: got 'cross'"),
        ({"name": 3}, "name: got 3"),
        ({"draw": "half"}, "draw: got 'half'; takes a function"),
        ({"draw": lambda key: None}, r"draw: got <lambda>\(key\); takes a function \(key, grid_size\) -> Rooms"),
        ({"n_walls": -1}, "n_walls: got -1; takes a whole number of at least 0"),
        ({"n_rooms": 0}, "n_rooms: got 0; takes a whole number of at least 1"),
        ({"shortest_wall": 5}, "shortest_wall: got 5; takes a function"),
        ({"narrowest_room": 5}, "narrowest_room: got 5; takes a function"),
        ({"fixed_doors": 1}, "fixed_doors: got 1; takes True or False"),
        ({"n_walls": 1, "quadrant_cells": lambda g: g}, "n_walls: got 1 beside quadrant_cells"),
    ],
)
def test_scenarios_that_are_refused(change, message):
    before = scenario_names()
    with pytest.raises(ValueError, match=message):
        register_scenario(**({"name": "new", "draw": cross, "n_walls": 4, "n_rooms": 4} | change))
    assert scenario_names() == before


def test_what_a_notebook_defines_anew_is_registered_anew():
    """A cell that runs twice makes a function of the same name; the later one counts."""

    def ran():
        names = {"__name__": "__main__"}
        exec("def mine(layout, cells): return cells", names)
        return names["mine"]

    first, second = ran(), ran()
    register_placement("mine", first)
    register_placement("mine", second)
    assert placement_by_name("mine") is second
    with pytest.raises(ValueError, match="name: got 'mine'; takes a name that is not taken"):
        register_placement("mine", maax.quad_placement)
    register_scenario("cross", cross, n_walls=4, n_rooms=4)


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda key, g: 3, "scenario 'wrong' returned 3; takes Rooms"),
        (crossing, r"scenario 'wrong' returned walls.axis of shape \(2,\) .*takes \(4,\)"),
        (lambda key, g: cross(key, g).replace(rooms=jnp.zeros((3, 4), int)), r"returned rooms of shape \(3, 4\)"),
        (lambda key, g: cross(key, g).replace(rooms=jnp.zeros((4, 4))), "returned rooms .*float32.* int32"),
        (lambda key, g: cross(key, g).replace(valid=None), "returned Rooms of something else than arrays"),
    ],
)
def test_what_a_draw_returns_is_checked(draw, message):
    register_scenario("wrong", draw, n_walls=4, n_rooms=4)
    with pytest.raises(ValueError, match=message):
        base("wrong").reset(seeds.key(0))


def test_doors_wider_than_a_registered_wall():
    with pytest.raises(ValueError, match=r"door_size: got 14 cells; takes 0 to 13, .* of 15 cells"):
        base("cross", door_size=14)
    base("cross", door_size=13)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Walls.create([0], [1, 2], [0], [3]), "1 axes, 2 lines, 1 starts and 1 ends"),
        (lambda: Rooms.create(Walls.create([], [], [], []), []), r"rooms: got \[\]"),
        (lambda: Rooms.create(Walls.create([], [], [], []), [(1, 2, 3)]), r"rooms: got \[\(1, 2, 3\)\]"),
    ],
)
def test_parts_that_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def places(fn, scenario="tri"):
    """(N, 2) where the first of the agents starts."""
    return drawn(base(scenario, agents=maax.Agents(2, [fn, maax.uniform_placement])))


class Weights(maax.Module):
    """Notes the weights that placement functions give to the places of a thing of 2 x 3 cells."""

    name = "weights"

    def __init__(self, fns):
        self._fns = fns

    def layout_step(self, key, layout, params):
        weights = jnp.stack([jnp.asarray(fn(layout, jnp.array([2, 3])), float) for fn in self._fns])
        return layout.replace(sites=layout.sites | {"weights": weights})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "named"),
    [
        (
            "tri",
            {
                "uniform": maax.uniform_placement, "centre": maax.centre_placement,
                "middle": maax.middle_placement(0.5), "room2": maax.room_placement(2),
            },
        ),
        ("var_quad", {"quad": maax.quad_placement, "outside_quad": maax.outside_quad_placement}),
        # Where there is no quadrant, anywhere.
        ("half", {"quad": maax.uniform_placement, "outside_quad": maax.uniform_placement}),
    ],
)  # fmt: skip
def test_placements_by_name(scenario, named):
    fns = [fn for name, wanted in named.items() for fn in (placement_by_name(name), wanted)]
    weights = np.asarray(drawn(base(scenario, Weights(fns))).world.sites["weights"])
    np.testing.assert_array_equal(weights[:, ::2], weights[:, 1::2])
    assert weights.any(axis=(-2, -1)).all()
    different = {x.tobytes() for x in weights[0, ::2]}
    assert len(different) == (1 if scenario == "half" else len(named)), "each name is a place of its own"


def test_what_goes_into_the_quadrant_by_name_must_fit():
    with pytest.raises(ValueError, match=r"placement_fn: got 30 objects \(30 boxes\) of .* cells in the quadrant"):
        base("quad", maax.Boxes(30, placement_by_name("quad")))
    base("empty", maax.Boxes(30, placement_by_name("quad")))


def test_a_placement_of_ones_own():
    def left_half(layout, cells):
        g = layout.grid.size
        return jnp.broadcast_to((jnp.arange(g) + cells[0] <= g // 2)[:, None], (g, g))

    register_placement("left_half", left_half)
    assert placement_by_name("left_half") is left_half
    x = places(placement_by_name("left_half")).obs["agent_pos"][:, 0, 0]
    assert x.max() < FLOOR / 2
    assert x.max() - x.min() > FLOOR / 4


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: register_placement("quad", maax.quad_placement), "name: got 'quad'; takes a name that is not taken"),
        (lambda: register_placement("room7", maax.quad_placement), "name: got 'room7'; takes"),
        (lambda: register_placement("", maax.quad_placement), "name: got ''"),
        (lambda: register_placement("new", "quad"), "placement_fn: got 'quad'; takes a function"),
        (lambda: placement_by_name("quda"), "placement: got 'quda'; did you mean 'quad'.*takes one of"),
        (lambda: placement_by_name("roomy", "box_placement"), "box_placement: got 'roomy'"),
        (lambda: placement_by_name(3), "placement: got 3"),
    ],
)
def test_placements_that_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
