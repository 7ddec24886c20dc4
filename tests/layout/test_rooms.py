"""Rooms of every scenario, mixed in one batch, against flood fills of the drawn geometry and a NumPy oracle."""

from __future__ import annotations

import inspect
from collections import Counter

import jax
import numpy as np
import pytest
from helpers import seeds
from helpers.chance import P_MIN
from scipy import ndimage, stats

import maax_mjx as maax
from maax_mjx.benchmarks.rooms_oracle import generate, layout_shares, room_areas
from maax_mjx.layout.random_rooms import random_rooms

pytestmark = pytest.mark.slow

SCENARIOS = ("empty", "half", "quad", "var_quad", "tri", "random")
N, BATCH = 10_000, 1_000
FLOOR, CELL, G, RADIUS = 6.0, 0.2, 30, 0.15
PIXEL = 0.05
SIDE = round(FLOOR / PIXEL)
INNER = 4


@pytest.fixture(scope="module")
def env():
    env = maax.Base(1, impl="c")
    env.add_module(maax.WallScenarios(SCENARIOS, p_door_dropout=0.5, n_rooms=(2, 5), prob_outside_walls=0.75))
    env.add_module(maax.Agents(1))
    return env


@pytest.fixture(scope="module")
def worlds(env, batch_reset):
    keys = jax.random.split(seeds.key(0), N).reshape(-1, BATCH)
    parts = [jax.device_get(batch_reset(env, k).world) for k in keys]
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def drawn(world_batch):
    """(N, n, 4) x0, y0, x1, y1 of the wall geoms that stand on the floor; NaN of others."""
    pos, half = world_batch.fields["geom_pos"], world_batch.fields["geom_size"]
    rects = np.concatenate([(pos - half)[..., :2], (pos + half)[..., :2]], axis=-1)
    return np.where((pos + half)[..., 2:] > 0, rects, np.nan)


def solid(rects):
    """(SIDE, SIDE) bool: pixels whose middle is in one of the rectangles (n, 4), NaN ones apart."""
    middle = (np.arange(SIDE) + 0.5) * PIXEL
    out = np.zeros((SIDE, SIDE), bool)
    for x0, y0, x1, y1 in rects[~np.isnan(rects[:, 0])]:
        out |= ((middle > x0) & (middle < x1))[:, None] & ((middle > y0) & (middle < y1))
    return out


def closed(door, wall_rects):
    """The rectangle that fills a door (x, y, width): as thick as walls are, along the wall that it is in."""
    x, y, width = door
    beside = wall_rects[~np.isnan(wall_rects[:, 0])]
    in_line = np.abs((beside[:, 0] + beside[:, 2]) / 2 - x) < 1e-3
    touches = np.minimum(np.abs(beside[:, 1] - y), np.abs(beside[:, 3] - y)) < width / 2 + 1e-3
    vertical = (in_line & touches & (beside[:, 2] - beside[:, 0] < 0.11)).any()
    across, along = 0.05, width / 2
    return (
        [x - across, y - along, x + across, y + along] if vertical else [x - along, y - across, x + along, y + across]
    )


def test_all_scenarios_are_drawn_alike(worlds):
    counts = np.bincount(worlds.plan.scenario, minlength=len(SCENARIOS))
    assert stats.chisquare(counts).pvalue > P_MIN
    assert worlds.valid.mean() > 0.9999


def test_rooms_are_separate_and_doors_connect_them(worlds):
    """With its doors closed a world has the rooms that it says; with them open an agent's disc reaches all of it."""
    rects = drawn(worlds)
    outside = np.array(
        [[0, 0, FLOOR, 0.1], [0, 0, 0.1, FLOOR], [FLOOR - 0.1, 0, FLOOR, FLOOR], [0, FLOOR - 0.1, FLOOR, FLOOR]]
    )
    for i in range(0, N, 10):
        inner = rects[i, INNER:]
        doors = worlds.plan.doors[i][worlds.plan.door_mask[i]]
        shut = np.array([closed(door, inner) for door in doors]).reshape(-1, 4)
        n_rooms = ndimage.label(~solid(np.concatenate([inner, outside, shut])))[1]
        scenario = SCENARIOS[worlds.plan.scenario[i]]
        expected = {"empty": 1, "half": 2, "quad": 2, "var_quad": 2, "tri": 3}.get(scenario)
        expected = worlds.plan.room_mask[i].sum() if expected is None else expected
        assert n_rooms == expected, (i, scenario)
        blocked = solid(np.concatenate([inner, outside]))
        room_for_agent = ndimage.distance_transform_edt(~blocked) * PIXEL > RADIUS + PIXEL / 2
        assert ndimage.label(room_for_agent)[1] == 1, (i, scenario)


def test_observed_doors_are_the_true_openings(worlds):
    """No wall is in an opening, and a wall begins right beside it at both ends."""
    rects, plan = drawn(worlds), worlds.plan
    checked = 0
    for i in range(0, N, 5):
        walls = rects[i][~np.isnan(rects[i][:, 0])]

        def hits(rect, walls=walls):
            overlap = np.minimum(rect[2:], walls[:, 2:]) - np.maximum(rect[:2], walls[:, :2])
            return (overlap > 1e-4).all(axis=1).any()

        for door in plan.doors[i][plan.door_mask[i]]:
            hole = np.array(closed(door, rects[i, INNER:]))
            assert not hits(hole), (i, door)
            axis = int(hole[3] - hole[1] > hole[2] - hole[0])
            low, high = hole.copy(), hole.copy()
            low[axis] -= 0.01
            high[2 + axis] += 0.01
            assert hits(low), (i, door)
            assert hits(high), (i, door)
            checked += 1
        assert (plan.doors[i][~plan.door_mask[i]] == 0).all()
    assert checked > 1000


def test_every_inner_wall_has_a_door(worlds):
    of = {name: worlds.plan.scenario == i for i, name in enumerate(SCENARIOS)}
    doors = worlds.plan.door_mask.sum(axis=1)
    for name, n in (("empty", 0), ("half", 1), ("tri", 2)):
        assert (doors[of[name]] == n).all()
    n_rooms = worlds.plan.room_mask.sum(axis=1)[of["random"]]
    assert (doors[of["random"]] == n_rooms - 1).all()
    assert stats.chisquare(np.bincount(n_rooms)[2:]).pvalue > P_MIN
    for name in ("quad", "var_quad"):
        one = doors[of[name]] == 1
        assert stats.binomtest(int(one.sum()), int(of[name].sum()), 0.5).pvalue > P_MIN
        assert (doors[of[name]][~one] == 2).all()


def test_outer_walls_come_as_likely_as_asked(worlds):
    there = ~np.isnan(drawn(worlds)[:, :INNER, 0])
    assert (there.all(axis=1) | ~there.any(axis=1)).all()
    assert stats.binomtest(int(there[:, 0].sum()), N, 0.75).pvalue > P_MIN


def test_quadrants_have_the_sizes_of_the_rules(worlds):
    x0, _, x1, y1 = worlds.plan.quadrant[worlds.plan.scenario == SCENARIOS.index("quad")].T
    assert (x0 == 16).all()
    assert (y1 == 15).all()
    assert (x1 == 29).all()
    size = worlds.plan.quadrant[worlds.plan.scenario == SCENARIOS.index("var_quad")][:, 3]
    assert stats.chisquare(np.bincount(size)[9:18]).pvalue > P_MIN
    assert size.min() == 9
    assert size.max() == 17
    assert (worlds.plan.quadrant[worlds.plan.scenario == SCENARIOS.index("tri")] == 0).all()


def test_tri_turns_all_ways(worlds):
    walls = drawn(worlds)[worlds.plan.scenario == SCENARIOS.index("tri")][:, INNER : INNER + 4]
    size = np.nan_to_num(walls[..., 2:] - walls[..., :2])
    horizontal = size[:, :2, 0].max(axis=1) > size[:, :2, 1].max(axis=1)
    assert stats.binomtest(int(horizontal.sum()), len(walls), 0.5).pvalue > P_MIN


def test_params_move_without_a_retrace(env, batch_reset):
    keys = jax.random.split(seeds.key(1), BATCH)
    always = env.default_params.replace(prob_outside_walls=1.0, p_door_dropout=0.0, n_rooms=5)
    plan = batch_reset(env, keys, always).world.plan
    assert plan.wall_mask[:, :INNER].all()
    is_random = plan.scenario == SCENARIOS.index("random")
    assert (plan.room_mask.sum(axis=1)[is_random] == 5).all()
    assert (plan.door_mask.sum(axis=1)[plan.scenario == SCENARIOS.index("quad")] == 2).all()


def test_names_of_the_predecessors():
    assert maax.RandomWalls(5, random_room_count=True).n_rooms == (1, 5)
    assert maax.RandomWalls(outside_walls=False).outer == "none"
    with pytest.raises(ValueError, match="n_rooms: got"):
        maax.RandomWalls((1, 2), random_room_count=True)
    with pytest.raises(ValueError, match="outside_walls: got False"):
        maax.RandomWalls(outer="limits", outside_walls=False)


def test_random_walls_take_all_that_fits_them():
    general, random = (inspect.signature(walls).parameters for walls in (maax.WallScenarios, maax.RandomWalls))
    assert set(general) - set(random) == {"scenario", "probabilities", "p_door_dropout"}
    walls = maax.RandomWalls(in_doorways=True, outer_height=3.0)
    assert walls.in_doorways
    assert 3.0 in walls._heights
    assert not maax.RandomWalls().in_doorways


@pytest.mark.parametrize(("n_rooms", "grid_size", "min_room_size"), [(3, 30, 6), (4, 14, 2)])
def test_rooms_are_split_by_the_published_rule(n_rooms, grid_size, min_room_size):
    """The areas of rooms against their exact distribution, in 50 classes of about the same probability.

    One place for all walls that a new one may reach, instead of one for each, makes p < 1e-20.
    """
    shares = Counter()
    for inner, share in layout_shares(n_rooms, grid_size, min_room_size).items():
        shares[tuple(sorted(room_areas(list(inner), grid_size)))] += share

    @jax.jit
    @jax.vmap
    def draw(key):
        drawn = random_rooms(key, grid_size, n_rooms, n_rooms, min_room_size)
        return drawn.rooms, drawn.valid

    keys = jax.random.split(seeds.key(7), (5, 20 * BATCH))
    rooms, valid = (np.concatenate(parts) for parts in zip(*map(draw, keys), strict=True))
    assert valid.mean() > 0.99
    drawn = Counter(map(tuple, np.sort((rooms[..., 2:] - rooms[..., :2] - 1).prod(axis=-1))[valid].tolist()))
    assert set(drawn) <= set(shares)
    areas = sorted(shares, key=lambda area: (area[-1], area))
    expected, counts = np.array([(shares[area], drawn[area]) for area in areas]).T
    of_class = np.minimum(50 * np.cumsum(expected), 49).astype(int)
    expected, counts = (np.bincount(of_class, values) for values in (expected, counts))
    assert stats.chisquare(counts, expected * counts.sum()).pvalue > P_MIN


@pytest.mark.parametrize("n_rooms", [4])
def test_random_rooms_are_distributed_as_published(n_rooms, batch_reset):
    """Kolmogorov-Smirnov over 5,000 worlds against the NumPy oracle: wall lengths, room areas."""
    env = maax.Base(1, impl="c")
    env.add_module(maax.RandomWalls(n_rooms))
    env.add_module(maax.Agents(1))
    keys = jax.random.split(seeds.key(5), 5 * BATCH).reshape(-1, BATCH)
    plans = [jax.device_get(batch_reset(env, k).world.plan) for k in keys]
    rooms = np.concatenate([p.rooms for p in plans])
    areas = (rooms[..., 2] - rooms[..., 0]) * (rooms[..., 3] - rooms[..., 1])
    doors = np.concatenate([p.doors for p in plans])
    walls = np.concatenate([p.walls for p in plans])[:, INNER:].reshape(len(rooms), -1, 2, 4)
    # The two pieces of a wall and the door between them, from centre to centre of its first and last cell.
    pieces = (walls[..., 2:] - walls[..., :2]).max(axis=-1).sum(axis=-1)
    lengths = np.round((pieces + doors[..., 2] - 0.1) / CELL)
    rng = seeds.rng(0)
    oracle = [w[0] for w in (generate(rng, n_rooms) for _ in range(5 * BATCH)) if w is not None]
    assert stats.ks_2samp(lengths.ravel(), [w.end - w.start for walls in oracle for w in walls]).pvalue > P_MIN
    true_areas = [a for walls in oracle for a in room_areas(walls, G)]
    assert stats.ks_2samp(areas.ravel(), true_areas).pvalue > P_MIN
    assert areas.mean() == pytest.approx(np.mean(true_areas), rel=0.02)
