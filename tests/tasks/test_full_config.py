"""OpenAI's full world, M, and all scenarios mixed: layouts by the ten thousand against brute-force geometry."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from helpers import seeds
from helpers.chance import P_MIN
from scipy import stats

import maax_mjx as maax

pytestmark = pytest.mark.slow

N, BATCH = 10_000, 500
FLOOR, CELL, G, RADIUS = 6.0, 0.2, 30, 0.15
TOL = 1e-4
RAMP = 0.5


def make_full():
    """OpenAI's full.jsonnet on a 6 m floor: up to 4 rooms, 3 to 9 boxes, of which 3 to 9 elongated, 2 ramps, 2 + 2."""
    env = maax.Base(4, impl="c", grid_size=G, floor_size=FLOOR)
    env.add_module(maax.RandomWalls((1, 4), min_room_size=6, prob_outside_walls=0.5))
    env.add_module(maax.Agents(4))
    env.add_module(maax.Boxes((3, 9), n_elongated_boxes=(3, 9)))
    env.add_module(maax.Ramps(2))
    return env


@pytest.fixture(scope="module")
def full():
    return make_full()


def draw(env, batch_reset, seed):
    keys = jax.random.split(seeds.key(seed), N).reshape(-1, BATCH)
    parts = [jax.device_get(batch_reset(env, k).replace(key=())) for k in keys]
    parts = [(s.world, s.data.qpos, s.metrics["layout_invalid"]) for s in parts]
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def field(env, world, name, ids):
    """(N, n, ...) a model field of the geoms or bodies `ids`: overlaid where worlds differ in it, else the model's."""
    rows = list(env.overlay.get(name, ()))
    own = getattr(env.model, name)
    columns = [
        world.fields[name][:, rows.index(i)]
        if i in rows
        else np.broadcast_to(own[i], (len(world.valid), *own[i].shape))
        for i in ids
    ]
    return np.stack(columns, axis=1)


def rectangles(env, world, qpos, name):
    """(N, n, 4) footprints of boxes or ramps from where they are and how large their geoms are; NaN where absent."""
    module = env.modules[name]
    centre = qpos[:, module.qpos_ids[:, :2]]
    half = RAMP / 2 if name == "ramp" else field(env, world, "geom_size", module.geom_ids)[..., :2]
    rects = np.concatenate([centre - half, centre + half], axis=-1)
    return np.where(world.active[module.kind][..., None], rects, np.nan)


def standing_walls(env, world):
    """(N, n, 4) footprints of the wall geoms above the floor; NaN of the others."""
    ids = [i for i in range(env.model.ngeom) if env.model.geom(i).name.startswith("wall")]
    pos, half = field(env, world, "geom_pos", ids), field(env, world, "geom_size", ids)
    rects = np.concatenate([(pos - half)[..., :2], (pos + half)[..., :2]], axis=-1)
    return np.where((pos + half)[..., 2:] > 0, rects, np.nan)


def gap(a, b):
    """(N, n, m) how far rectangles (N, n, 4) and (N, m, 4) are apart along their best axis; negative: they overlap."""
    a, b = a[:, :, None], b[:, None]
    return (np.maximum(a[..., :2], b[..., :2]) - np.minimum(a[..., 2:], b[..., 2:])).max(axis=-1)


def distance(points, rects):
    """(N, n, m) from points (N, n, 2) to rectangles (N, m, 4)."""
    p, r = points[:, :, None], rects[:, None]
    return np.linalg.norm(np.maximum(np.maximum(r[..., :2] - p, p - r[..., 2:]), 0), axis=-1)


def overlaps(env, world, qpos):
    """(N,) bool: whether any two things of a world overlap. Comparisons with NaN are false: absent ones touch none."""
    agents = np.where(world.active["agent"][..., None], qpos[:, env.agents.qpos_ids[:, :2]], np.nan)
    things = np.concatenate([rectangles(env, world, qpos, name) for name in ("box", "ramp")], axis=1)
    walls = standing_walls(env, world)
    apart = np.linalg.norm(agents[:, :, None] - agents[:, None], axis=-1)
    found = np.triu(apart < 2 * RADIUS - TOL, 1).any((1, 2)) | np.triu(gap(things, things) < -TOL, 1).any((1, 2))
    found |= (gap(things, walls) < -TOL).any((1, 2))
    return found | (distance(agents, np.concatenate([things, walls], axis=1)) < RADIUS - TOL).any((1, 2))


@pytest.fixture(scope="module")
def full_layouts(full, batch_reset):
    return full, *draw(full, batch_reset, 11)


@pytest.fixture(scope="module")
def m_layouts(env_c, batch_reset):
    return env_c, *draw(env_c, batch_reset, 12)


@pytest.fixture(scope="module")
def mixed_layouts(batch_reset):
    """All scenarios in one batch, joint limits for outer walls, boxes of different sizes."""
    env = maax.Base(4, impl="c", grid_size=G, floor_size=FLOOR)
    env.add_module(maax.WallScenarios(["empty", "half", "quad", "var_quad", "tri", "random"], outer="limits"))
    env.add_module(maax.Agents(4))
    env.add_module(maax.Boxes((0, 5), n_elongated_boxes=(0, 2), box_size=(0.3, 0.5)))
    env.add_module(maax.Ramps((0, 2)))
    return env, *draw(env, batch_reset, 14)


@pytest.fixture(params=["full_layouts", "m_layouts", "mixed_layouts"])
def layouts(request):
    return request.getfixturevalue(request.param)


def test_fewer_than_one_layout_in_ten_thousand_fails(layouts):
    _, world, _, invalid = layouts
    np.testing.assert_array_equal(invalid, ~world.valid)
    assert invalid.sum() < 1


def test_nothing_overlaps(layouts):
    env, world, qpos, _ = layouts
    assert not overlaps(env, world, qpos).any()
    # The oracle sees what there is to see: with its neighbour's ramps, or walls, a world has overlaps.
    mixed, ids = qpos.copy(), env.modules["ramp"].qpos_ids
    mixed[:, ids] = np.roll(qpos, 1, axis=0)[:, ids]
    assert overlaps(env, world, mixed).mean() > 0.02
    rolled = {name: np.roll(value, 1, axis=0) for name, value in world.fields.items()}
    if len(np.unique(world.plan.rooms, axis=0)) > 1:  # M's rooms are the same in all worlds
        assert overlaps(env, world.replace(fields=rolled), qpos).mean() > 0.1


def test_everything_is_inside_the_floor_and_on_it(layouts):
    env, world, qpos, _ = layouts
    for name in ("box", "ramp"):
        rects = rectangles(env, world, qpos, name)
        assert np.nanmin(rects) > -TOL
        assert np.nanmax(rects) < FLOOR + TOL
    agents = qpos[:, env.agents.qpos_ids[:, :2]]
    assert agents.min() > RADIUS - TOL
    assert agents.max() < FLOOR - RADIUS + TOL
    for name, height in (("agent", RADIUS), ("box", None), ("ramp", 0.25)):
        module = env.modules[name]
        z = qpos[:, module.qpos_ids[:, 2]]
        active = world.active[module.kind]
        height = field(env, world, "geom_size", module.geom_ids)[..., 2][active] if height is None else height
        assert (np.abs(z[active] - height) < 1e-3).all()
        assert (z[~active] > 10).all()
    # Outer walls reach a metre beyond the floor, in the physics alone.
    inner, planned = standing_walls(env, world)[:, 4:], np.asarray(world.plan.walls)
    for walls in (inner, planned):
        assert np.nanmin(walls) > -TOL
        assert np.nanmax(walls) < FLOOR + TOL


def test_counts_follow_openai_s_rule(full_layouts):
    """Boxes U{3..9}; of these elongated U{3..min(9, boxes)}; of those along x U{0..elongated}, the first indices."""
    env, world, _, _ = full_layouts
    active = world.active["box"]
    n = active.sum(axis=1)
    np.testing.assert_array_equal(active, np.arange(9) < n[:, None])
    assert stats.chisquare(np.bincount(n, minlength=10)[3:]).pvalue > P_MIN
    size = 2 * field(env, world, "geom_size", env.modules["box"].geom_ids)
    along_x, along_y, cube = (
        (np.abs(size - shape) < 1e-5).all(axis=-1) & active
        for shape in ((1.65, 0.15, 0.5), (0.15, 1.65, 0.5), (0.5,) * 3)
    )
    np.testing.assert_array_equal(along_x | along_y | cube, active)
    n_x, n_long = along_x.sum(axis=1), (along_x | along_y).sum(axis=1)
    np.testing.assert_array_equal(along_x, np.arange(9) < n_x[:, None])
    np.testing.assert_array_equal(along_x | along_y, np.arange(9) < n_long[:, None])
    observed = np.zeros((10, 10, 10))
    np.add.at(observed, (n, n_long, n_x), 1)
    expected = np.zeros_like(observed)
    for boxes in range(3, 10):
        for long in range(3, boxes + 1):
            expected[boxes, long, : long + 1] = N / 7 / (boxes - 2) / (long + 1)
    assert not observed[expected == 0].any()
    assert stats.chisquare(observed[expected > 0], expected[expected > 0]).pvalue > P_MIN
    assert stats.chisquare(np.bincount(world.plan.room_mask.sum(axis=1), minlength=5)[1:]).pvalue > P_MIN
    assert world.active["ramp"].all()
    assert world.active["agent"].all()


def test_counts_are_independent_of_each_other(full_layouts):
    """Rooms, boxes and outer walls come from draws of their own."""
    env, world, _, _ = full_layouts
    outer = ~np.isnan(standing_walls(env, world)[:, :4, 0])
    assert (outer.all(axis=1) | ~outer.any(axis=1)).all()
    assert stats.binomtest(int(outer[:, 0].sum()), N, 0.5).pvalue > P_MIN
    boxes, rooms = world.active["box"].sum(axis=1), world.plan.room_mask.sum(axis=1)
    for a, b in ((boxes, rooms), (boxes, outer[:, 0]), (rooms, outer[:, 0])):
        table = np.zeros((10, 10))
        np.add.at(table, (a, b.astype(int)), 1)
        table = table[table.any(axis=1)][:, table.any(axis=0)]
        assert stats.chi2_contingency(table).pvalue > P_MIN


def test_it_holds_together_under_full_force(full, full_layouts, batch_reset, batch_step):
    """100 steps of held full force in 200 worlds: faults are rare and contained, and what was parked has not moved."""
    states = batch_reset(full, jax.random.split(seeds.key(13), BATCH))
    states = jax.jit(lambda states: jax.tree.map(lambda x: x[:200], states))(states)
    before, faults = np.asarray(states.data.qpos), np.zeros(200, bool)
    rng = seeds.rng(0)
    for t in range(100):
        if t % 20 == 0:
            action = {"move": rng.choice([-1.0, 1.0], (200, 4, 3)).astype(np.float32)}
        states = batch_step(full, states, action)
        faults |= np.asarray(states.metrics["physics_fault"])
    assert faults.mean() < 0.02, "a thin box, squeezed through another one, may be thrown out"
    after, boxes = np.asarray(states.data.qpos), full.modules["box"]
    assert np.isfinite(after).all()
    absent = ~np.asarray(states.world.active["box"])
    np.testing.assert_allclose(after[:, boxes.qpos_ids][absent], before[:, boxes.qpos_ids][absent], atol=1e-6)
    moved = np.abs(after - before)[:, boxes.qpos_ids][..., :2].max(axis=-1)[~absent]
    assert (moved > 0.1).mean() > 0.1
