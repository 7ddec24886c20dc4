"""Cones of sight between corners, and rays without a cap, against NumPy and `mujoco.mj_ray` on exported worlds."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax

N, N_CAST, HALF_CONE, RANGE = 1_000, 60, 3 * np.pi / 8, 3.0
FULL = {
    "scenario": "random", "n_rooms": (1, 4), "prob_outside_walls": 0.5, "n_boxes": (3, 9), "n_elongated_boxes": (3, 9),
    "n_ramps": 2, "hider_placement": "uniform", "seeker_placement": "uniform",
}  # fmt: skip
KINDS = ("agent", "box", "ramp")


@cache
def worlds():
    """Worlds like those of the full game, everything turned at random, into others too: the environment, and states."""
    env = maax.make("standard", impl="c", **FULL)

    @jax.jit
    @jax.vmap
    def turned(key, yaws):
        state, ids = env.reset(key), np.concatenate([env.modules[kind].qpos_ids[:, 3] for kind in KINDS])
        data = state.data.replace(qpos=state.data.qpos.at[ids].set(yaws))
        return state.replace(data=env.engine.pose(state.world.fields, data))

    return env, turned(jax.random.split(seeds.key(0), N), seeds.rng(0).uniform(-np.pi, np.pi, (N, 15)))


@cache
def plain():
    """Some of the worlds in MuJoCo: models and data."""
    env, states = worlds()
    out = []
    for i in range(N_CAST):
        model = mujoco.MjModel.from_xml_string(maax.to_mjcf(env, states, i))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_kinematics(model, data)
        out.append((model, data))
    return out


@cache
def sees(between):
    """What agents see: (worlds, agents, things) bool by kind."""
    env, states = worlds()
    sight = maax.LineOfSight(env, between=between)
    masks = jax.jit(jax.vmap(lambda state: sight.observe(state).obs))(states)
    return {kind: np.asarray(masks[f"sees_{kind}"]) for kind in KINDS}


def things(model, data, kind):
    """(n, 3) each: where the bodies of a kind are, where their geoms are, and half their extents while unturned."""
    names = [model.body(i).name for i in range(model.nbody)]
    geoms = [model.geom(name).id for name in names if name.removeprefix(kind).isdigit()]
    half = {"agent": np.full(3, 0.15), "ramp": np.full(3, 0.25)}.get(kind, model.geom_size[geoms])
    return data.xpos[model.geom_bodyid[geoms]], data.geom_xpos[geoms], np.broadcast_to(half, (len(geoms), 3)), geoms


def in_cone(eyes, yaw, places):
    """(n, m) bool: the angle between an agent's heading and the way to a place, by its cosine."""
    heading = np.stack([np.sin(yaw), -np.cos(yaw)], axis=-1)
    way = places[..., None, :, :2] - eyes[..., :, None, :2]
    cosine = (way * heading[..., :, None, :]).sum(axis=-1) / np.maximum(np.linalg.norm(way, axis=-1), 1e-9)
    return np.arccos(np.clip(cosine, -1, 1)) <= HALF_CONE


@pytest.mark.slow
@pytest.mark.parametrize("between", ["corners", "centres"])
def test_what_is_seen_is_in_the_cone_and_met_first(between):
    """Cones between lower corners; rays from the agent's middle to the middle of a geom."""
    env, states = worlds()
    seen = sees(between)
    total = wrong = hidden = 0
    yaws = np.asarray(states.data.qpos)[:, env.agents.qpos_ids[:, 3]]
    for w, (model, data) in enumerate(plain()):
        eyes, _, half_agent, _ = things(model, data, "agent")
        for kind in KINDS:
            places, middles, half, geoms = things(model, data, kind)
            there = np.asarray(states.world.active[kind])[w]
            if between == "corners":
                ahead = in_cone(eyes - half_agent, yaws[w], places - half)
            else:
                ahead, middles = in_cone(eyes, yaws[w], places), places
            for a, b in np.ndindex(ahead.shape):
                if kind == "agent" and a == b:
                    assert seen[kind][w, a, b]
                    continue
                way, body = middles[b] - eyes[a], model.geom_bodyid[model.geom(f"agent{a}").id]
                met = np.full(1, -1, np.int32)
                mujoco.mj_ray(model, data, eyes[a], way / np.linalg.norm(way), None, 1, body, met)
                free = met[0] >= 0 and model.geom_bodyid[met[0]] == model.geom_bodyid[geoms[b]]
                total, wrong = total + 1, wrong + (seen[kind][w, a, b] != (there[b] and ahead[a, b] and free))
                hidden += there[b] and ahead[a, b] and not free
    assert total > 3_000
    assert hidden > 300
    assert wrong <= 1, "where a ray grazes an edge"


def test_between_corners_rays_go_to_the_middle_of_a_ramp_s_wedge():
    """8 cm beside the middle of its box: past the edge of a box half-way that hides that one."""
    env = maax.Base(1, impl="c")
    for module in (maax.Agents(1), maax.Boxes(1), maax.Ramps(1)):
        env.add_module(module)
    state = jax.jit(env.reset)(seeds.key(0))
    ids = np.concatenate([env.modules[kind].qpos_ids[0] for kind in KINDS])
    places = [1.0, 3.0, 0.15, np.pi / 2, 2.5, 3.23, 0.25, 0.0, 4.0, 3.0, 0.25, 0.0]
    data = state.data.replace(qpos=state.data.qpos.at[ids].set(jnp.array(places)))
    state = state.replace(data=jax.jit(env.engine.pose)(state.world.fields, data))
    for between in ("corners", "centres"):
        seen = jax.jit(maax.LineOfSight(env, between=between).observe)(state).obs
        assert seen["sees_box"].all()
        assert seen["sees_ramp"].all() == (between == "corners")


@pytest.mark.slow
def test_cones_between_corners_differ_for_as_many_pairs_as_measured():
    """For 6.8 % of pairs of an agent and a long box, 19.8 % within 1.2 m; 1.2 and 4.0 % of cubes, 1.4 % of ramps."""
    env, states = worlds()
    qpos, world = np.asarray(states.data.qpos), jax.device_get(states.world)
    agents, near = qpos[:, env.agents.qpos_ids], {}
    shares = {}
    for kind, kept in (("box", "long"), ("box", "cube"), ("ramp", "ramp")):
        places = qpos[:, env.modules[kind].qpos_ids[:, :3]]
        half = world.extents["box"] / 2 if kind == "box" else np.full((N, 2, 3), 0.25)
        pairs = world.active[kind] & (kept == "ramp" or (half.max(axis=-1) > 0.5) == (kept == "long"))
        between = in_cone(agents[..., :3] - 0.15, agents[..., 3], places - half)
        differ = between != in_cone(agents[..., :3], agents[..., 3], places)
        pairs = np.broadcast_to(pairs[:, None], differ.shape)
        close = pairs & (np.linalg.norm(places[:, None] - agents[:, :, None, :3], axis=-1) < 1.2)
        shares[kept], near[kept] = differ[pairs].mean(), differ[close].mean()
        if kept != "ramp":  # whose rays differ as well
            seen = sees("corners")[kind] != sees("centres")[kind]
            assert not seen[~differ].any()
            assert 0.1 < seen[differ & pairs].mean() < 0.9, "of those that a ray gets to"
    assert shares["long"] == pytest.approx(0.068, abs=0.014)
    assert near["long"] == pytest.approx(0.198, abs=0.05)
    assert shares["cube"] == pytest.approx(0.012, abs=0.008)
    assert near["cube"] == pytest.approx(0.040, abs=0.03)
    assert shares["ramp"] == pytest.approx(0.014, abs=0.01)


# --- lidar -----------------------------------------------------------------------------------------------------


@cache
def lidar(capped):
    env, states = worlds()
    rays = maax.Lidar(env, 30, RANGE, capped=capped)
    some = jax.tree.map(lambda x: x[:N_CAST], states.replace(key=()))
    return np.asarray(jax.jit(jax.vmap(lambda state: rays.observation(state)["lidar"]))(some))[..., 0]


@pytest.mark.slow
def test_rays_without_a_cap_read_how_far_what_they_meet_is():
    """Further than their range, too; the range where they meet nothing."""
    env, _ = worlds()
    want = np.empty((N_CAST, 4, 30))
    for w, (model, data) in enumerate(plain()):
        for a, ray in np.ndindex(4, 30):
            angle, body = 2 * np.pi * ray / 30, env.agents.body_ids[a]
            ahead = np.array([np.cos(angle), np.sin(angle), 0.0])
            far = mujoco.mj_ray(model, data, data.xpos[body], ahead, None, 1, body, np.zeros(1, np.int32))
            want[w, a, ray] = far if far >= 0 else RANGE
    assert (want > RANGE).sum() > 100
    assert (want == RANGE).sum() > 100
    assert (np.abs(lidar(capped=False) - want) < 1e-3).mean() > 0.999
    np.testing.assert_array_equal(lidar(capped=True), np.minimum(lidar(capped=False), RANGE))


def test_a_ray_along_the_diagonal_of_the_floor():
    """From one corner of the arena to the opposite one; and where no wall ends it."""
    for outer, far in (("walls", (5.85 - 0.5) * 2**0.5), ("none", 6.0)):
        env = maax.Base(1, impl="c")
        env.add_module(maax.WallScenarios("empty", outer=outer))
        env.add_module(maax.Agents(1))
        state = jax.jit(env.reset)(seeds.key(0))
        qpos = state.data.qpos.at[env.agents.qpos_ids[0, :2]].set(0.5)
        state = state.replace(data=jax.jit(env.engine.pose)(state.world.fields, state.data.replace(qpos=qpos)))
        for capped in (True, False):
            ray = jax.jit(maax.Lidar(env, 8, capped=capped).observation)(state)["lidar"][0, 1, 0]
            assert ray == pytest.approx(6.0 if capped else far, abs=1e-4)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda e: maax.LineOfSight(e, between="corner"), "between: got 'corner'; did you mean 'corners'"),
        (lambda e: maax.LineOfSight(e, between=True), "between: got True; takes one of ['centres', 'corners']"),
        (lambda e: maax.Lidar(e, capped=1), "capped: got 1; takes True or False"),
        (lambda _: maax.make("hide_and_seek", cone_between="edges"), "cone_between: got 'edges'; takes one of"),
    ],
)
def test_mistakes(call, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call(worlds()[0])
    assert message in str(error.value)
