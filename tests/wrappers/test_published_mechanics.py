"""Arms that collide, soft holds and locks, and the reach of ramps: against plain MuJoCo worlds and NumPy."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.wrappers import find

SOLREF, SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's defaults for constraints."""
ARM, ARM_SIZE = np.array([0.13, -0.075, -0.05]), 0.05
STEPS, PUSH = 80, 200.0
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose

AGENT = """
<body name="agent{i}">
  <joint name="a{i}x" type="slide" axis="1 0 0" damping="10"/>
  <joint name="a{i}y" type="slide" axis="0 1 0" damping="10"/>
  <joint name="a{i}z" type="slide" axis="0 0 1" damping="1"/>
  <joint name="a{i}r" type="hinge" axis="0 0 1" damping="10"/>
  <geom type="sphere" size="0.15" mass="1"/>
  <geom type="sphere" size="0.05" mass="0" pos="-0.13 -0.075 -0.05"/>
  <geom type="sphere" size="0.05" mass="0" pos="0.13 -0.075 -0.05"/>
</body>"""
WORLD = f"""
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <geom type="plane" size="3 3 1" pos="3 3 0"/>
    {AGENT.format(i=0)}
    {AGENT.format(i=1)}
    <body name="box">
      <joint name="bx" type="slide" axis="1 0 0" damping="0.01"/>
      <joint name="by" type="slide" axis="0 1 0" damping="0.01"/>
      <joint name="bz" type="slide" axis="0 0 1" damping="0.01"/>
      <joint name="br" type="hinge" axis="0 0 1" damping="0.01"/>
      <geom type="box" size="0.25 0.25 0.25" mass="1"/>
    </body>
  </worldbody>
  <equality><weld body1="agent0" body2="box" active="false"/></equality>
  <actuator>
    <motor joint="a0x" gear="100"/><motor joint="a0y" gear="100"/><motor joint="a0r" gear="100"/>
    <motor joint="a1x" gear="100"/><motor joint="a1y" gear="100"/><motor joint="a1r" gear="100"/>
  </actuator>
</mujoco>"""
"""Two agents with the published arms and a box, with all of MuJoCo's defaults."""


def build(soft, arms=None, method="joint_range", n_agents=2, free=False):
    env = maax.Base(n_agents, impl="c")
    env.add_module(maax.WallScenarios("empty"))
    env.add_module(maax.Agents(n_agents, arms=soft if arms is None else arms))
    env.add_module(maax.Boxes(1, free=free))
    env = maax.LockObjects(maax.TeamMembership(env), ["box"], radius=10.0, method=method, soft=soft)
    return maax.GrabObjects(env, ["box"], radius=1.0, soft=soft)


@cache
def played(soft):
    """`played(soft)(qpos, moves, action, force)`: (steps, 12) qpos of agents and box that start at rest in `qpos`."""
    env = build(soft, method="joint_range" if soft else "equality")
    base = env.base
    ids = np.concatenate([base.agents.qpos_ids, base.modules["box"].qpos_ids]).ravel()
    start = jax.jit(env.reset)(seeds.key(0))

    @jax.jit
    def play(qpos, moves, grab, lock, force):
        data = start.data.replace(qpos=start.data.qpos.at[ids].set(qpos))
        data = base.engine.pose(start.world.fields, data)
        load = data.xfrc_applied.at[base.modules["box"].body_ids[0]].set(force)

        def step(state, move):
            state = env.step(state, {"move": move, "grab": jnp.array([grab, 0]), "lock": jnp.full((2, 1), lock)})
            return state, state.data.qpos[ids]

        return jax.lax.scan(step, start.replace(data=data.replace(xfrc_applied=load)), moves)[1]

    return lambda *args: np.asarray(play(*args), float)


def in_plain(qpos, moves, grab, lock, force):
    """The same in plain MuJoCo: a default weld from agent 0 to the box, and default joint ranges closed on a point."""
    model = mujoco.MjModel.from_xml_string(WORLD)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    if grab:
        place, turn, back = np.zeros(3), np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(back, data.body("agent0").xquat)
        mujoco.mju_rotVecQuat(place, data.body("box").xpos - data.body("agent0").xpos, back)
        mujoco.mju_mulQuat(turn, back, data.body("box").xquat)
        model.eq_data[0, 3:10] = [*place, *turn]
        data.eq_active[0] = 1
    if lock:
        for joint in ("bx", "by", "bz", "br"):
            model.joint(joint).range[:] = data.joint(joint).qpos
            model.jnt_limited[model.joint(joint).id] = 1
    data.xfrc_applied[model.body("box").id] = force
    trail = []
    for move in moves:
        data.ctrl[:] = move.ravel()
        mujoco.mj_step(model, data)
        trail.append(data.qpos.copy())
    return np.array(trail)


def at(agent0, agent1, box, yaw=0.0):
    """qpos with everything on the floor."""
    return np.array([*agent0, 0.149, yaw, *agent1, 0.149, 0.0, *box, 0.2499, 0.0])


# --- arms ------------------------------------------------------------------------------------------------------


def test_arms_are_the_published_ones():
    """Two spheres without mass that collide with everything, as slippery as their agent."""
    env = maax.make("hide_and_seek_quadrant", impl="c", published=True)
    model, plain = env.base.model, maax.make("hide_and_seek_quadrant", impl="c").base.model
    for i in range(4):
        agent, geom = model.body(f"agent{i}").id, model.geom(f"agent{i}")
        arms = [model.geom(f"agent{i}:hand_{side}") for side in ("right", "left")]
        close([arm.pos for arm in arms], [ARM * [-1, 1, 1], ARM])
        close([arm.size[0] for arm in arms], ARM_SIZE)
        for arm in arms:
            assert model.geom_bodyid[arm.id] == agent
            equal([arm.contype, arm.conaffinity], [geom.contype, geom.conaffinity])
            equal(arm.friction, geom.friction)
            equal(arm.condim, geom.condim)
        assert geom.friction[0] == 0.01
        assert model.body_mass[agent] == 1.0
        equal(model.body_inertia[agent], plain.body_inertia[agent])
        equal(model.body_ipos[agent], 0)
        assert plain.geom(f"agent{i}:hand_left").contype == plain.geom(f"agent{i}:hand_right").conaffinity == 0


def test_agents_with_arms_stay_further_apart():
    """Side by side and pushed together: at 0.36 m instead of 0.30 m, until they have turned; as in plain MuJoCo."""
    push = np.array([[[0.3, 0, 0], [-0.3, 0, 0]]] * STEPS, np.float32)
    start = at([2.8, 3.0], [3.2, 3.0], [1.0, 1.0])
    trails = {arms: played(arms)(start, push, 0, 0, np.zeros(6)) for arms in (True, False)}
    gap = {arms: (trail[:, 4] - trail[:, 0])[STEPS // 4 : STEPS // 2] for arms, trail in trails.items()}
    assert gap[False].max() < 0.305
    assert gap[True].min() > 0.34
    close(trails[True], in_plain(start, push, 0, 0, np.zeros(6)), atol=1e-5)


def test_arms_are_not_observed():
    """The same world from the same key, with the same arrays."""
    states = [jax.jit(build(True, arms=arms).reset)(seeds.key(0)) for arms in (True, False)]
    with_arms, without = (jax.device_get(state.obs) for state in states)
    assert with_arms.keys() == without.keys()
    for name in with_arms:
        equal(with_arms[name], without[name])


# --- holds and locks -------------------------------------------------------------------------------------------


def softness(model, name):
    """The solver's settings of an equality or a joint of that name."""
    if ":grab:" in name or ":lock:" in name:
        return tuple(model.eq(name).solref), tuple(model.eq(name).solimp)
    i = model.joint(name).id
    return tuple(model.jnt_solref[i]), tuple(model.jnt_solimp[i])


@pytest.mark.parametrize(("method", "free"), [("equality", False), ("equality", True), ("joint_range", False)])
def test_soft_ones_have_the_defaults_of_mujoco(method, free):
    for soft in (True, False):
        model = build(soft, method=method, free=free).base.model
        locks = ["box0:x", "box0:yaw"] if method == "joint_range" else ["box0:lock:x", "box0:lock:yaw"]
        for name in ["agent1:grab:box0", *(["box0:lock:weld"] if free else locks)]:
            assert (softness(model, name) == (SOLREF, SOLIMP)) == soft, name
        kinds = {int(model.eq_type[i]) for i in range(model.neq) if ":grab:" in model.eq(i).name}
        assert (kinds == {int(mujoco.mjtEq.mjEQ_WELD)}) == (soft or free)


def test_what_is_held_softly_hangs_on_a_default_weld():
    """Carried about while it is pushed, as by plain MuJoCo; further off its place than in a stiff hold."""
    moves = np.zeros((STEPS, 2, 3), np.float32)
    moves[:, 0] = seeds.rng(0).uniform(-1, 1, (4, 3)).repeat(STEPS // 4, axis=0) * [0.5, 0.5, 0.2]
    start, force = at([3.0, 3.0], [0.6, 5.4], [3.0, 2.5], yaw=0.3), np.array([40.0, 30, 0, 0, 0, 2])
    soft, stiff = (played(kind)(start, moves, 1, 0, force) for kind in (True, False))
    close(soft, in_plain(start, moves, 1, 0, force), atol=1e-5)
    off = {}
    for name, trail in (("soft", soft), ("stiff", stiff)):
        turn = np.exp(-1j * trail[:, 3])  # into the agent's frame
        place = (trail[:, 8] - trail[:, 0] + 1j * (trail[:, 9] - trail[:, 1])) * turn
        off[name] = np.abs(place - (start[8] - start[0] + 1j * (start[9] - start[1])) * np.exp(-0.3j))
    assert np.median(off["soft"]) > 1.5 * np.median(off["stiff"])
    assert off["soft"].max() < 0.2


def test_what_is_locked_softly_is_in_default_joint_ranges():
    """Pushed by 200 N, as in plain MuJoCo; it gives way more than in a stiff lock, and stays."""
    start, force = at([1.0, 1.0], [5.0, 5.0], [3.0, 3.0]), np.array([0.6 * PUSH, 0.8 * PUSH, 0, 0, 0, 5.0])
    still = np.zeros((STEPS, 2, 3), np.float32)
    soft, stiff = (played(kind)(start, still, 0, 1, force)[:, 8:] - start[8:] for kind in (True, False))
    close(soft, in_plain(start, still, 0, 1, force)[:, 8:] - start[8:], atol=1e-5)
    way = [np.linalg.norm(trail[:, :2], axis=1).max() * 1e3 for trail in (soft, stiff)]
    assert way[0] > 5 * way[1], "mm"
    assert 1 < way[0] < 20, "mm"


# --- reach -----------------------------------------------------------------------------------------------------


def test_ramps_are_reached_as_the_box_of_their_inertia():
    """Agents at all heights around turned ramps, against an oriented box in NumPy; and the box around them else."""
    n, rng = 200, seeds.rng(0)
    for inertial, half in ((True, (1 / 18**0.5, 0.25, 1 / 8**0.5)), (False, (0.25, 0.25, 0.25))):
        env = maax.Base(4, impl="c")
        env.add_module(maax.Agents(4))
        env.add_module(maax.Ramps(2, inertial_reach=inertial))
        env = maax.GrabObjects(env, ["ramp"])
        base, reach = env.base, find(env, maax.GrabObjects)._reach
        agents, ramps = base.agents.qpos_ids, base.modules["ramp"].qpos_ids
        state = jax.jit(env.reset)(seeds.key(0))
        qpos = np.broadcast_to(state.data.qpos, (n, base.model.nq)).copy()
        qpos[:, agents[:, :2]], qpos[:, ramps[:, :2]] = (3 + rng.uniform(-0.6, 0.6, (n, m, 2)) for m in (4, 2))
        qpos[:, agents[:, 2]], qpos[:, ramps[:, 2]] = rng.uniform(0.1, 1.0, (n, 4)), rng.uniform(0.2, 0.4, (n, 2))
        qpos[:, ramps[:, 3]] = rng.uniform(-np.pi, np.pi, (n, 2))

        @jax.jit
        @jax.vmap
        def reached(qpos, base=base, reach=reach, state=state):
            data = base.engine.pose(state.world.fields, state.data.replace(qpos=qpos))
            return reach(state.replace(data=data))

        far, near = (np.asarray(x) for x in reached(jnp.asarray(qpos)))
        way = qpos[:, agents[:, :3]][:, :, None] - qpos[:, ramps[:, :3]][:, None]
        cos, sin = (f(qpos[:, ramps[:, 3]])[:, None] for f in (np.cos, np.sin))
        along = np.stack(
            [cos * way[..., 0] + sin * way[..., 1], cos * way[..., 1] - sin * way[..., 0], way[..., 2]], -1
        )
        want = np.linalg.norm(np.maximum(np.abs(along) - half, 0), axis=-1)
        close(far, want, atol=1e-5)
        clear = np.abs(want - 0.25) > 1e-5
        equal(near[clear], (want <= 0.25)[clear])
        assert 0.1 < near.mean() < 0.9


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: maax.Agents(1, arms=1), "arms: got 1; takes True or False"),
        (lambda: maax.Ramps(1, inertial_reach="yes"), "inertial_reach: got 'yes'; takes True or False"),
        (lambda: build(1, arms=False), "soft: got 1; takes True or False"),
        (lambda: maax.GrabObjects(maax.make("standard"), soft=None), "soft: got None; takes True or False"),
    ],
)
def test_mistakes(call, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call()
    assert message in str(error.value)
