"""Every entity of OpenAI's worlds, drawn per world, against plain MuJoCo, formulas and brute-force geometry."""

from __future__ import annotations

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from helpers.chance import P_MIN
from helpers.plain_mujoco import in_plain_mujoco
from helpers.zoo import FEW, N, active, draw, few, field, make, uniform, wall_rects, zoo_env
from scipy import stats

import maax_mjx as maax

RADIUS, TOL = 0.15, 1e-4
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


def centres(env, state, name):
    """(N, n, 2), NaN where absent."""
    module = env.modules[name]
    if name in ("food", "construction_site"):
        xy = np.asarray(state.world.sites[module.kind])[..., :2]
    else:
        xy = np.asarray(state.data.qpos)[:, module.qpos_ids[:, :2]]
    return np.where(active(state, module.kind)[..., None], xy, np.nan)


def half_extents(env, state, name):
    """(N, n, 2) of a footprint, from the geoms (of construction sites, from their corners)."""
    module = env.modules[name]
    if name == "construction_site":
        return np.ptp(np.asarray(state.obs["construction_site_corner_pos"]), axis=2)[..., :2] / 2
    if name in ("box", "cylinder"):
        size = field(env, state, "geom_size", module.geom_ids)
        return size[..., :2] if name == "box" else size[..., [0, 0]]
    return {"agent": RADIUS, "ramp": 0.25, "food": 0.05}[name]


@pytest.fixture(scope="module")
def zoo():
    return zoo_env(), draw(zoo_env())


@pytest.fixture(scope="module")
def open_floor():
    """No outer walls; turned boxes that may tumble and share their draws."""
    env = make(
        2,
        maax.WallScenarios("empty", outer="none"),
        maax.FloorAttributes(friction=(0.0, 0.9)),
        maax.WorldConstants(gravity=(-20.0, -5.0)),
        maax.Agents(2, friction=(0.0, 0.9), damping=(5, 15), gear=(50, 150)),
        maax.Boxes(
            (0, 2),
            n_elongated_boxes=(0, 1),
            box_size=(0.3, 0.5),
            box_mass=(0.5, 3.0),
            box_friction=(0.1, 0.9),
            box_only_z_rot=False,
            per_object=False,
            random_yaw=True,
        ),
        maax.Ramps((0, 1), ramp_friction=(0.1, 0.9), free=True),
    )
    return env, draw(env, 1)


@pytest.fixture(params=["zoo", "open_floor"])
def drawn(request):
    return request.getfixturevalue(request.param)


def held(seed, n, n_agents):
    return seeds.rng(seed).choice([-1.0, 1.0], (n, n_agents, 3)).astype(np.float32)


# Against MuJoCo's own compiler and engine.


@pytest.mark.slow
def test_fields_are_those_that_mujoco_compiles(drawn):
    """Mass, inertia and inverse weights follow sizes and masses, as MuJoCo compiles the files of `to_mjcf`."""
    env, state = drawn
    names = {
        "body_mass",
        "body_inertia",
        "body_invweight0",
        "dof_invweight0",
        "geom_size",
        "geom_friction",
        "geom_rbound",
    }
    assert names | {"opt.gravity", "dof_damping", "actuator_gear", "geom_aabb"} <= set(env.overlay)
    wrong = {}
    for i in range(12):
        model = mujoco.MjModel.from_xml_string(maax.to_mjcf(env, state, world=i))
        gravity = env.model.opt.gravity.copy()
        gravity[env.overlay["opt.gravity"]] = state.world.fields["opt.gravity"][i]
        close(model.opt.gravity, gravity, rtol=1e-6)
        fields = [n for n in dir(model) if n.split("_")[0] in ("body", "dof", "jnt", "geom") or n == "actuator_gear"]
        for name in fields:
            got = getattr(env.model, name)
            if not isinstance(got, np.ndarray) or name == "dof_length":  # a scale that only sleeping bodies have
                continue
            if name in env.overlay:
                got = got.copy()
                got[env.overlay[name]] = state.world.fields[name][i]
            want = getattr(model, name)
            if name == "body_subtreemass":  # the world's own is used nowhere
                got, want = got[1:], want[1:]
            if not np.allclose(got, want, rtol=2e-5, atol=1e-6):
                wrong[name] = f"world {i}: {got[~np.isclose(got, want, rtol=2e-5, atol=1e-6)][:3]}"
    assert not wrong


@pytest.mark.slow
def test_the_c_engine_follows_plain_mujoco(drawn, batch_step):
    env, states = drawn
    states = few(states)
    worlds = [in_plain_mujoco(env, states, i) for i in range(16)]
    mask, touched = active(states, "agent"), 0
    for t in range(50):
        action = held(t // 20, FEW, env.agents.n_max)
        states = batch_step(env, states, {"move": action})
        for i, (model, data) in enumerate(worlds):
            data.ctrl[:] = (action[i] * mask[i][:, None]).ravel()
            mujoco.mj_step(model, data)
            touched += data.ncon
    assert touched > 50 * 16
    close(states.data.qpos[:16], [data.qpos for _, data in worlds], atol=1e-4)


def test_inertia_by_formula(zoo):
    env, state = zoo
    boxes, cylinders = env.modules["box"], env.modules["cylinder"]
    size, mass = 2 * field(env, state, "geom_size", boxes.geom_ids), field(env, state, "body_mass", boxes.body_ids)
    squares = size**2
    there = active(state, "box")
    inertia = mass[..., None] / 12 * (squares.sum(axis=-1, keepdims=True) - squares)
    close(field(env, state, "body_inertia", boxes.body_ids)[there], inertia[there], rtol=1e-4)
    there = active(state, "cylinder")
    r, h = field(env, state, "geom_size", cylinders.geom_ids)[there][:, :2].T
    close(field(env, state, "body_mass", cylinders.body_ids)[there], 1, rtol=1e-5)
    across = (3 * r**2 + (2 * h) ** 2) / 12
    want = np.stack([across, across, r**2 / 2], axis=-1)
    close(field(env, state, "body_inertia", cylinders.body_ids)[there], want, rtol=1e-4)


# What is drawn, and where.


def test_elongated_boxes_and_sites_by_openais_rule(zoo):
    env, state = zoo
    for name, kind, most in (("box", "box", 4), ("construction_site", "construction_site", 3)):
        there, half = active(state, kind), half_extents(env, state, name)
        base = 2 * field(env, state, "geom_size", env.modules["box"].geom_ids)[..., 2] if kind == "box" else 0.5
        along_x, along_y = ((np.abs(half[..., a] * 2 - 3.3 * base) < 1e-5) & there for a in (0, 1))
        long = along_x | along_y
        narrow = np.where(along_x, half[..., 1], half[..., 0]) * 2
        close(narrow[long], (0.3 * base * np.ones_like(narrow))[long], atol=1e-5)
        cube = there & ~long
        close((half * 2)[cube], ((base * np.ones_like(narrow))[..., None] * [1, 1])[cube], atol=1e-5)
        n, n_long, n_x = (m.sum(axis=1) for m in (there, long, along_x))
        for mask, count in ((there, n), (long, n_long), (along_x, n_x)):
            equal(mask, np.arange(mask.shape[1]) < count[:, None])
        observed, expected = np.zeros((2, most + 1, most + 1, most + 1))
        np.add.at(observed, (n, n_long, n_x), 1)
        for i in range(most + 1):
            for j in range(i + 1):
                expected[i, j, : j + 1] = N / (most + 1) / (i + 1) / (j + 1)
        assert not observed[expected == 0].any()
        assert stats.chisquare(observed[expected > 0], expected[expected > 0]).pvalue > P_MIN, name


def test_nothing_overlaps_and_all_is_on_its_floor(zoo):
    """Of every kind with every other: sites and food stand on nothing, and nothing stands on them."""
    env, state = zoo
    assert np.asarray(state.world.valid).all()
    names = ("agent", "box", "ramp", "cylinder", "food", "construction_site")
    centre = [centres(env, state, name) for name in names]
    half = [half_extents(env, state, name) * np.ones_like(c) for name, c in zip(names, centre, strict=True)]
    disc = np.concatenate(
        [np.full(c.shape[1], n in ("agent", "cylinder", "food")) for n, c in zip(names, centre, strict=True)]
    )
    centre, half = np.concatenate(centre, axis=1), np.concatenate(half, axis=1)
    floor = np.asarray(state.world.plan.floor_size)[:, None, None]
    assert np.nanmin(centre - half) > -TOL
    assert np.nanmin(floor - centre - half) > -TOL
    walls = wall_rects(env, state)
    centre = np.concatenate([centre, (walls[..., :2] + walls[..., 2:]) / 2], axis=1)
    half = np.concatenate([half, (walls[..., 2:] - walls[..., :2]) / 2], axis=1)
    disc = np.concatenate([disc, np.zeros(walls.shape[1], bool)])

    def clash(centre):
        # Of a disc, the square that holds it shrinks to a point, and its radius is taken off the distance.
        inner, radius = np.where(disc[:, None], 0, half), np.where(disc, half[..., 0], 0)
        gaps = np.abs(centre[:, :, None] - centre[:, None]) - inner[:, :, None] - inner[:, None]
        apart = np.where((gaps > 0).any(-1), np.linalg.norm(np.maximum(gaps, 0), axis=-1), gaps.max(axis=-1))
        apart = apart - radius[:, :, None] - radius[:, None]
        both_walls = np.arange(len(disc)) >= len(disc) - walls.shape[1]
        apart[:, both_walls[:, None] & both_walls] = np.nan
        return np.triu(apart < -TOL, 1).any((1, 2))

    assert not clash(centre).any()
    assert clash(np.concatenate([centre[:, :-9], np.roll(centre, 1, axis=0)[:, -9:]], axis=1)).mean() > 0.1


def test_floors_have_a_size_of_their_own(zoo):
    env, state = zoo
    floor = np.asarray(state.world.plan.floor_size)
    assert uniform(floor, 5, 7)
    assert env.floor_size == 7
    outer = wall_rects(env, state)[:, :4]
    there = ~np.isnan(outer[:, 0, 0])
    cell = floor[there] / 30
    # They stand in the cells at the edge, and reach a metre further out in the physics.
    close(outer[there].min(axis=(1, 2)), -1, atol=1e-5)
    close(outer[there].max(axis=(1, 2)), floor[there] + 1, atol=1e-5)
    close((outer[..., 2:] - outer[..., :2]).min(axis=-1)[there], np.repeat(1 + 0.75 * cell[:, None], 4, 1), atol=1e-5)
    close((outer[..., 2:] - outer[..., :2]).max(axis=-1)[there], np.repeat(floor[there, None] + 2, 4, 1), atol=1e-5)
    planned = np.asarray(state.world.plan.walls)[there, :4]
    close(planned.min(axis=(1, 2)), cell / 4, atol=1e-5)
    close(planned.max(axis=(1, 2)), floor[there] - cell / 4, atol=1e-5)


def test_observations(zoo, batch_step):
    env, states = zoo
    states = few(states)
    for _ in range(5):
        states = batch_step(env, states, {"move": held(5, FEW, 6)})
    obs, q, v = (
        {k: np.asarray(x) for k, x in states.obs.items()},
        *map(np.asarray, (states.data.qpos, states.data.qvel)),
    )

    def pose(name):
        module = env.modules[name]
        x, yaw = q[:, module.qpos_ids[:, :3]], q[:, module.qpos_ids[:, 3:]]
        return [x, np.cos(yaw), np.sin(yaw), v[:, module.qvel_ids]]

    size = 2 * field(env, states, "geom_size", env.modules["box"].geom_ids)
    ids = np.broadcast_to(np.arange(4)[:, None], (FEW, 4, 1))
    want = {"box_obs": [*pose("box"), ids, size], "ramp_obs": pose("ramp"), "agent_qpos_qvel": pose("agent")}
    for name, parts in want.items():
        mask = active(states, name.split("_")[0])
        equal(obs[f"{name.split('_')[0]}_mask"], mask)
        close(obs[name], np.where(mask[..., None], np.concatenate(parts, axis=-1), 0), atol=1e-5, err_msg=name)
    d, h = 2 * field(env, states, "geom_size", env.modules["cylinder"].geom_ids)[..., :2].transpose(2, 0, 1)
    mask = active(states, "cylinder")
    close(obs["cylinder_size"], np.where(mask[..., None], np.stack([d, d, h], axis=-1), 0), atol=1e-5)
    for kind, name in (("food", "food_pos"), ("construction_site", "construction_site_pos")):
        mask = active(states, kind)
        equal(obs[f"{kind}_mask"], mask)
        close(obs[name], np.where(mask[..., None], np.asarray(states.world.sites[kind]), 0), atol=1e-6)
    corners = obs["construction_site_corner_pos"]
    close(corners.mean(axis=2), obs["construction_site_pos"], atol=1e-5)
    close(corners[mask][..., 2], 0.25, atol=1e-6)
    signs = np.sign(corners - corners.mean(axis=2, keepdims=True))[mask][..., :2]
    assert (np.sort(signs @ [2, 1], axis=-1) == [-3, -1, 1, 3]).all()
    assert not corners[~mask].any()
    assert env.model.nsite == 0 or not mask.all()
    assert not any(word in env.model.geom(i).name for i in range(env.model.ngeom) for word in ("food", "site"))


def test_agents_by_team(zoo, batch_step):
    """Counts are uniform and independent; absent agents see nothing, go nowhere, and nothing comes of their actions."""
    env, states = zoo
    mask = active(states, "agent")
    n = mask.reshape(N, 2, 3).sum(axis=2)
    equal(mask.reshape(N, 2, 3), np.arange(3) < n[..., None])
    table = np.zeros((3, 3))
    np.add.at(table, (n[:, 0] - 1, n[:, 1] - 1), 1)
    assert stats.chisquare(table.ravel()).pvalue > P_MIN
    states = few(states)
    mask, ids, before = mask[:FEW], env.agents.qpos_ids, np.asarray(states.data.qpos)
    deaf = states
    for t in range(40):
        action = held(t // 20, FEW, 6)
        states = batch_step(env, states, {"move": action})
        deaf = batch_step(env, deaf, {"move": action * mask[..., None]})
    after = np.asarray(states.data.qpos)
    equal(after, deaf.data.qpos)
    close(after[:, ids][~mask], before[:, ids][~mask], atol=1e-6)
    assert (np.abs(after - before)[:, ids][mask][:, :2].max(axis=-1) > 0.1).mean() > 0.9
    for name in ("agent_qpos_qvel", "agent_pos", "agent_angle"):
        value = np.asarray(states.obs[name])
        assert not value[~mask].any()
        assert value[mask].any(axis=-1).all()
    assert not np.asarray(states.metrics["physics_fault"]).any()


# How it moves.


def towards(env, state, target, agents=slice(None)):
    """Full force of every agent towards (n, 2) points."""
    xy = np.asarray(state.data.qpos)[:, env.agents.qpos_ids[:, :2]]
    way = target[:, None] - xy
    move = np.zeros((*xy.shape[:2], 3), np.float32)
    move[..., :2] = way / np.abs(way).max(axis=-1, keepdims=True).clip(1e-6)
    return {"move": move}, np.linalg.norm(way, axis=-1)


def test_gear_over_damping_is_the_terminal_speed(open_floor, batch_step):
    """On a slippery, open floor; of the yaw likewise. That agents leave the floor is no fault."""
    env, _ = open_floor
    gear, damping = seeds.rng(0).uniform([50, 5], [150, 15], (N, 2)).astype(np.float32).T
    pair = {"agent_gear": np.stack([gear] * 2, axis=1), "agent_damping": np.stack([damping] * 2, axis=1)}
    states = few(draw(env, 2, n_boxes=0, n_ramps=0, agent_friction=0.0, floor_friction=0.0, **pair))
    move = np.zeros((FEW, 2, 3), np.float32)
    move[:, 0], move[:, 1] = (1, 0, 1), (0, -1, -0.5)
    for _ in range(300):
        states = batch_step(env, states, {"move": move})
    speed = np.asarray(states.data.qvel)[:, env.agents.qvel_ids]
    gear, damping = gear[:FEW], damping[:FEW]
    close(speed[:, 0, 0], gear / damping, rtol=0.01)
    close(speed[:, 1, 1], -gear / damping, rtol=0.01)
    close(speed[:, 0, 3], gear / damping, rtol=0.01)
    close(speed[:, 1, 3], -gear / damping / 2, rtol=0.01)
    xy = np.asarray(states.data.qpos)[:, env.agents.qpos_ids[:, :2]]
    assert (xy[:, 0, 0] > 6).mean() > 0.5
    assert (xy[:, 1, 1] < 0).mean() > 0.5
    assert not np.asarray(states.metrics["physics_fault"]).any()


def test_bodies_fall_by_the_gravity_of_their_world(drawn, batch_step):
    env, states = drawn
    states = few(states)
    gravity = np.asarray(states.world.fields["opt.gravity"])[:, 0]
    assert uniform(np.asarray(drawn[1].world.fields["opt.gravity"])[:, 0], -20, -5)
    q = np.array(states.data.qpos)
    for module in env.movables:
        q[:, module.qpos_ids[:, 2]] += 1
    states = states.replace(data=states.data.replace(qpos=jnp.asarray(q)))
    states = batch_step(env, states, {"move": np.zeros((FEW, env.agents.n_max, 3), np.float32)})
    for module in env.movables:
        there = active(states, module.kind)
        fell = np.asarray(states.data.qvel)[:, module.qvel_ids[:, 2]]
        close(fell[there], (gravity[:, None] * 0.005 * there)[there], rtol=0.01, err_msg=module.kind)
        close(fell[~there], 0, atol=1e-6)


def test_boxes_slide_by_the_larger_friction(open_floor, batch_step):
    """A sliding box stops after v^2 / (2 mu g), mu the larger of its own and the floor's."""
    env, _ = open_floor
    mu = seeds.rng(1).uniform(0.1, 0.8, (2, N)).astype(np.float32)
    one = {name: np.stack([x, x], axis=1) for name, x in zip(("floor_friction", "box_friction"), mu, strict=True)}
    states = few(draw(env, 3, n_boxes=1, n_elongated_boxes=0, n_ramps=0, gravity=-10.0, **one))
    box, speed = env.modules["box"], 1.2
    start = np.asarray(states.data.qpos)[:, box.qpos_ids[0, :2]]
    away = np.sign(start - np.asarray(states.data.qpos)[:, env.agents.qpos_ids[:, :2]].mean(axis=1))
    v = np.array(states.data.qvel)
    v[:, box.qvel_ids[0, 0]] = speed * away[:, 0]
    states = states.replace(data=states.data.replace(qvel=jnp.asarray(v)))
    for _ in range(260):
        states = batch_step(env, states, {"move": np.zeros((FEW, 2, 3), np.float32)})
    slid = np.abs(np.asarray(states.data.qpos)[:, box.qpos_ids[0, 0]] - start[:, 0])
    want = speed**2 / (2 * 10 * mu.max(axis=0)[:FEW])
    assert np.median(np.abs(slid - want) / want) < 0.1
    assert stats.spearmanr(slid, want).statistic > 0.9


def test_draws_are_shared_where_asked(drawn):
    env, state = drawn
    shared = {"box": "geom_size"} if "food" not in env.modules else {"cylinder": "geom_size"}
    single = {"box": ("body_mass", "geom_size"), "agent": ("actuator_gear", "dof_damping", "geom_friction")}
    for name, what in shared.items():
        value = field(env, state, what, env.modules[name].geom_ids)
        both = active(state, env.modules[name].kind).all(axis=1)
        height = value[..., 2 if name == "box" else 1][both]
        close(height[:, 0], height[:, 1])
        assert uniform(height[:, 0] * 2, *((0.3, 0.5) if name == "box" else (0.2, 0.6)))
    if "food" in env.modules:
        agents, boxes = env.agents, env.modules["box"]
        rows = {
            "actuator_gear": agents.ctrl_ids.reshape(6, 3)[:, 0],
            "dof_damping": agents.qvel_ids[:, 0],
            "geom_friction": agents.geom_ids,
            "body_mass": boxes.body_ids,
            "geom_size": boxes.geom_ids,
        }
        for name in (*single["box"], *single["agent"]):
            value = field(env, state, name, rows[name])
            value = value.reshape(N, value.shape[1], -1)[..., -1 if name == "geom_size" else 0]
            both = active(state, "box")[:, 1] if name in single["box"] else slice(None)
            rank = stats.spearmanr(value[both, 0], value[both, 1]).statistic
            assert abs(rank) < 5.5 / np.sqrt(len(value[both])), name


def test_cylinders_can_be_pushed(zoo, batch_step):
    env, _ = zoo
    states = few(draw(env, 4, n_cylinders=1, n_boxes=0, n_ramps=0, n_rooms=1))
    ids = env.modules["cylinder"].qpos_ids[0, :2]
    start = np.asarray(states.data.qpos)[:, ids]
    for _ in range(100):
        states = batch_step(env, states, towards(env, states, np.asarray(states.data.qpos)[:, ids])[0])
    assert (np.linalg.norm(np.asarray(states.data.qpos)[:, ids] - start, axis=-1) > 0.1).mean() > 0.5


@pytest.mark.slow
def test_static_cylinders_stand_fast(batch_step):
    """Agents at full force come up to them, and no further.

    An agent meets them at 9 m/s, of which one step is 45 mm, and another may push from behind.
    """
    cylinders = maax.StaticCylinders((1, 2), (0.3, 0.9), (0.2, 0.6), friction=(0.2, 1.0))
    env = make(2, maax.WallScenarios("empty"), maax.Agents(2), cylinders)
    drawn = draw(env, 7)
    assert "cylinder_obs" not in drawn.obs
    states, ids = few(draw(env, 7, static_cylinder_height=0.6)), env.modules["static_cylinder"].geom_ids
    start = np.asarray(states.data.geom_xpos)[:, ids]
    there = active(states, "static_cylinder")
    equal(states.obs["static_cylinder_mask"], there)
    close(states.obs["static_cylinder_pos"], np.where(there[..., None], start, 0))
    radius, half = field(env, states, "geom_size", ids)[..., :2].transpose(2, 0, 1)
    assert uniform(2 * field(env, drawn, "geom_size", ids)[:, 0, 0], 0.3, 0.9)
    close(start[there][:, 2], half[there], atol=1e-6)
    agents = np.asarray(drawn.data.qpos)[:, env.agents.qpos_ids[:, :2]]
    middle = np.asarray(drawn.data.geom_xpos)[:, ids, :2]
    apart = np.linalg.norm(agents[:, :, None] - middle[:, None], axis=-1)
    room = apart - RADIUS - field(env, drawn, "geom_size", ids)[:, None, :, 0]
    assert room[np.broadcast_to(active(drawn, "static_cylinder")[:, None], room.shape)].min() > -TOL
    nearest = np.full(FEW, np.inf)
    for _ in range(200):
        action, away = towards(env, states, start[:, 0, :2])
        states = batch_step(env, states, action)
        nearest = np.minimum(nearest, away.min(axis=1) - RADIUS - radius[:, 0])
    at_rest = away.min(axis=1) - RADIUS - radius[:, 0]
    assert nearest.min() > -RADIUS, "the centre of an agent is inside"
    assert np.quantile(nearest, 0.1) > -0.1, "at impact"
    assert np.quantile(at_rest, 0.1) > -0.02
    assert np.quantile(nearest, 0.9) < 0.05, "another cylinder stands in the way of the rest"
    equal(np.asarray(states.data.geom_xpos)[:, ids], start)
    assert not np.asarray(states.metrics["physics_fault"]).any()


@pytest.fixture(scope="module")
def limited():
    def make_limited(n_frames):
        return make(
            3,
            maax.WallScenarios("half", outer="limits"),
            maax.Agents(3),
            maax.Boxes((0, 2), box_size=(0.3, 0.5), n_elongated_boxes=(0, 1), polar_obs=False),
            maax.Ramps(1),
            floor_size=(3.5, 6.0),
            n_frames=n_frames,
        )

    envs = {n: make_limited(n) for n in (1, 5)}
    return envs, few(draw(envs[1], 26))


@pytest.mark.slow
@pytest.mark.parametrize("n_frames", [1, 5])
def test_limits_hold_what_outer_walls_would(n_frames, limited, batch_step):
    envs, states = limited
    env = envs[n_frames]
    names = [env.model.geom(i).name for i in range(env.model.ngeom)]
    standing = ~np.isnan(wall_rects(env, states)[..., 0])
    assert standing.sum(axis=1).max() <= 2 == sum(name.startswith("wall") for name in names)
    floor = np.asarray(states.world.plan.floor_size)[:, None]

    def outside(states):
        """(n,) how far discs and centres are beyond the edge."""
        q, out = np.asarray(states.data.qpos), {}
        for module in env.movables:
            xy = q[:, module.qpos_ids[:, :2]]
            beyond = np.maximum(-xy, xy - floor[..., None]).max(axis=-1)
            out[module.kind] = np.where(active(states, module.kind), beyond, -np.inf).max(axis=1)
        return out

    # Half of the least that an agent, an elongated box of 0.3 m and a ramp measure.
    for kind, half in (("agent", RADIUS), ("box", 0.3 * 0.3 / 2), ("ramp", 0.25)):
        assert outside(states)[kind].max() < -half + TOL
    worst, faults = np.full(FEW, -np.inf), np.zeros(FEW, bool)
    for t in range(300 // n_frames):
        if t * n_frames % 60 == 0:
            action = {"move": held(t, FEW, 3)}
        states = batch_step(env, states, action)
        out = outside(states)
        assert max(x.max() for x in out.values()) < 0, f"a centre left the floor at step {t}"
        worst = np.maximum(worst, out["agent"] + RADIUS)
        faults |= np.asarray(states.metrics["physics_fault"])
    assert not faults.any()
    # Into an edge at 9 m/s, of which one step is 45 mm.
    assert worst.max() > 0.02
    assert np.quantile(worst, 0.9) < 0.06
    assert worst.max() < 0.1
    rest = {"move": np.tile(np.float32([1, 1, 0]), (FEW, 3, 1))}
    for _ in range(200 // n_frames):
        states = batch_step(env, states, rest)
    at_rest = outside(states)["agent"] + RADIUS
    assert np.quantile(at_rest, 0.9) < 0.01, "further where one is pressed by others"
    assert at_rest.max() < 0.1
    assert (at_rest > -0.02).mean() > 0.9, "they press against the edge"


def test_limits_refuse_free_joints():
    def limits(module):
        return make(1, maax.WallScenarios("empty", outer="limits"), maax.Agents(1), module)

    for module in (maax.Boxes(1, free=True), maax.Ramps(1, free=True), maax.Boxes(1, box_only_z_rot=False)):
        with pytest.raises(ValueError, match=r"(?s)limits.*free|free.*limits"):
            limits(module).reset(seeds.key(0))


def test_cylinders_beside_boxes_are_refused_by_jax():
    def build():
        env = maax.Base(1, impl="jax")
        for module in (maax.Agents(1), maax.Cylinders(1), maax.Boxes(1)):
            env.add_module(module)
        env.reset(seeds.key(0))

    with pytest.raises(ValueError, match=r"(?i)cylinder.*box|box.*cylinder"):
        build()
