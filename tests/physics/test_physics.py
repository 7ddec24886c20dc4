"""The engines against plain MuJoCo, loaded from the files that `to_mjcf` writes."""

from __future__ import annotations

import contextlib
import dataclasses
import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from helpers.plain_mujoco import in_plain_mujoco

import maax_mjx as maax
from maax_mjx.physics.kinematics import UprightKinematics

N = 64
HELD = 20


def bang_bang(seed, n=N, n_agents=4):
    return seeds.rng(seed).choice([-1.0, 1.0], (n, n_agents, 3)).astype(np.float32)


def uniform(seed, n=N, n_agents=4):
    return seeds.rng(seed).uniform(-1, 1, (n, n_agents, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def pushed(env_c, batch_reset, batch_step):
    """64 worlds of M after 80 steps of held full force: agents, boxes and ramps in contact with walls."""
    states = batch_reset(env_c, jax.random.split(seeds.key(7), N))
    for t in range(80):
        states = batch_step(env_c, states, {"move": bang_bang(t // HELD)})
    return states


def test_worlds_differ_in_their_walls(env_c, pushed):
    ids = env_c.overlay["geom_size"]
    assert len(ids) == 8
    sizes = np.asarray(pushed.world.fields["geom_size"])
    assert len(np.unique(sizes[:, 4:].reshape(N, -1), axis=0)) > N // 2


def test_c_follows_plain_mujoco(env_c, pushed, batch_step):
    states, worlds = pushed, [in_plain_mujoco(env_c, pushed, i) for i in range(N)]
    contacts = 0
    for t in range(100):
        action = bang_bang(100 + t // HELD)
        states = batch_step(env_c, states, {"move": action})
        for (model, data), move in zip(worlds, action, strict=True):
            data.ctrl[:] = move.ravel()
            mujoco.mj_step(model, data)
            contacts += data.ncon
        error = np.abs(np.stack([d.qpos for _, d in worlds]) - states.data.qpos).max(axis=1)
        if t == 0:
            assert error.max() < 1e-6
    assert error.max() < 1e-5
    assert contacts / (100 * N) > 7, "the worlds must be in contact for this to mean anything"


def test_poses_are_current_and_those_of_mujoco(env_c, pushed):
    for i in (0, 5):
        model, data = in_plain_mujoco(env_c, pushed, i)
        mujoco.mj_kinematics(model, data)
        for name in ("xpos", "xquat", "geom_xpos", "geom_xmat"):
            got = np.asarray(getattr(pushed.data, name))[i]
            want = getattr(data, name).reshape(got.shape)
            if name == "xquat":
                want = want * np.sign((want * got).sum(axis=1, keepdims=True))
            np.testing.assert_allclose(got, want, atol=2e-6, err_msg=name)


def test_worlds_begin_at_the_rest_of_mjx(env_c):
    """Field by field what `mjx.make_data` gives, which the engine `c` does not import."""
    engine = env_c.engine
    rest, wanted = engine._rest, engine.mjx.data({})
    for name in (field.name for field in dataclasses.fields(rest) if field.name != "engine"):
        mine, theirs = getattr(rest, name), getattr(wanted, name)
        assert mine.dtype == theirs.dtype, name
        np.testing.assert_array_equal(mine, np.zeros_like(theirs) if name == "qpos" else theirs, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("free", [False, True])
def test_own_kinematics_equal_those_of_mjx(free):
    env = maax.Base(1, impl="c")
    env.add_module(maax.WallScenarios("quad"))
    env.add_module(maax.Agents(1))
    env.add_module(maax.Boxes(2, free=free))
    assert UprightKinematics.applies(env.model, env.overlay) is not free
    state = jax.jit(env.reset)(seeds.key(0))
    qpos = np.array(state.data.qpos)
    qpos += seeds.rng(0).normal(size=qpos.shape).astype(np.float32)
    data = jax.jit(env.engine.pose)(state.world.fields, state.data.replace(qpos=jnp.asarray(qpos)))
    model, truth = in_plain_mujoco(env, state, None)
    truth.qpos[:] = qpos
    mujoco.mj_kinematics(model, truth)
    np.testing.assert_allclose(data.geom_xpos, truth.geom_xpos, atol=1e-5)
    np.testing.assert_allclose(data.geom_xmat.reshape(-1, 9), truth.geom_xmat, atol=1e-5)


@pytest.fixture(scope="module")
def one_steps(env_c, batch_reset, batch_step):
    """`one_steps(draw)`: 16 times 64 states along runs of held actions, the actions, and what plain MuJoCo makes of it.

    The same for all engines.
    """

    @functools.cache
    def along(draw):
        states = batch_reset(env_c, jax.random.split(seeds.key(7), N))
        for t in range(80):
            states = batch_step(env_c, states, {"move": draw(t // HELD)})
        worlds, found = [in_plain_mujoco(env_c, states, i) for i in range(N)], []
        for t in range(160):
            action = draw(200 + t // HELD)
            if t % 10 == 0:
                here = jax.device_get(states.data)
                for i, (model, data) in enumerate(worlds):
                    data.qpos[:], data.qvel[:] = here.qpos[i], here.qvel[i]
                    data.qacc_warmstart[:], data.ctrl[:] = here.qacc_warmstart[i], action[i].ravel()
                    mujoco.mj_step(model, data)
                found.append((states, action, np.stack([data.qpos for _, data in worlds])))
            states = batch_step(env_c, states, {"move": action})
        return found

    return along


@pytest.mark.slow
@pytest.mark.parametrize("impl", ["jax", "warp"])
@pytest.mark.parametrize(("draw", "share"), [(uniform, 0.99), (bang_bang, 0.96)])
def test_one_step_from_the_same_states(draw, share, impl, env_c, one_steps, batch_step, request):
    """1,024 states along held-action runs, each stepped once by an accelerator's engine and once by plain MuJoCo.

    With full forces the least share of seven seeds was 0.977: a world that is stuck in a corner counts 16 times.
    """
    env = request.getfixturevalue(f"env_{impl}")
    errors = []
    for states, action, qpos in one_steps(draw):
        stepped = batch_step(env, states.replace(data=states.data.replace(engine=())), {"move": action})
        errors.extend(np.abs(qpos - stepped.data.qpos))
    assert len(errors) == 1024
    turns = np.array([env_c.model.joint(j).name.endswith(":yaw") for j in range(env_c.model.njnt)])
    errors = np.stack(errors)
    assert (errors[:, ~turns].max(axis=1) < 1e-4).mean() >= share, "metres"
    assert (errors[:, turns].max(axis=1) < 1e-3).mean() >= share, "radians: contact points along edges differ"


@pytest.mark.slow
@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_free_runs_with_mujoco(impl, env_c, batch_reset, batch_step, request):
    env = request.getfixturevalue(f"env_{impl}")
    keys = jax.random.split(seeds.key(3), N)
    truth, states = batch_reset(env_c, keys), batch_reset(env, keys)
    for t in range(3 * HELD):
        action = {"move": bang_bang(20000 + t // HELD)}
        truth, states = batch_step(env_c, truth, action), batch_step(env, states, action)
    error = np.abs(truth.data.qpos - states.data.qpos).max(axis=1)
    assert (error < 1e-3).mean() >= 0.75


@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_same_keys_same_layouts_on_all_engines(impl, env_c, batch_reset, request):
    keys = jax.random.split(seeds.key(3), N)
    a, b = batch_reset(env_c, keys), batch_reset(request.getfixturevalue(f"env_{impl}"), keys)
    np.testing.assert_array_equal(a.data.qpos, b.data.qpos)
    for name in a.world.fields:
        np.testing.assert_array_equal(a.world.fields[name], b.world.fields[name])


def test_n_frames_are_physics_steps(env_c, pushed, batch_step):
    thrice = maax.make("standard", impl="c", n_frames=3)
    action = {"move": bang_bang(1)}
    once = pushed
    for _ in range(3):
        once = batch_step(env_c, once, action)
    at_once = batch_step(thrice, pushed, action)
    np.testing.assert_allclose(once.data.qpos, at_once.data.qpos, atol=1e-6)
    np.testing.assert_allclose(at_once.data.time - pushed.data.time, 0.015, atol=1e-6)


def test_gravity_and_timestep_are_used():
    params = maax.WorldParams(gravity=-50.0, timestep=0.002)
    env = maax.make("standard", impl="c", world_params=params)
    state = jax.jit(env.reset)(seeds.key(0))
    model, _ = in_plain_mujoco(env, state, None)
    assert model.opt.gravity[2] == -50.0
    assert model.opt.timestep == env.model.opt.timestep == 0.002


def test_solver_settings(env_c):
    assert env_c.model.opt.iterations == env_c.model.opt.ls_iterations == 20
    assert env_c.model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert env_c.model.opt.timestep == 0.005


@pytest.mark.slow
@pytest.mark.parametrize("impl", ["jax", "warp"])
@pytest.mark.parametrize(("floor", "off"), [(0.0, 1e-3), ((0.0, 0.5), 5e-3)])
def test_nothing_rubs_without_friction(floor, off, impl):
    """An agent slides and pushes a box as in C MuJoCo; a floor that draws its friction has a hundredth at least."""
    if impl == "warp":
        pytest.importorskip("warp")
    trails = []
    for engine in ("c", impl):
        env = maax.Base(1, impl=engine)
        for module in (maax.FloorAttributes(floor), maax.Agents(1, friction=0.0), maax.Boxes(1, box_friction=0.0)):
            env.add_module(module)
        state, step = jax.jit(env.reset)(seeds.key(0)), jax.jit(env.step)
        slippery = {k: x.at[:, 0].set(0.0) for k, x in state.world.fields.items() if k == "geom_friction"}
        state = state.replace(world=state.world.replace(fields=state.world.fields | slippery))
        agent, box = (env.modules[name].qpos_ids[0] for name in ("agent", "box"))
        qpos = state.data.qpos.at[box[:2]].set(state.data.qpos[agent[:2]] + jnp.array([0.8, 0.0]))
        state = state.replace(data=jax.jit(env.engine.pose)(state.world.fields, state.data.replace(qpos=qpos)))
        trail = []
        for _ in range(40):
            state = step(state, {"move": jnp.array([[1.0, 0.0, 0.0]])})
            trail.append(state.data.qpos)
        trails.append(np.stack(trail))
    assert trails[0][-1, box[0]] - trails[0][0, box[0]] > 0.02, "it was pushed"
    np.testing.assert_allclose(trails[1], trails[0], atol=off)


@pytest.mark.slow
@pytest.mark.parametrize(("impl", "friction"), [("jax", None), ("jax", 0.0), ("warp", None)])
def test_contact_overflow_is_reported_and_counted(impl, friction):
    """With room for four contacts, an agent and a box, which has four of its own on the floor, make more than that.

    Without friction the box's have one row each, for which `jax` has room of their own.
    """
    if impl == "warp":
        pytest.importorskip("warp")
    alone = {"scenario": "empty", "outer": "none", "n_hiders": 1, "n_seekers": 0, "n_ramps": 0}
    alone |= {"box_friction": friction, "floor_friction": friction}
    worlds = maax.Worlds(maax.make("standard", impl=impl, contacts_per_world=4, **alone), 3)
    states, flags = worlds.reset(seeds.key(0)), np.zeros(3, int)
    for _ in range(20):
        states = worlds.step(states, {"move": jnp.zeros((3, 1, 3))})
        flags += np.asarray(states.metrics["contact_overflow"])
    assert states.metrics["contact_overflow"].all()
    np.testing.assert_array_equal(states.counts["contact_overflow"], flags)


def test_no_overflow_where_there_is_room():
    """One agent and the floor make one contact: all of them in use is not too many."""
    env = maax.Base(1, impl="jax")
    env.add_module(maax.Agents(1))
    state = jax.jit(env.step)(jax.jit(env.reset)(seeds.key(0)), {"move": jnp.zeros((1, 3))})
    assert not state.metrics["contact_overflow"]


@pytest.mark.parametrize("gravity", [-9.81, -50.0])
def test_gravity_moves_what_falls(gravity):
    env = maax.Base(1, impl="c", world_params=maax.WorldParams(gravity=gravity))
    env.add_module(maax.Agents(1))
    state = jax.jit(env.reset)(seeds.key(0))
    z, vz = env.agents.qpos_ids[0][2], env.agents.qvel_ids[0][2]
    state = state.replace(data=state.data.replace(qpos=state.data.qpos.at[z].set(1.0)))
    state = jax.jit(env.step)(state, {"move": jnp.zeros((1, 3))})
    np.testing.assert_allclose(state.data.qvel[vz], gravity * 0.005, rtol=0.01)


def free(impl):
    """Two agents, and boxes and a ramp with free joints."""
    env = maax.Base(2, impl=impl)
    for module in (maax.WallScenarios("empty"), maax.Agents(2), maax.Boxes((1, 3), free=True)):
        env.add_module(module)
    env.add_module(maax.Ramps(1, free=True))
    return env


@pytest.mark.slow
def test_free_joints():
    """Free boxes and ramps: parked ones rest, the others follow plain MuJoCo, as warp does step by step from C's."""
    env, other = free("c"), None
    with contextlib.suppress(ImportError):
        import warp  # noqa: F401

        other = jax.jit(jax.vmap(free("warp").step))
    # From one box, so that two are parked, to three.
    n_boxes = {"n_boxes": jnp.array([[1, 1], [2, 2], [3, 3], [1, 3]] * 2)}
    params = jax.tree.map(lambda x: jnp.broadcast_to(x, (8, 2)), env.default_params).replace(**n_boxes)
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(5), 8), params)
    worlds = [in_plain_mujoco(env, states, i) for i in range(8)]
    step = jax.jit(jax.vmap(env.step))
    parked = ~np.asarray(states.world.active["box"])
    assert parked.any()
    before = np.asarray(states.data.qpos)[:, env.modules["box"].qpos_ids]
    for t in range(60):
        action = bang_bang(300 + t // HELD, 8, 2)
        before_it, states = states, step(states, {"move": action})
        if other is not None and t % 10 == 0:
            stepped = other(before_it.replace(data=before_it.data.replace(engine=())), {"move": action})
            assert np.median(np.abs(stepped.data.qpos - states.data.qpos).max(axis=1)) < 1e-4
        for (model, data), move in zip(worlds, action, strict=True):
            data.ctrl[:] = move.ravel()
            mujoco.mj_step(model, data)
    assert np.abs(np.stack([d.qpos for _, d in worlds]) - states.data.qpos).max() < 1e-5
    after = np.asarray(states.data.qpos)[:, env.modules["box"].qpos_ids]
    np.testing.assert_allclose(after[parked], before[parked], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("first", ["c", "jax", "warp"])
@pytest.mark.parametrize("then", ["c", "warp"])
def test_a_state_goes_on_on_another_engine(first, then, batch_reset, batch_step, request):
    a, b = (request.getfixturevalue(f"env_{impl}") for impl in (first, then))
    states = batch_reset(a, jax.random.split(seeds.key(4), N))
    action = {"move": np.full((N, 4, 3), 0.5, np.float32)}
    onward, own = batch_step(b, states, action), batch_step(a, states, action)
    np.testing.assert_allclose(onward.data.qpos, own.data.qpos, atol=1e-4)
    maax.to_mjcf(b, states, 0)
