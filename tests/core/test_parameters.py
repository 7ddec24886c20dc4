"""Every randomisation parameter: what it names is what it changes, alone, per world, and without a retrace."""

from __future__ import annotations

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.chance import P_MIN
from helpers.zoo import N, active, draw, field, make, reset_of, uniform, wall_rects, zoo_env
from scipy import stats

import maax_mjx as maax

equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


def readings(env, state):
    """By parameter, (N, k) of what it is said to set, read from the world; NaN where there is nothing to read."""
    module, plan = env.modules, state.world.plan

    def of(name, kind, field_name, ids, column):
        value = field(env, state, field_name, ids)
        value = value if value.ndim == 2 else value[..., column]
        return np.where(active(state, kind), value, np.nan)

    agents, boxes, ramps, cylinders = (module[n] for n in ("agent", "box", "ramp", "cylinder"))
    size = 2 * field(env, state, "geom_size", boxes.geom_ids)
    long = (np.abs(size[..., 0] - size[..., 1]) > 1e-4) & active(state, "box")
    corners = np.ptp(np.asarray(state.obs["construction_site_corner_pos"]), axis=2)
    long_sites = (np.abs(corners[..., 0] - corners[..., 1]) > 1e-4) & active(state, "construction_site")
    quad, rooms = np.asarray(plan.scenario) == 0, np.asarray(plan.room_mask).sum(axis=1)
    one_door = np.asarray(plan.door_mask).sum(axis=1) == 1
    team = active(state, "agent").reshape(N, 2, 3).sum(axis=2)
    walls = [i for i in range(env.model.ngeom) if env.model.geom(i).name.startswith("wall")]
    out = {
        "floor_size": plan.floor_size,
        "wall_friction": field(env, state, "geom_friction", walls)[..., 0],
        "prob_outside_walls": ~np.isnan(wall_rects(env, state)[:, 0, 0]),
        "p_door_dropout": np.where(quad, one_door, np.nan),
        "n_rooms": np.where(quad, np.nan, rooms),
        "floor_friction": field(env, state, "geom_friction", [0])[..., 0],
        "gravity": state.world.fields["opt.gravity"],
        "n_hiders": team[:, 0],
        "n_seekers": team[:, 1],
        "agent_friction": of("agent", "agent", "geom_friction", agents.geom_ids, 0),
        "agent_damping": of("agent", "agent", "dof_damping", agents.qvel_ids[:, 0], 0),
        "agent_gear": of("agent", "agent", "actuator_gear", agents.ctrl_ids.reshape(6, 3)[:, 0], 0),
        "box_friction": of("box", "box", "geom_friction", boxes.geom_ids, 0),
        "box_size": of("box", "box", "geom_size", boxes.geom_ids, 2) * 2,
        "box_mass": of("box", "box", "body_mass", boxes.body_ids, 0),
        "n_elongated_boxes": long.sum(axis=1),
        "ramp_friction": of("ramp", "ramp", "geom_friction", ramps.geom_ids, 0),
        "cylinder_friction": of("cylinder", "cylinder", "geom_friction", cylinders.geom_ids, 0),
        "cylinder_diameter": of("cylinder", "cylinder", "geom_size", cylinders.geom_ids, 0) * 2,
        "cylinder_height": of("cylinder", "cylinder", "geom_size", cylinders.geom_ids, 1) * 2,
        "n_elongated_sites": long_sites.sum(axis=1),
    }
    counts = {"n_boxes": "box", "n_ramps": "ramp", "n_cylinders": "cylinder", "n_food": "food"}
    for name, kind in (counts | {"n_sites": "construction_site"}).items():
        out[name] = active(state, kind).sum(axis=1)
    return {name: np.asarray(value, float).reshape(N, -1) for name, value in out.items()}


ALONE = {
    "floor_size": 6.25,
    "wall_friction": 0.3,
    "prob_outside_walls": 1.0,
    "p_door_dropout": 0.0,
    "n_rooms": 3,
    "floor_friction": 0.4,
    "gravity": -12.5,
    "n_hiders": 2,
    "n_seekers": 3,
    "agent_friction": 0.5,
    "agent_damping": 7.0,
    "agent_gear": 60.0,
    "n_boxes": 2,
    "box_friction": 0.2,
    "box_size": 0.35,
    "box_mass": 2.0,
    "n_elongated_boxes": 2,
    "n_ramps": 1,
    "ramp_friction": 0.6,
    "n_cylinders": 2,
    "cylinder_friction": 0.7,
    "cylinder_diameter": 0.4,
    "cylinder_height": 0.5,
    "n_food": 1,
    "n_sites": 2,
    "n_elongated_sites": 1,
}
ALSO = {"n_boxes": "n_elongated_boxes", "n_sites": "n_elongated_sites"}  # which are as many as there are, at most
NOT_DRAWN_UNIFORMLY = {"prob_outside_walls", "p_door_dropout", "n_elongated_boxes", "n_elongated_sites"}
WEIGHTLESS = [n for n in ALONE if n.endswith(("friction", "mass", "gear", "damping", "gravity", "height"))]
BEYOND = {"gravity": -4.0, "prob_outside_walls": 1.5, "p_door_dropout": 1.5}


@pytest.fixture(scope="module")
def zoo():
    env = zoo_env()
    state = draw(env, 20)
    return env, state, readings(env, state)


def places(env, state, name):
    module = env.modules[name]
    if name in ("food", "construction_site"):
        xy = np.asarray(state.world.sites[module.kind])[..., :2]
    else:
        xy = np.asarray(state.data.qpos)[:, module.qpos_ids[:, :2]]
    return np.where(active(state, module.kind)[..., None], xy, np.nan).reshape(N, -1)


@pytest.mark.slow
def test_every_range_is_a_parameter_and_no_fixed_number_is(zoo):
    env, _, read = zoo
    assert set(env.default_params) == set(read) == set(ALONE)
    fixed = make(
        1,
        maax.WallScenarios("quad", friction=0.5),
        maax.FloorAttributes(0.3),
        maax.WorldConstants(-9.0),
        maax.Agents(1, friction=0.3, damping=8.0, gear=90.0),
        maax.Boxes(2, box_size=0.4, box_mass=2.0, box_friction=0.3),
        maax.Ramps(1, ramp_friction=0.2),
        maax.Cylinders(1, 0.4, 0.3, friction=0.2),
    )
    words = ("friction", "gravity", "damping", "gear", "size", "mass", "diameter", "height")
    assert not [name for name in fixed.default_params if any(word in name for word in words)]
    model = fixed.model
    assert model.opt.gravity[2] == -9.0
    names = {"floor": 0.3, "wall0": 0.5, "agent0": 0.3, "box1": 0.3, "ramp0": 0.2, "cylinder0": 0.2}
    for name, friction in names.items():
        assert model.geom(name).friction[0] == pytest.approx(friction)
    assert model.body("box1").mass[0] == pytest.approx(2.0)
    close(model.geom("box1").size, 0.2)
    close(model.geom("cylinder0").size[:2], [0.2, 0.15])
    close(model.actuator_gear[:3, 0], 90)
    close(model.joint("agent0:x").damping, 8)


@pytest.mark.slow
@pytest.mark.parametrize("narrow", [False, True])
def test_draws_are_uniform_over_their_ranges(narrow, zoo):
    env, _, read = zoo
    ranges = {name: np.asarray(env.default_params[name]) for name in set(ALONE) - NOT_DRAWN_UNIFORMLY}
    if narrow:
        for name, (low, high) in ranges.items():
            quarter = (high - low) / 4
            counts = ranges[name].dtype.kind == "i"
            ranges[name] = np.array([high - 1, high] if counts else [low + quarter, high - quarter])
        read = readings(env, draw(env, 21, **ranges))
    for name, (low, high) in ranges.items():
        values = read[name]
        values = values[:, 0][~np.isnan(values[:, 0])]
        assert len(values) > 250, name
        if ranges[name].dtype.kind == "i":
            assert low <= values.min() <= values.max() <= high, name
            assert stats.chisquare(np.bincount(values.astype(int), minlength=high + 1)[low:]).pvalue > P_MIN, name
        else:
            assert uniform(values, low, high), name


@pytest.mark.slow
@pytest.mark.parametrize("name", ALONE)
def test_a_parameter_alone_changes_what_it_names(name, zoo):
    """With the same keys, everything else that is drawn stays as it was, to the bit."""
    env, before, was = zoo
    value = ALONE[name]
    state = draw(env, 20, **{name: value})
    read = readings(env, state)
    assert np.asarray(state.world.valid).all()
    if name.startswith("n_elongated"):
        there = read["n_boxes" if "box" in name else "n_sites"]
        equal(read[name], np.minimum(value, there))
    else:
        seen = read[name][~np.isnan(read[name])]
        assert seen.size > 250
        close(seen, value, rtol=1e-6)
    assert not np.array_equal(read[name], was[name], equal_nan=True)
    for other in set(ALONE) - {name, ALSO.get(name)}:
        both = ~np.isnan(was[other]) & ~np.isnan(read[other])
        equal(read[other][both], was[other][both], err_msg=other)
        if not name.startswith("n_"):
            equal(np.isnan(read[other]), np.isnan(was[other]), err_msg=other)
    if name in WEIGHTLESS:
        for kind in ("agent", "box", "ramp", "cylinder", "food", "construction_site"):
            equal(places(env, state, kind), places(env, before, kind), err_msg=kind)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["n_ramps", "n_cylinders", "cylinder_diameter", "n_food", "n_sites", "n_elongated_sites"]
)
def test_what_is_placed_before_stays_where_it_is(name, zoo):
    """Unless the layout as a whole had to be drawn again."""
    env, before, _ = zoo
    state = draw(env, 20, **{name: ALONE[name]})
    order = ["agent", "box", "ramp", "cylinder", "food", "construction_site"]
    place = next(i for i, kind in enumerate(order) if kind.split("_")[-1].rstrip("s") in name)
    for kind in order[:place]:
        same = places(env, state, kind) == places(env, before, kind)
        assert (same | np.isnan(places(env, before, kind))).all(axis=1).mean() > 0.99, kind


def test_every_world_may_have_ranges_of_its_own(zoo):
    """All parameters at once: the values of the table in even worlds, other ones in odd worlds."""
    env, _, _ = zoo
    even = (np.arange(N) % 2 == 0)[:, None]
    odd = {n: env.default_params[n][1 if ALONE[n] == env.default_params[n][0] else 0] for n in ALONE}
    odd |= {"n_boxes": 4, "n_sites": 3, "p_door_dropout": 1.0}
    ranges = {n: np.where(even, ALONE[n], np.asarray(odd[n])) * np.ones((1, 2)) for n in ALONE}
    ranges = {n: jnp.asarray(r, env.default_params[n].dtype) for n, r in ranges.items()}
    read = readings(env, draw(env, 22, **ranges))
    for name, value in read.items():
        want = np.broadcast_to(np.asarray(ranges[name])[:, :1], value.shape)
        if name == "prob_outside_walls":
            assert value[::2].all()
            assert stats.binomtest(int(value[1::2].sum()), N // 2, float(want[1, 0])).pvalue > P_MIN
        else:
            assert (~np.isnan(value)).sum() > 250
            close(value, np.where(np.isnan(value), np.nan, want), rtol=1e-6, err_msg=name)


def test_nothing_was_traced_twice(zoo):
    assert reset_of(zoo[0])._cache_size() == 1


@pytest.mark.parametrize("name", ALONE)
def test_beyond_its_bound_a_parameter_is_refused(name, zoo):
    params = zoo[0].default_params
    high = np.asarray(params[name])[1]
    value = BEYOND.get(name, high + 1 if isinstance(ALONE[name], int) else float(high) * 1.1)
    bound = {"prob_outside_walls": 1.0, "p_door_dropout": 1.0}.get(name, high)
    with pytest.raises(ValueError, match=name) as error:
        zoo[0].check_params(params.replace(**{name: value}))
    told = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", str(error.value))]
    assert any(np.isclose(told, value))
    assert any(np.isclose(told, bound))
    zoo[0].check_params(params.replace(**{name: ALONE[name]}))


# Modules that come and go, and batches that change their ranges on the way.


class Counting(maax.Module):
    """Counts how often it is traced."""

    name = "counting"
    traces = 0

    def layout_step(self, key, layout, params):
        self.traces += 1
        return layout


def small(*extra, horizon=1000):
    env = maax.Base(2, impl="c", horizon=horizon)
    modules = [maax.WallScenarios("empty", outer="none"), Counting(), maax.Agents(2, gear=(50, 150)), *extra[:1]]
    for module in (*modules, maax.Boxes((0, 3), box_size=(0.3, 0.5), box_mass=(0.5, 3.0)), *extra[1:]):
        env.add_module(module)
    return env


@pytest.fixture(scope="module")
def plain():
    return small(horizon=3)


@pytest.mark.slow
def test_modules_are_independent(plain):
    """Ramps before the boxes and food after them: the boxes' draws are as before, and so are their places if free."""
    more = small(maax.Ramps((1, 2), ramp_friction=(0.1, 0.9)), maax.Food(2))
    a, b = draw(plain, 30), draw(more, 30)
    equal(active(a, "box"), active(b, "box"))
    for name in ("body_mass", "body_inertia", "geom_size", "actuator_gear"):
        module = "agent" if name == "actuator_gear" else "box"
        ids = [getattr(env.modules[module], f"{name.split('_')[0]}_ids", None) for env in (plain, more)]
        ids = ids if module == "box" else [env.agents.ctrl_ids for env in (plain, more)]
        there = active(a, "box") if module == "box" else slice(None)
        x, y = field(plain, a, name, ids[0])[there], field(more, b, name, ids[1])[there]
        equal(x, y, err_msg=name)
    equal(places(plain, a, "agent"), places(more, b, "agent"))
    first = active(a, "box")[:, 0]
    old, new = (places(env, s, "box")[first, :2] for env, s in ((plain, a), (more, b)))
    half = field(plain, a, "geom_size", plain.modules["box"].geom_ids)[first, 0, :1]
    ramps = places(more, b, "ramp").reshape(N, 2, 2)[first]
    low, ramp_low = np.floor((old - half) / 0.2 + 1e-3), np.floor((ramps - 0.25) / 0.2 + 1e-3)
    cells = np.ceil(2 * half / 0.2 - 1e-4)
    taken = ((low[:, None] < ramp_low + 3) & (ramp_low < low[:, None] + cells[:, None])).all(axis=-1).any(axis=1)
    assert 10 < taken.sum() < len(taken) / 2
    equal((old == new).all(axis=1), ~taken)


@pytest.mark.slow
def test_worlds_take_ranges_on_the_way(plain):
    """Every world its own, from its next episodes on, without a retrace."""
    n = 32
    worlds, counting = maax.Worlds(plain, n), plain.modules["counting"]
    states = worlds.reset(seeds.key(0))
    action = {"move": np.zeros((n, 2, 3), np.float32)}
    for _ in range(4):
        states = worlds.step(states, action)
    traces = counting.traces
    assert traces > 0
    for turn in (0, 1):
        wanted = (np.arange(n) + turn) % 4
        mass = 0.5 + 2.5 * ((np.arange(n) + turn) % 8) / 8
        pair = {"n_boxes": np.stack([wanted] * 2, axis=1), "box_mass": np.stack([mass] * 2, axis=1).astype(np.float32)}
        params = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, 2)), plain.default_params).replace(**pair)
        states = worlds.with_params(states, params)
        for _ in range(7):
            states = worlds.step(states, action)
        there = np.asarray(states.world.active["box"])
        equal(there.sum(axis=1), wanted)
        boxes = list(plain.overlay["body_mass"]).index
        columns = [boxes(i) for i in plain.modules["box"].body_ids]
        got = np.asarray(states.world.fields["body_mass"])[:, columns]
        close(got[there], (mass[:, None] * there)[there], rtol=1e-6)
    bad = params.replace(n_boxes=np.where(np.arange(n) == 20, 4, 3)[:, None] * [1, 1])
    with pytest.raises(ValueError, match=r"n_boxes.*4.*3"):
        worlds.with_params(states, bad)
    assert counting.traces == traces
