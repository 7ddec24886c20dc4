"""Placement functions against the distances and rectangles that they promise."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from scipy import stats

import maax_mjx as maax
from maax_mjx.layout import Layout

N, FLOOR, CELL, G = 4_000, 6.0, 0.2, 30
AGENT, HALF = 0.15, 0.25


def make(*modules, scenario="empty"):
    n_agents = next(m.n_max for m in modules if isinstance(m, maax.Agents))
    env = maax.Base(n_agents, impl="c")
    for module in (maax.WallScenarios(scenario), *modules):
        env.add_module(module)
    return env


def draw(env, batch_reset):
    """Centres (N, n, 2) by module name, the plan, and whether layouts are valid; absent things are NaN."""
    state = jax.device_get(batch_reset(env, jax.random.split(seeds.key(2), N)).replace(key=()))
    xy = {}
    for name, module in env.modules.items():
        if name != "walls":
            place = state.data.qpos[:, module.qpos_ids[:, :2]]
            xy[name] = np.where(state.world.active[module.kind][..., None], place, np.nan)
    return xy, state.world


def inside(xy, rect, half):
    return ((xy - half >= np.array(rect)[..., :2] - 1e-4) & (xy + half <= np.array(rect)[..., 2:] + 1e-4)).all(axis=-1)


@pytest.mark.slow
def test_separation_and_proximity(batch_reset):
    """Two boxes, two agents near the first, a ramp and more away from everything before it."""
    env = make(
        maax.Boxes((0, 2)),
        maax.Agents(2, maax.proximity_placement(1.2, to="box0")),
        maax.Ramps(2, maax.separation_placement(1.5)),
    )
    xy, world = draw(env, batch_reset)
    assert world.valid.all()
    boxes, agents, ramps = xy["box"], xy["agent"], xy["ramp"]
    anchored = world.active["box"][:, 0]
    assert 0.5 < anchored.mean() < 0.8
    near = np.linalg.norm(agents - boxes[:, :1], axis=-1)
    assert near[anchored].max() <= 1.2
    assert near[anchored].max() > 0.9
    others = np.concatenate([boxes, agents, ramps], axis=1)
    for i in range(2):
        before = np.delete(others, [*range(4 + i, 6)], axis=1)
        apart = np.linalg.norm(ramps[:, i, None] - before, axis=-1)
        assert np.nanmin(apart) >= 1.5
        assert np.nanmin(apart) < 1.8
    free = agents[~anchored]
    assert (free.max(axis=(0, 1)) > 5).all(), "without its anchor, proximity is uniform"
    assert (free.min(axis=(0, 1)) < 1).all()


def published_near(first, radius):
    """(..., G, G) bool, of cells (..., 2): where OpenAI's code draws the lowest cell of what is close to another."""
    r = int(np.ceil(radius / CELL))
    low, high = np.maximum(1, first - r), np.minimum(G - 1, first + r)
    x, y = ((np.arange(G) >= low[..., i, None]) & (np.arange(G) < high[..., i, None]) for i in range(2))
    return x[..., :, None] & y[..., None, :]


@pytest.mark.parametrize("cells", [1, 3])
@pytest.mark.parametrize("radius", [0.2, 0.25, 0.4, 0.9])
def test_published_proximity_is_the_published_range_of_cells(radius, cells):
    """Wherever in its cells the other object lies; all of the floor where it is not in play."""
    rng, placement = seeds.rng(0), maax.published_proximity_placement(radius, to="food0")
    first = np.concatenate([rng.integers(0, G - cells + 1, (400, 2)), [[0, 0], [0, G - cells], [G - cells] * 2]])
    extent = (cells - rng.uniform(0.01, 0.99, first.shape)) * CELL
    centre = first * CELL + extent / 2 + rng.uniform(0, 1, first.shape) * (cells * CELL - extent)
    layout = Layout.empty(G, FLOOR)

    def weights(centre, there):
        return placement(layout.replace(objects={"food0": jnp.append(centre, there)}), jnp.full(2, cells))

    got = jax.jit(jax.vmap(weights, in_axes=(0, None)))
    np.testing.assert_array_equal(got(jnp.asarray(centre), 1.0) > 0, published_near(first, radius))
    assert np.asarray(got(jnp.asarray(centre[:1]), 0.0)).all()


def test_published_proximity_in_worlds(batch_reset):
    """In every world there, and in every cell there in some; of what is wanted, all has a place."""
    near = maax.published_proximity_placement(0.5, to="food0")
    env = make(maax.Agents(1), maax.Food((1, 3), placement_fn=[maax.uniform_placement, near, near]))
    state = jax.device_get(batch_reset(env, jax.random.split(seeds.key(2), N)).replace(key=()))
    assert state.world.valid.all()
    cells, there = np.floor(state.world.sites["food"][..., :2] / CELL).astype(int), state.world.active["food"]
    allowed, offsets = published_near(cells[:, 0], 0.5), []
    for i in (1, 2):
        own = cells[there[:, i], i]
        assert allowed[there[:, i]][np.arange(len(own)), own[:, 0], own[:, 1]].all()
        offsets.append(own - cells[there[:, i], 0])
    assert len(np.unique(np.concatenate(offsets), axis=0)) == 6 * 6 - 1, "the first one's own cell is taken"


def test_centre_and_middle(batch_reset):
    env = make(maax.Boxes(1, maax.centre_placement), maax.Agents(1, maax.middle_placement(0.4)))
    xy, world = draw(env, batch_reset)
    assert world.valid.all()
    assert np.abs(xy["box"] - FLOOR / 2).max() <= CELL
    square = [FLOOR * 0.3, FLOOR * 0.3, FLOOR * 0.7, FLOOR * 0.7]
    assert inside(xy["agent"], square, AGENT).all()
    assert np.ptp(xy["agent"], axis=0).min() > 1.8


@pytest.mark.slow
def test_at_a_point(batch_reset):
    """The middle of each is within a cell of its point; one that would leave the floor is refused."""
    points = [(1.31, 2.05), (4.9, 0.7), (3.0, 5.2)]
    with pytest.raises(ValueError, match=r"at_placement\(5.95, 3\) for box0, which has no place in any world"):
        make(maax.Boxes(1, maax.at_placement(FLOOR - 0.05, 3.0)), maax.Agents(3))
    env = make(maax.Boxes(1), maax.Agents(3, [maax.at_placement(*point) for point in points]))
    xy, world = draw(env, batch_reset)
    assert world.valid.all()
    assert np.abs(xy["agent"] - np.array(points)).max() <= CELL


@pytest.mark.slow
def test_rooms_and_combinations(batch_reset):
    env = make(
        maax.Boxes(1, maax.any_of(maax.middle_placement(0.1), maax.room_placement(0))),
        maax.Agents(3, [*[maax.room_placement(i) for i in range(2)], maax.uniform_placement]),
        maax.Ramps(1, maax.all_of(maax.room_placement(2), maax.separation_placement(0.8))),
        scenario="tri",
    )
    xy, world = draw(env, batch_reset)
    assert world.valid.all()
    rooms = world.plan.rooms * CELL
    for i in range(2):
        assert inside(xy["agent"][:, i], rooms[:, i], AGENT).all()
    assert inside(xy["ramp"][:, 0], rooms[:, 2], HALF).all()
    others = np.concatenate([xy["box"], xy["agent"]], axis=1)
    assert np.linalg.norm(xy["ramp"] - others, axis=-1).min() >= 0.8
    assert inside(xy["box"][:, 0], rooms[:, 0], HALF).mean() > 0.9


@pytest.mark.slow
def test_quadrant_placement_in_a_mix(batch_reset):
    """Where a world of the mix has no quadrant, its placement is uniform."""
    env = make(maax.Agents(2, [maax.quad_placement, maax.outside_quad_placement]), scenario=("quad", "half"))
    xy, world = draw(env, batch_reset)
    assert world.valid.all()
    quad = world.plan.scenario == 0
    rect = world.plan.quadrant * CELL
    assert inside(xy["agent"][:, 0], rect, AGENT)[quad].all()
    assert not inside(xy["agent"][:, 1], rect, AGENT)[quad].any()
    assert (xy["agent"][~quad].min(axis=0) < 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("free", [False, True])
def test_random_yaw(free, batch_reset):
    """Turned squares touch nothing: compared as polygons, by separating axes; angles are uniform."""
    env = make(maax.Boxes(3, free=free, random_yaw=True), maax.Agents(1, random_yaw=True))
    state = jax.device_get(batch_reset(env, jax.random.split(seeds.key(3), N // 5)).replace(key=()))
    assert state.world.valid.all()
    boxes = env.modules["box"]
    mats = state.data.geom_xmat[:, boxes.geom_ids][..., :2, :2]
    yaw = np.arctan2(mats[..., 1, 0], mats[..., 0, 0]).ravel()
    assert stats.kstest((yaw + np.pi) / (2 * np.pi), "uniform").pvalue > 1e-3
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * HALF
    polygons = np.einsum("nbij,cj->nbci", mats, corners) + state.data.geom_xpos[:, boxes.geom_ids][..., None, :2]
    wall = 0.15
    assert polygons.min() > wall - 1e-4
    assert polygons.max() < FLOOR - wall + 1e-4
    for i, j in ((0, 1), (0, 2), (1, 2)):
        gaps = []
        for axes in (mats[:, i], mats[:, j]):
            a, b = (np.einsum("nck,nkd->ncd", polygons[:, k], axes) for k in (i, j))
            gaps += [b.min(1) - a.max(1), a.min(1) - b.max(1)]
        assert (np.concatenate(gaps, axis=1).max(axis=1) > -1e-4).all()
    agents = state.data.qpos[:, env.agents.qpos_ids[0][3]]
    assert stats.kstest(agents / (2 * np.pi), "uniform").pvalue > 1e-3


def test_a_function_of_ones_own(batch_reset):
    def left(layout, cells):
        return (jax.numpy.arange(layout.grid.size)[:, None] < 5) * jax.numpy.ones((1, layout.grid.size))

    xy, _ = draw(make(maax.Agents(1, left)), batch_reset)
    assert xy["agent"][..., 0].max() < 5 * CELL + 2 * AGENT


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: maax.at_placement(0, 1), "x: got 0; takes a positive number"),
        (lambda: maax.middle_placement(0), "fraction: got 0; takes a number above 0, up to 1"),
        (lambda: maax.middle_placement(1.5), "fraction: got 1.5"),
        (lambda: maax.separation_placement(-1), "radius: got -1; takes a positive number"),
        (lambda: maax.proximity_placement(1.0, 3), "to: got 3; takes an object's name"),
        (lambda: maax.published_proximity_placement(1.0, 3), "to: got 3; takes an object's name"),
        (lambda: maax.published_proximity_placement(0, "box0"), "radius: got 0; takes a positive number"),
        (
            lambda: make(maax.Agents(1), maax.Food(1, placement_fn=maax.published_proximity_placement(1.0, "box0"))),
            "for food0, and no 'box0' is placed before it",
        ),
        (lambda: maax.room_placement(-1), "index: got -1"),
        (lambda: maax.all_of(), "all_of: got ()"),
        (lambda: maax.any_of(maax.quad_placement, 3), "any_of: got"),
        (lambda: make(maax.Agents(1, maax.all_of(maax.quad_placement))), "there is none"),
        (
            lambda: make(maax.Agents(1, maax.room_placement(3)), scenario="tri"),
            "got room_placement(3) for agent0; worlds of this environment have 3 rooms at most",
        ),
        (lambda: maax.WallScenarios([]), "scenario: got none"),
        (lambda: maax.WallScenarios(["quad", "cube"]), "scenario: got 'cube'"),
        (lambda: maax.WallScenarios(["quad", "tri"], probabilities=[0.5]), "probabilities: got [0.5]; takes 2"),
        (lambda: maax.WallScenarios(p_door_dropout=1.5), "p_door_dropout: got 1.5; takes a number in [0, 1]"),
        (lambda: maax.RandomWalls((3, 2)), "n_rooms: got (3, 2)"),
        (lambda: maax.Base(1).add_module(maax.RandomWalls(2, 20)), "min_room_size: got 20"),
    ],
)
def test_mistakes(call, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call()
    assert message in str(error.value)
