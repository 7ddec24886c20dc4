"""Layouts against independent geometry in plain NumPy: walls, doors, placement, parking, worlds that are too full."""

from __future__ import annotations

import copy

import jax
import mujoco
import numpy as np
import pytest
from helpers import seeds
from helpers.chance import P_MIN
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, stats

import maax_mjx as maax

N, BATCH = 2000, 500
CELL, FLOOR, RADIUS, HALF = 0.2, 6.0, 0.15, 0.25
LINE, THIN = 3.1, 0.05  # centre line of both quadrant walls, half their thickness
TOL = 1e-4
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


def draw(env, batch_reset, seed=0, n=N, **ranges):
    """`n` layouts on the host."""
    keys = jax.random.split(seeds.key(seed), n).reshape(-1, BATCH)
    params = env.default_params.replace(**ranges)
    parts = [jax.device_get(batch_reset(env, k, params).replace(key=())) for k in keys]
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def places(env, state, name):
    """(N, n, 2) positions, NaN where absent: NaN compares false, so that absent objects overlap nothing."""
    module = env.modules[name]
    return np.where(state.world.active[module.kind][..., None], state.data.qpos[:, module.qpos_ids[:, :2]], np.nan)


def squares(env, state):
    """(N, n, 4) x0, y0, x1, y1 of boxes and ramps."""
    centre = np.concatenate([places(env, state, name) for name in ("box", "ramp")], axis=1)
    return np.concatenate([centre - HALF, centre + HALF], axis=-1)


def walls(env, state):
    """(N, n, 4) rectangles of the walls that stand on the floor, from the drawn geoms; NaN where absent."""
    assert all(env.model.geom(i).name.startswith("wall") for i in env.overlay["geom_pos"])
    pos, half = state.world.fields["geom_pos"], state.world.fields["geom_size"]
    rects = np.concatenate([(pos - half)[..., :2], (pos + half)[..., :2]], axis=-1)
    return np.where((pos + half)[..., 2:] > 0, rects, np.nan)


def rects_overlap(a, b):
    """(N, n, m) bool of rectangles (N, n, 4) and (N, m, 4)."""
    a, b = a[:, :, None], b[:, None]
    return (np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])).min(axis=-1) > TOL


def distance(points, rects):
    """(..., n, m) from points (..., n, 2) to rectangles (..., m, 4)."""
    p, r = points[..., :, None, :], rects[..., None, :, :]
    return np.linalg.norm(np.maximum(np.maximum(r[..., :2] - p, p - r[..., 2:]), 0), axis=-1)


def overlaps(env, state):
    """(N,) bool: whether any two things of a world overlap."""
    agents, things, solid = places(env, state, "agent"), squares(env, state), walls(env, state)
    apart = np.linalg.norm(agents[:, :, None] - agents[:, None], axis=-1)
    found = np.triu(apart < 2 * RADIUS - TOL, 1).any((1, 2)) | np.triu(rects_overlap(things, things), 1).any((1, 2))
    for rects in (things, solid):
        found |= (distance(agents, rects) < RADIUS - TOL).any((1, 2))
    return found | rects_overlap(things, solid).any((1, 2))


def is_uniform(observed):
    return stats.chisquare(np.ravel(observed)).pvalue > P_MIN


def histogram(shape, *indices):
    table = np.zeros(shape, int)
    np.add.at(table, tuple(np.asarray(i).astype(int) for i in indices), 1)
    return table


@pytest.fixture(scope="module")
def standard(env_c, batch_reset):
    return env_c, draw(env_c, batch_reset)


@pytest.fixture(scope="module")
def ranged(env_ranges, batch_reset):
    return env_ranges, draw(env_ranges, batch_reset, seed=1)


@pytest.fixture(params=["standard", "ranged"])
def layouts(request):
    return request.getfixturevalue(request.param)


def test_nothing_overlaps_or_leaves_the_room(layouts):
    env, state = layouts
    assert state.world.valid.all()
    assert not state.metrics["layout_invalid"].any()
    assert not overlaps(env, state).any()
    for name, radius in (("agent", RADIUS), ("box", HALF), ("ramp", HALF)):
        xy = places(env, state, name)
        assert np.nanmin(xy) - radius > 0.15 - TOL
        assert np.nanmax(xy) + radius < FLOOR - 0.15 + TOL
        depth = radius - state.data.qpos[:, env.modules[name].qpos_ids[:, 2]][~np.isnan(xy[..., 0])]
        assert ((depth > -1e-6) & (depth < 5e-4)).all()  # on the floor, as deep as a soft contact gives way
    # The oracle sees what is there to see: with the boxes of a neighbouring world, things do overlap.
    mixed, ids = np.array(state.data.qpos), env.modules["box"].qpos_ids
    mixed[:, ids] = np.roll(mixed, 1, axis=0)[:, ids]
    assert overlaps(env, state.replace(data=state.data.replace(qpos=mixed))).any()


def test_hiders_start_inside_the_quadrant_and_seekers_outside(layouts):
    agents = places(*layouts, "agent")
    x, y = agents[:, :2, 0], agents[:, :2, 1]
    assert ((x - RADIUS > LINE + THIN - TOL) & (y + RADIUS < LINE - THIN + TOL)).all()
    x, y = agents[:, 2:, 0], agents[:, 2:, 1]
    assert ((x + RADIUS < LINE - THIN + TOL) | (y - RADIUS > LINE + THIN - TOL)).all()


def test_walls_stand_where_the_rules_put_them(layouts):
    env, state = layouts
    rects, world = walls(env, state), state.world

    def outer(a, b, c, d):
        return np.broadcast_to([[a, a, b, d], [c, a, d, d], [a, a, d, b], [a, c, d, d]], (N, 4, 4))

    # In the physics they reach a metre further out.
    close(rects[:, :4], outer(-1.0, 0.15, FLOOR - 0.15, FLOOR + 1.0), atol=1e-5)
    planned = np.concatenate([outer(0.05, 0.15, FLOOR - 0.15, FLOOR - 0.05), rects[:, 4:]], axis=1)
    for inner, across in ((rects[:, 4:6], 0), (rects[:, 6:], 1)):
        assert np.nanmax(abs(inner[..., [across, across + 2]] - [LINE - THIN, LINE + THIN])) < 1e-5
    standing = ~np.isnan(rects[..., 0])
    heights = np.where(standing, [4.0] * 4 + [0.5] * 4, 0)
    equal(world.plan.wall_mask, standing)
    close(world.plan.walls, np.nan_to_num(planned), atol=1e-5)
    close(world.plan.wall_heights, heights)
    pos, half = world.fields["geom_pos"], world.fields["geom_size"]
    close((pos - half)[standing][:, 2], 0, atol=1e-6)
    close((pos + half)[standing][:, 2], heights[standing], rtol=1e-6)
    close(world.fields["geom_rbound"], np.linalg.norm(half, axis=-1), rtol=1e-6)
    equal(world.fields["geom_aabb"], np.concatenate([np.zeros_like(half), half], axis=-1))


@pytest.fixture(scope="module")
def rooms(standard):
    """Every distinct set of walls once: rectangles (U, 8, 4), observed doors (U, 2, 3), and the openings (U, 2, 2) as
    measured: from where to where no rectangle covers the centre line of the vertical and the horizontal wall."""
    rects = walls(*standard)
    first = np.unique(np.nan_to_num(rects).reshape(N, -1), axis=0, return_index=True)[1]
    openings = np.zeros((len(first), 2, 2))
    for i, room in enumerate(rects[first]):
        for across, along in ((0, 1), (1, 0)):
            on_line = room[(room[:, across] < LINE) & (room[:, across + 2] > LINE)][:, [along, along + 2]]
            start, end = on_line[np.argsort(on_line[:, 0])].T
            low, high = np.maximum.accumulate(end)[:-1], start[1:]
            # The quadrant's part of the line is below LINE for the vertical wall, above it for the horizontal one.
            own = (high - low > TOL) & (low < LINE if across == 0 else high > LINE)
            assert own.sum() == 1
            openings[i, across] = low[own][0], high[own][0]
    return rects[first], standard[1].obs["door_obs"][first], openings


def test_observed_doors_are_the_true_openings(rooms):
    _, doors, openings = rooms
    widths = openings[..., 1] - openings[..., 0]
    whole = (widths < 1).all(axis=1)  # leaves out what the next test is about
    assert whole.sum() >= 12 * 13 - 1
    doors, openings, widths = doors[whole], openings[whole], widths[whole]
    for wall, ends in enumerate([(0.15, LINE - THIN), (LINE + THIN, FLOOR - 0.15)]):
        close(doors[:, wall, wall], LINE, atol=1e-5)
        close(doors[:, wall, 1 - wall], openings[:, wall].mean(axis=1), atol=1e-5)
        close(doors[:, wall, 2], widths[:, wall], atol=1e-5)
        at_end = (abs(openings[:, wall] - ends) < TOL).any(axis=1)
        assert at_end.any()
        close(widths[:, wall], np.where(at_end, 0.6, 0.7), atol=1e-5)


def test_two_doors_at_the_corner_leave_its_post(rooms):
    assert (rooms[2][..., 1] - rooms[2][..., 0] < 1).all()


def test_an_agent_passes_either_door(rooms):
    axis = np.arange(120) * 0.05 + 0.025
    raster = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    low, high = LINE - THIN, LINE + THIN
    open_without = distance(raster, np.array([[low, 0, high, high], [low, low, FLOOR, high]])) >= RADIUS
    for room in rooms[0]:
        free = ~(distance(raster, room) < RADIUS).any(axis=1)
        for shut, connected in (([], True), ([0], True), ([1], True), ([0, 1], False)):
            labels, _ = ndimage.label((free & open_without[:, shut].all(axis=1)).reshape(120, 120))
            inside, outside = labels[90, 30], labels[30, 90]
            assert inside * outside > 0
            assert (inside == outside) == connected


def test_door_starts_are_uniform(standard):
    # Cells 1 to L - door of walls of L = 15 (vertical) and L = 14 (horizontal) cells; an opening at either end is
    # half a thickness off the middle of its cells.
    doors = standard[1].obs["door_obs"]
    vertical, horizontal = np.round(doors[:, 0, 1] / CELL - 1), np.round(doors[:, 1, 0] / CELL - 16)
    assert vertical.min() == horizontal.min() == 1
    assert (vertical.max(), horizontal.max()) == (13, 12)
    assert is_uniform(histogram((13, 12), vertical - 1, horizontal - 1))


def test_counts_are_uniform_and_independent(ranged):
    active = ranged[1].world.active
    n = {kind: mask.sum(axis=1) for kind, mask in active.items()}
    for kind, mask in active.items():
        equal(mask, np.arange(mask.shape[1]) < n[kind][:, None])
    assert (n["agent"] == 4).all()
    assert is_uniform(histogram((4, 3), n["box"], n["ramp"]))


def test_agents_are_uniform_over_the_free_cells(standard):
    agents = places(*standard, "agent")
    x, y = np.indices((30, 30))
    clear = (x >= 1) & (y >= 1) & (x <= 27) & (y <= 27)
    # Lower-left cells of 2 x 2 cells in the quadrant, or clear of it and its walls; the first of either team.
    for agent, allowed in ((0, clear & (x >= 16) & (y <= 13)), (2, clear & ~((x >= 14) & (y <= 15)))):
        corner, within = np.divmod((agents[:, agent] - RADIUS) / CELL + 1e-6, 1)
        observed = histogram((30, 30), *corner.T)[allowed]
        assert observed.sum() == N
        assert is_uniform(observed)
        # Two cells leave a slack of half a cell, and positions are uniform in it.
        assert all(stats.kstest(w / 0.5, "uniform").pvalue > P_MIN for w in within.T)


def ordered(limit):
    return st.tuples(st.integers(0, limit), st.integers(0, limit)).map(lambda p: (min(p), max(p)))


@settings(max_examples=12)
@given(seed=st.integers(0, 2**31), boxes=ordered(3), ramps=ordered(2))
def test_any_seed_and_any_ranges(env_ranges, batch_reset, seed, boxes, ramps):
    state = draw(env_ranges, batch_reset, seed, BATCH, n_boxes=boxes, n_ramps=ramps)
    assert state.world.valid.all()
    assert not overlaps(env_ranges, state).any()
    for kind, (low, high) in (("box", boxes), ("ramp", ramps)):
        assert set(state.world.active[kind].sum(axis=1)) == set(range(low, high + 1))


def test_the_key_determines_the_layout(ranged, batch_reset):
    env, state = ranged
    assert len(np.unique(state.data.qpos, axis=0)) == N
    keys = jax.random.split(seeds.key(1), N)[:BATCH]
    again = jax.device_get(batch_reset(env, keys[::-1]).replace(key=()))
    first = jax.tree.map(lambda x: x[:BATCH][::-1], state)
    jax.tree.map(equal, (first.world, first.data.qpos), (again.world, again.data.qpos))


@pytest.mark.parametrize("wanted", [(9, 9), (0, 4), (2, 1), (-1, 1)])
def test_impossible_params_under_jit_are_flagged(env_ranges, batch_reset, wanted):
    state = draw(env_ranges, batch_reset, 2, BATCH, n_boxes=wanted)
    assert not state.world.valid.any()
    assert state.metrics["layout_invalid"].all()
    assert np.isfinite(state.data.qpos).all()
    with pytest.raises(ValueError, match="n_boxes"):
        env_ranges.reset(seeds.key(0), env_ranges.default_params.replace(n_boxes=wanted))


def test_an_added_object_changes_a_place_only_by_taking_it(env_ranges, batch_reset):
    few, many = (draw(env_ranges, batch_reset, 3, BATCH, n_boxes=n, n_ramps=1) for n in (0, 3))
    equal(places(env_ranges, few, "agent"), places(env_ranges, many, "agent"))
    before, after = (places(env_ranges, state, "ramp")[:, :1] for state in (few, many))
    ramp, boxes = (np.floor((p - HALF) / CELL + 1e-3) for p in (before, places(env_ranges, many, "box")))
    taken = (abs(ramp - boxes) < 3).all(axis=-1).any(axis=1)
    assert taken.sum() > 20
    equal((before == after).all(axis=(1, 2)), ~taken)


def test_parked_entities_stay_where_they_are(env_ranges, batch_reset):
    env = env_ranges
    start = jax.tree.map(lambda x: x[:32], batch_reset(env, jax.random.split(seeds.key(4), BATCH)))

    def step(state, key):
        return jax.vmap(env.step)(state, jax.vmap(env.sample_action)(jax.random.split(key, 32))), None

    end = jax.jit(lambda s, k: jax.lax.scan(step, s, k)[0])(start, jax.random.split(seeds.key(5), 500))
    before, after = np.asarray(start.data.qpos), np.asarray(end.data.qpos)
    assert (abs(after - before)[:, env.modules["agent"].qpos_ids[:, :2]].max(axis=(1, 2)) > 0.1).all()
    absent = [set() for _ in range(32)]
    for module in (env.modules["box"], env.modules["ramp"]):
        mask = ~np.asarray(start.world.active[module.kind])
        assert 0 < mask.sum() < mask.size
        assert (before[:, module.qpos_ids][mask][:, 2] > 10).all()
        close(after[:, module.qpos_ids][mask], before[:, module.qpos_ids][mask], rtol=0, atol=1e-6)
        for world, i in np.argwhere(mask):
            absent[world].add(int(module.body_ids[i]))
    order = np.argsort([len(bodies) for bodies in absent])
    assert len(absent[order[-1]]) >= 4
    for world in order[[0, 16, -1]]:
        model = mujoco.MjModel.from_xml_string(maax.to_mjcf(env, end, world=int(world)))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        touching = set(model.geom_bodyid[data.contact.geom.ravel()])
        for _ in range(50):
            mujoco.mj_step(model, data)
            touching |= set(model.geom_bodyid[data.contact.geom.ravel()])
        assert touching
        assert not touching & absent[world]


@pytest.fixture(scope="module")
def crowded():
    """A floor of 10 x 10 cells between walls, for 2 agents of 2 x 2 cells and up to 6 boxes of 4 x 4."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("maax_mjx.core.capacity.check_room", lambda *_: None)
        env = maax.Base(2, grid_size=12, floor_size=1.8, impl="c")
        for module in (maax.WallScenarios("empty"), maax.Agents(2), maax.Boxes((0, 6)), maax.Ramps(0)):
            env.add_module(module)
    return env


@pytest.mark.slow
def test_a_layout_that_is_too_full_is_contained(crowded, batch_reset, batch_step):
    env = crowded
    state = batch_reset(env, jax.random.split(seeds.key(0), 64), env.default_params.replace(n_boxes=6))
    ids = env.modules["box"].qpos_ids
    active = np.asarray(state.world.active["box"])
    assert (active.any(axis=1) & ~active.all(axis=1)).all()
    assert not np.asarray(state.world.valid).any()
    assert np.asarray(state.metrics["layout_invalid"]).all()
    assert not overlaps(env, jax.device_get(state.replace(key=()))).any()
    equal(state.obs["box_mask"], active)
    assert not np.asarray(state.obs["box_obs"])[~active].any()
    parked = np.asarray(state.data.qpos)[:, ids][~active]
    assert (parked[:, 2] > 10).all()
    action = {"move": seeds.rng(0).uniform(-1, 1, (64, 2, 3)).astype(np.float32)}
    for _ in range(50):
        state = batch_step(env, state, action)
        assert np.asarray(state.metrics["layout_invalid"]).all()
        assert not np.asarray(state.metrics["physics_fault"]).any()
    close(np.asarray(state.data.qpos)[:, ids][~active], parked, rtol=0, atol=1e-6)
    for leaf in (state.data.qpos, state.data.qvel, state.reward, *state.obs.values()):
        assert np.isfinite(np.asarray(leaf, float)).all()


@pytest.mark.slow
def test_a_layout_that_did_not_fit_is_drawn_again(crowded, batch_reset, monkeypatch):
    keys, params = jax.random.split(seeds.key(0), 64), crowded.default_params.replace(n_boxes=3)
    state = batch_reset(crowded, keys, params)
    valid = np.asarray(state.world.valid)
    equal(valid, np.asarray(state.world.active["box"]).sum(axis=1) == 3)
    monkeypatch.setattr("maax_mjx.core.generation.LAYOUT_TRIES", 1)
    # A copy: the layouts of the other are compiled with more tries.
    once = jax.jit(jax.vmap(copy.deepcopy(crowded).reset, in_axes=(0, None)))(keys, params)
    fit = np.asarray(once.world.valid)
    assert 0.2 < fit.mean() < 0.8
    assert valid.mean() > 0.95
    equal(np.asarray(state.data.qpos)[fit], np.asarray(once.data.qpos)[fit])
