"""Lidar and line of sight against `mujoco.mj_ray` on exported worlds."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax

pytestmark = pytest.mark.slow

N_WORLDS, N_RAYS = 24, 30


@pytest.fixture(scope="module")
def env():
    """Random rooms with all that can be hit: turned boxes of all shapes, ramps, cylinders, a pillar, agents."""
    env = maax.Base(5, impl="c")
    env.add_module(maax.RandomWalls((1, 4), prob_outside_walls=0.5))
    env.add_module(maax.Agents({"hiders": (1, 3), "seekers": (1, 2)}, random_yaw=True))
    env.add_module(maax.Boxes((1, 5), n_elongated_boxes=(0, 3), box_size=(0.3, 0.5), random_yaw=True))
    env.add_module(maax.Ramps((0, 2), random_yaw=True))
    env.add_module(maax.Cylinders((0, 2), (0.3, 0.6), (0.2, 0.6)))
    env.add_module(maax.Food((1, 8)))
    return maax.Lidar(maax.LineOfSight(env, objects=["box", "ramp", "food", "cylinder"]), N_RAYS, range=100.0)


@pytest.fixture(scope="module")
def worlds(env):
    """Worlds on the way, with agents against walls and boxes: the states, and every one's model and data."""
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(0), N_WORLDS))
    step = jax.jit(jax.vmap(env.step))
    for t in range(30):
        move = seeds.rng(t // 10).choice([-1.0, 1.0], (N_WORLDS, 5, 3)).astype(np.float32)
        states = step(states, {"move": move * [1, 1, 0.1]})
    plain = []
    for i in range(N_WORLDS):
        model = mujoco.MjModel.from_xml_string(maax.to_mjcf(env, states, i))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_kinematics(model, data)
        plain.append((model, data))
    return jax.device_get(states.replace(key=())), plain


def cast(model, data, origin, direction, body):
    geom = np.full(1, -1, np.int32)
    distance = mujoco.mj_ray(model, data, origin, direction, None, 1, body, geom)
    return (np.inf, -1) if distance < 0 else (distance, int(geom[0]))


def test_lidar_is_mj_ray(env, worlds):
    """Equal to 1 mm for 99.9 % of rays; what is left grazes an edge."""
    states, plain = worlds
    errors, hits = [], set()
    for i, (model, data) in enumerate(plain):
        for agent in np.flatnonzero(states.world.active["agent"][i]):
            body = int(env.base.agents.body_ids[agent])
            for ray in range(N_RAYS):
                angle = 2 * np.pi * ray / N_RAYS
                direction = np.array([np.cos(angle), np.sin(angle), 0.0])
                distance, geom = cast(model, data, data.xpos[body], direction, body)
                errors.append(abs(min(distance, 100.0) - states.obs["lidar"][i, agent, ray, 0]))
                hits.add(int(model.geom_type[geom]) if geom >= 0 else -1)
        assert not states.obs["lidar"][i][~states.world.active["agent"][i]].any()
    assert len(errors) > 1000
    assert hits == {-1, *(int(getattr(mujoco.mjtGeom, f"mjGEOM_{n}")) for n in ("BOX", "SPHERE", "CYLINDER", "MESH"))}
    assert (np.array(errors) < 1e-3).mean() > 0.999


def test_line_of_sight_is_the_cone_and_mj_ray(env, worlds):
    states, plain = worlds
    agents, agreed, seen, hidden = env.base.agents, 0, 0, 0
    total = 0
    for i, (model, data) in enumerate(plain):
        for module in (agents, *(env.base.modules[n] for n in ("box", "ramp", "cylinder"))):
            mask = states.obs[f"sees_{module.name}"][i]
            for a in range(5):
                eye = data.xpos[agents.body_ids[a]]
                heading = states.data.qpos[i, agents.qpos_ids[a, 3]] - np.pi / 2
                for j, body in enumerate(module.body_ids):
                    there = states.world.active["agent"][i, a] and states.world.active[module.kind][i, j]
                    if module is agents and a == j:
                        assert mask[a, j] == there
                        continue
                    to = data.xpos[body] - eye
                    turn = (np.arctan2(to[1], to[0]) - heading + np.pi) % (2 * np.pi) - np.pi
                    _, geom = cast(model, data, eye, to / np.linalg.norm(to), int(agents.body_ids[a]))
                    want = there and abs(turn) <= 3 * np.pi / 8 and geom >= 0 and model.geom_bodyid[geom] == body
                    total, agreed = total + 1, agreed + (want == mask[a, j])
                    seen, hidden = seen + want, hidden + (there and abs(turn) <= 3 * np.pi / 8 and not want)
    assert agreed / total > 0.999
    assert seen > 50
    assert hidden > 50


def test_food_is_seen_where_the_cone_and_mj_ray_get_to_it(env, worlds):
    """A mark on the floor stops no ray: what is met before it, or nothing."""
    states, plain = worlds
    agents, mask = env.base.agents, states.obs["sees_food"]
    assert mask.shape == (N_WORLDS, 5, 8)
    agreed, seen, hidden, total = 0, 0, 0, 0
    for i, (model, data) in enumerate(plain):
        there = states.world.active["food"][i]
        assert not mask[i][:, ~there].any()
        for a in range(5):
            playing, eye = states.world.active["agent"][i, a], data.xpos[agents.body_ids[a]]
            heading = states.data.qpos[i, agents.qpos_ids[a, 3]] - np.pi / 2
            for j in np.flatnonzero(there):
                to = states.world.sites["food"][i, j] - eye
                away = np.linalg.norm(to)
                turn = (np.arctan2(to[1], to[0]) - heading + np.pi) % (2 * np.pi) - np.pi
                met, _ = cast(model, data, eye, to / away, int(agents.body_ids[a]))
                ahead = playing and abs(turn) <= 3 * np.pi / 8
                total, agreed = total + 1, agreed + ((ahead and met >= away) == mask[i, a, j])
                seen, hidden = seen + (ahead and met >= away), hidden + (ahead and met < away)
    assert agreed >= total - 1
    assert seen > 5
    assert hidden > 5


def test_frames_ranges_and_compression():
    env = maax.Base(1, impl="c")
    env.add_module(maax.WallScenarios("empty"))
    env.add_module(maax.Agents(1, maax.centre_placement))
    state = jax.jit(env.reset)(seeds.key(0))
    agents = env.agents
    qpos = state.data.qpos.at[agents.qpos_ids[0]].set(jnp.array([2.0, 3.0, 0.15, 0.3]))
    state = state.replace(data=jax.jit(env.engine.pose)(state.world.fields, state.data.replace(qpos=qpos)))

    def lidar(n, **options):
        return jax.jit(maax.Lidar(env, n, **options).observation)(state)["lidar"][0, :, 0]

    world = lidar(4, range=3.5)
    np.testing.assert_allclose(world, [3.5, 2.85, 1.85, 2.85], atol=1e-5)  # walls' faces are at 0.15 and 5.85
    ahead = 0.3 - np.pi / 2
    own = lidar(1, range=9, frame="agent")
    np.testing.assert_allclose(own[0], 2.85 / -np.sin(ahead), atol=1e-4)
    small = lidar(4, range=3.5, compress=2.0)
    np.testing.assert_allclose(small, 2 * np.tanh(np.asarray(world) / 2), atol=1e-6)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda e: maax.Lidar(e, 0), "n_rays: got 0"),
        (lambda e: maax.Lidar(e, frame="body"), "frame: got 'body'; takes one of"),
        (lambda e: maax.Lidar(e, range=-1), "range: got -1"),
        (lambda e: maax.Lidar(e, compress=0), "compress: got 0"),
        (lambda e: maax.LineOfSight(e, cone=7), "cone: got 7; takes an angle in radians"),
        (lambda e: maax.LineOfSight(e, objects=["boxs"]), "objects: got 'boxs'; did you mean 'box'"),
        (lambda e: maax.LineOfSight(e, objects=["food"]), "objects: got 'food'; takes one of ['box', 'ramp']"),
        (lambda e: maax.LineOfSight(e, objects=["walls"]), "objects: got 'walls'; takes one of ['box', 'ramp']"),
    ],
)
def test_mistakes(call, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call(maax.make("standard"))
    assert message in str(error.value)


def test_mechanics_are_about_the_boxes_and_ramps_that_there_are():
    env = maax.Base(2)
    env.add_module(maax.Agents(2))
    env.add_module(maax.Boxes(1))
    env = maax.GrabObjects(maax.LockObjects(maax.TeamMembership(maax.LineOfSight(env), [0, 1])))
    assert env.inner(maax.LineOfSight).senses == ("sees_agent", "sees_box")
    assert (env.n_grabbable, env.inner(maax.LockObjects).n_lockable) == (1, 1)
    empty = maax.Base(2)
    empty.add_module(maax.Agents(2))
    assert maax.LineOfSight(empty).senses == ("sees_agent",)
    with pytest.raises(ValueError, match=r"objects: got \[\], which hold no objects; .* leave GrabObjects out"):
        maax.GrabObjects(empty)
