"""Egocentric observations: a whole world that is turned and shifted looks as before."""

import functools

import jax
import numpy as np
import pytest
from helpers.seeds import key, rng

import maax_mjx as maax
from maax_mjx.wrappers.ego import ABSOLUTE, CLIP

N = 64
GAMES = {
    "hide_and_seek": {},
    "hide_and_seek_quadrant": {},
    "hide_and_seek_full": {"n_hiders": (1, 2)},
    "tag": {},
    "capture_the_flag": {},
}


@functools.cache
def ego(name):
    return maax.make(name, impl="c", observations="ego", **GAMES[name])


def multiply(p, q):
    """Products of quaternions w, x, y, z."""
    w, x, y, z = np.moveaxis(p, -1, 0)
    a, b, c, d = np.moveaxis(q, -1, 0)
    return np.stack([w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
                     w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a], axis=-1)  # fmt: skip


def moved(env, state, angle, shift):
    """Worlds (host arrays) turned about the origin by an angle and shifted by (2,) metres, with all that is in them."""
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin], [sin, cos]])
    whole = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    quat = np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])

    def place(xy, there=True):
        return np.where(np.asarray(there)[..., None], xy @ turn.T + shift, xy)

    data, world, base = state.data, state.world, env.base
    qpos, qvel = np.array(data.qpos), np.array(data.qvel)
    for module in base.movables:
        q, v = module.qpos_ids, module.qvel_ids
        qpos[:, q[:, :2]] = place(qpos[:, q[:, :2]])
        qvel[:, v[:, :2]] = qvel[:, v[:, :2]] @ turn.T
        if module.free:
            qpos[:, q[:, 3:]] = multiply(quat, qpos[:, q[:, 3:]])
        else:
            qpos[:, q[:, 3]] += angle

    def points(x):
        x = np.array(x)
        x[..., :2] = place(x[..., :2])
        return x

    doors = np.array(world.plan.doors)
    doors[..., :2] = place(doors[..., :2], world.plan.door_mask)
    sites = {kind: np.where(world.active[kind][..., None], points(x), x) for kind, x in world.sites.items()}
    mats = np.einsum("ij,...jk->...ik", whole, np.asarray(data.geom_xmat))
    data = data.replace(qpos=qpos, qvel=qvel, xpos=points(data.xpos), geom_xpos=points(data.geom_xpos),
                        geom_xmat=mats, xquat=multiply(quat, np.asarray(data.xquat)))  # fmt: skip
    world = world.replace(plan=world.plan.replace(doors=doors), sites=sites)
    floats = jax.tree.map(
        lambda x: np.asarray(x, np.float32) if np.asarray(x).dtype == np.float64 else x, (data, world)
    )
    return state.replace(data=floats[0], world=floats[1])


@functools.cache
def observed(env):
    """A compiled function from states to what would be observed of them, without a step."""

    def observe(state):
        state = state.replace(obs=env.base.module_observations(state.world, state.data))
        for layer in reversed(env.layers):
            again = getattr(layer, "observe", None) or getattr(layer, "_observe", None)
            state = state if again is None else again(state)
        return state.obs

    return jax.jit(jax.vmap(observe))


@functools.cache
def states(name):
    """Worlds at rest, given velocities."""
    env = ego(name)
    state = jax.device_get(jax.jit(jax.vmap(env.reset))(jax.random.split(key(0), N)))
    qvel = 2 * rng(1).standard_normal(state.data.qvel.shape).astype(np.float32)
    qpos = np.array(state.data.qpos)
    agents = env.base.agents
    qpos[:, agents.qpos_ids[:, 3]] = rng(2).uniform(-7, 7, (N, env.n_agents))
    data = state.data.replace(qvel=qvel, qpos=qpos)
    return state.replace(data=jax.device_get(jax.jit(jax.vmap(env.base.engine.pose))(state.world.fields, data)))


@pytest.mark.slow
@pytest.mark.parametrize("name", GAMES)
def test_turning_and_shifting_a_world_changes_only_absolute_columns(name):
    env, observe = ego(name), observed(ego(name))
    before = observe(states(name))
    for angle, shift in [(0.7, (0.0, 0.0)), (0.0, (1.5, -0.8)), (-2.4, (-3.0, 2.0))]:
        after = observe(moved(env, states(name), angle, np.array(shift)))
        compared = 0
        for key_, one in env.observed.items():
            a, b = np.asarray(before[key_], float), np.asarray(after[key_], float)
            if key_ == "lidar" or key_.startswith("sees_"):
                # A ray that meets an edge, or the wall beside it: seldom, by the last bit of a float.
                assert (np.abs(a - b) > 1e-5).mean() <= 0.01, key_
                continue
            if not one.columns:
                np.testing.assert_array_equal(a, b, err_msg=key_)
                continue
            for i, column in enumerate(one.names()):
                if column not in ABSOLUTE:
                    np.testing.assert_allclose(a[..., i], b[..., i], atol=1e-5, err_msg=f"{key_}: {column}")
                    compared += 1
        assert compared >= 20


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hide_and_seek_quadrant"])
def test_published_observations_do_change(name):
    """The test above would not pass with the frames of the published game."""
    env = maax.make(name, impl="c", observations="split")
    observe = observed(env)
    before, after = observe(states(name)), observe(moved(env, states(name), 0.7, np.array([1.5, 0.0])))
    for key_ in ("agent_qpos_qvel", "box_obs", "ramp_obs", "door_obs"):
        assert np.abs(np.asarray(before[key_]) - np.asarray(after[key_])).max() > 0.1


def test_what_is_ahead_is_ahead():
    """By hand: an agent at (1, 1) that looks along +y, a box 2 m ahead of it and 0.5 m to its right, moving away."""
    env = maax.make("hide_and_seek", impl="c", observations="ego", scenario="empty", n_hiders=1, n_seekers=1,
                    n_ramps=0, lock=None)  # fmt: skip
    state = env.reset(key(0))
    agents, boxes = env.base.agents, env.base.modules["box"]
    qpos, qvel = np.array(state.data.qpos), np.array(state.data.qvel)
    qpos[agents.qpos_ids[0]] = [1.0, 1.0, 0.15, np.pi]
    qpos[boxes.qpos_ids[0]] = [1.5, 3.0, 0.25, np.pi / 2]
    qvel[agents.qvel_ids[0, 1]], qvel[boxes.qvel_ids[0, 1]] = 0.6, 1.5
    state = state.replace(data=state.data.replace(qpos=qpos, qvel=qvel))
    one = jax.tree.map(lambda x: x[None], jax.device_get(state))
    obs = {name: np.asarray(x[0]) for name, x in observed(env)(one).items()}
    box = dict(zip(env.observed["box_obs"].names(), obs["box_obs"][0, 0], strict=True))
    own = dict(zip(env.observed["agent_qpos_qvel_self"].names(), obs["agent_qpos_qvel_self"][0], strict=True))
    close = functools.partial(pytest.approx, abs=1e-5)
    assert (box["ahead"], box["to the left"]) == (close(2 / 3), close(-0.5 / 3))
    assert box["distance"] == close(np.hypot(2, 0.5) / 3)
    assert (box["v ahead"], box["v to the left"]) == (close(0.9 / 3), close(0))
    assert (box["cos turn"], box["sin turn"]) == (close(1), close(0))
    assert (own["floor x"], own["floor y"]) == (close(1 / 6), close(1 / 6))
    assert (own["cos heading"], own["sin heading"]) == (close(0), close(1))
    assert (own["v ahead"], own["v to the left"]) == (close(0.2), close(0))
    assert obs["time_left"][0, 0] == 1


@pytest.mark.slow
def test_absent_ones_are_zero_and_numbers_are_cut_off():
    env, state = ego("hide_and_seek_full"), states("hide_and_seek_full")
    fast = state.replace(data=state.data.replace(qvel=state.data.qvel * 100))
    obs = jax.device_get(observed(env)(fast))
    assert np.abs(obs["agent_qpos_qvel"]).max() == CLIP
    for key_, mask in (("box_obs", "box_mask"), ("agent_qpos_qvel", "agent_mask"), ("door_obs", "door_mask")):
        assert (~obs[mask]).any(), "nothing is absent: the test would say nothing"
        assert not obs[key_][~obs[mask]].any()
    absent = ~obs["agent_mask_self"]
    assert absent.any()
    assert not obs["agent_qpos_qvel_self"][absent].any()


def test_lidar_in_the_worlds_frame_is_refused():
    with pytest.raises(ValueError, match="Lidar got frame='world'"):
        maax.make("hide_and_seek_quadrant", impl="c", observations="ego", **{"lidar.frame": "world"})


def test_observations_that_are_not_split_are_refused():
    with pytest.raises(ValueError, match="EgocentricObservations: needs SplitObservations"):
        maax.EgocentricObservations(maax.make("hide_and_seek", impl="c", observations="raw"))
