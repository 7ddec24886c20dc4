"""Entities of several bodies, from files: desks with legs of their own and a drawer. Against plain MuJoCo."""

from __future__ import annotations

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from helpers.plain_mujoco import in_plain_mujoco

import maax_mjx as maax
from maax_mjx.viewer.stage import Stage
from maax_mjx.worldgen import ObjFromXML

# 0.8 x 0.6 x 0.6 m, and room for an open drawer; it opens towards -y, the flap above it swings up.
DESK = """<mujoco>
  <compiler angle="degree"/>
  <worldbody>
    <body name="annotation:outer_bound"><geom type="box" pos="0 0 .3" size=".4 .4 .3"/></body>
    <body name="main" pos="0 0 .3">
      <joint name="x" type="slide" axis="1 0 0"/> <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1"/> <joint name="yaw" type="hinge" axis="0 0 1"/>
      <geom name="main" type="box" pos="0 0 .27" size=".4 .3 .03" mass="2"/>
      <body pos="-.37 0 -.03"><geom type="box" size=".03 .3 .27" mass="1"/></body>
      <body name="right" pos=".37 0 -.03"><geom type="box" size=".03 .3 .27" mass="1"/></body>
      <body name="box" pos="0 0 .1"><joint name="drawer" type="slide" axis="0 -1 0" range="0 .4" damping="1"/>
        <geom type="box" size=".3 .28 .08" mass=".5"/>
        <body name="flap" pos="0 -.28 .09"><joint name="hinge" axis="1 0 0" range="-90 0" damping=".1"/>
          <geom type="box" pos="0 0 .02" size=".2 .01 .02" mass=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"""
N = 8
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


class Desks(maax.Entities):
    """Desks with a drawer."""

    kind = "desk"

    def __init__(self, n_desks=1, file=DESK, pose=None, extent=(0.8, 0.8, 0.6), **options):
        super().__init__(n_desks, extent, maax.uniform_placement, **options)
        self.file, self.pose = file, pose

    def make(self, name):
        return ObjFromXML(self.file, name, default_qpos=self.pose)


def base(*modules, impl="c", agents=2):
    env = maax.Base(agents, impl=impl, n_frames=4)
    for module in (maax.WallScenarios("empty"), maax.Agents({"hiders": 1, "seekers": agents - 1}), *modules):
        env.add_module(module)
    return env


@pytest.fixture(scope="module")
def game():
    """Eight worlds of one to three desks, whose drawers begin 10 cm open, with locks, sight and lidar."""
    desks = Desks((1, 3), pose={"drawer": 0.1}, friction=(0.2, 0.9), random_yaw=True)
    env = maax.TeamMembership(base(desks))
    env = maax.LockObjects(env, ["desk"], radius=9.0, lock_type="any", per_object=False)
    env = maax.Lidar(maax.LineOfSight(env, objects=["desk"]), n_rays=8)
    worlds = maax.Worlds(env, N, donate=False)
    return worlds, worlds.reset(seeds.key(0))


def act(worlds, lock=False, move=0.0):
    return {"move": np.full((N, 2, 3), move, np.float32), "lock": np.full((N, 2), lock, np.int8)}


def with_data(states, **fields):
    return states.replace(data=states.data.replace(**fields))


def test_poses_weights_and_frictions_are_those_of_the_exported_file(game):
    worlds, states = game
    env, desks = worlds.env.base, worlds.env.base.modules["desk"]
    active = np.asarray(states.world.active["desk"])
    assert 0 < active.mean() < 1
    close(np.asarray(states.data.qpos)[:, desks.inner_qpos_ids], np.broadcast_to([0.1, 0.0], (N, 3, 2)))
    for i in range(N):
        model, data = in_plain_mujoco(worlds.env, states, i)
        mujoco.mj_forward(model, data)
        for ours, theirs in (("xpos", "xpos"), ("geom_xpos", "geom_xpos")):
            close(np.asarray(getattr(states.data, ours))[i], getattr(data, theirs), atol=1e-5)
        close(states.data.geom_xmat[i].reshape(-1, 9), data.geom_xmat, atol=1e-5)
        for slot, name in enumerate(desks.names):
            bodies = [name, *(f"{name}:{part}" for part in ("body0", "right", "box", "flap"))]
            close(model.body_gravcomp[[model.body(body).id for body in bodies]], 0.0 if active[i, slot] else 1.0)
            sliding = model.geom_friction[np.isin(model.geom_bodyid, [model.body(b).id for b in bodies]), 0]
            assert sliding.shape == (5,)
            assert np.ptp(sliding) == 0
            assert 0.2 <= sliding[0] <= 0.9
    assert env.contacts_per_world > 0


@pytest.mark.slow
def test_it_moves_as_in_plain_mujoco_and_the_absent_stay(game):
    """A drawer in motion, and agents that push at full force; what moves inside is observed."""
    worlds, states = game
    desks = worlds.env.base.modules["desk"]
    active = np.asarray(states.world.active["desk"])
    ids = desks.inner_qvel_ids
    qvel = jnp.asarray(states.data.qvel).at[:, ids[:, 0]].set(jnp.where(active, 1.0, 0.0))
    start = states = with_data(states, qvel=qvel)
    plain = [in_plain_mujoco(worlds.env, states, i) for i in range(N)]
    for t in range(40):
        action = act(worlds, move=1.0 if t < 20 else -1.0)
        states = worlds.step(states, action)
        for i, (model, data) in enumerate(plain):
            data.ctrl[:] = action["move"][i].ravel()
            mujoco.mj_step(model, data, 4)
    close(states.data.qpos, [data.qpos for _, data in plain], atol=1e-4)
    before, after = (np.asarray(s.data.qpos) for s in (start, states))
    for ids in (desks.qpos_ids, desks.inner_qpos_ids):
        close(after[:, ids][~active], before[:, ids][~active], atol=1e-9)
    opened = (after - before)[:, desks.inner_qpos_ids[:, 0]][active]
    assert np.median(opened) > 0.2
    obs, qvel = np.asarray(states.obs["desk_obs"]), np.asarray(states.data.qvel)
    inside = np.stack([after[:, desks.inner_qpos_ids], qvel[:, desks.inner_qvel_ids]], axis=-1).reshape(N, 3, 4)
    close(obs[..., 9:], np.where(active[..., None], inside, 0), atol=1e-6)
    names = [column.name for column in worlds.env.observed["desk_obs"].columns]
    assert names[9:] == ["drawer", "drawer velocity", "hinge", "hinge velocity"]
    assert not np.asarray(states.metrics["physics_fault"]).any()


@pytest.mark.slow
def test_locks_hold_what_is_inside(game):
    """Under 50 N on the drawer, which opens without the lock."""
    worlds, states = game
    desks = worlds.env.base.modules["desk"]
    active = np.asarray(states.world.active["desk"])
    body = [worlds.env.base.model.body(f"{name}:box").id for name in desks.names]
    yaw = np.asarray(states.data.qpos)[:, desks.qpos_ids[:, 3]]
    pull = 50 * np.stack([np.sin(yaw), -np.cos(yaw), 0 * yaw], axis=-1)
    states = with_data(states, xfrc_applied=states.data.xfrc_applied.at[:, np.array(body), :3].set(pull))

    def after(lock):
        now = states
        for _ in range(15):
            now = worlds.step(now, act(worlds, lock))
        return np.abs(np.asarray(now.data.qpos - states.data.qpos))[active.any(axis=1)]

    held, free = after(True), after(False)
    inner = desks.inner_qpos_ids
    assert held[:, inner][active].max() < 1e-3
    assert held[:, desks.qpos_ids][active].max() < 1e-3
    assert free[:, inner[:, 0]][active].min() > 0.05


@pytest.mark.slow
def test_agents_see_it_by_its_parts_and_lidar_hits_them(game):
    """A leg is in the way of the ray to the middle of its desk; other things behind it are hidden."""
    worlds, states = game
    env, desks = worlds.env.base, worlds.env.base.modules["desk"]
    qpos = np.array(states.data.qpos)
    qpos[:, desks.qpos_ids[1:, 2]] = 50.0
    qpos[:, desks.qpos_ids[0]] = (3.0, 3.0, 0.3, 0.0)
    # The first agent east of the desk looks west at its leg, the second one behind it, in its shadow.
    qpos[:, env.agents.qpos_ids] = [(4.2, 3.0, 0.15, -np.pi / 2), (1.8, 3.0, 0.15, np.pi / 2)]
    active = {**states.world.active, "desk": jnp.zeros((N, 3), bool).at[:, 0].set(True)}
    states = with_data(states, qpos=qpos).replace(world=states.world.replace(active=active))
    states = worlds.step(states, act(worlds))
    assert np.asarray(states.obs["sees_desk"])[:, :, 0].all()
    equal(np.asarray(states.obs["sees_agent"]), np.broadcast_to(np.eye(2, dtype=bool), (N, 2, 2)))
    model, data = in_plain_mujoco(worlds.env, states, 0)
    mujoco.mj_forward(model, data)
    model.geom_group[model.geom_bodyid == model.body("agent0").id] = 5
    eye, geom = data.body("agent0").xpos.copy(), np.zeros(1, np.int32)
    west = mujoco.mj_ray(model, data, eye, np.array([-1.0, 0, 0]), np.array([1, 1, 1, 1, 1, 0]), 1, -1, geom)
    assert model.geom(geom[0]).name == "desk0:geom1"
    close(np.asarray(states.obs["lidar"])[0, 0, 4, 0], west, atol=1e-4)


def test_pictures_show_all_bodies_of_what_is_there(game):
    worlds, states = game
    active = np.asarray(states.world.active["desk"])
    world = int(np.flatnonzero(active.sum(axis=1) < 3)[0])
    names = [part.name for part in Stage(worlds.env).frame(maax.world_of(states, world)).parts]
    for slot in range(3):
        assert sum(name.startswith(f"desk{slot}") for name in names) == 5 * active[world, slot]


@pytest.mark.slow
def test_the_contract_and_the_jax_engine():
    """`check_env`; and MJX moves free desks as the C engine does."""
    maax.testing.check_env(base(Desks((0, 2))), n_steps=2)
    free = DESK[: DESK.index('<joint name="x"')] + '<freejoint name="free"/>' + DESK[DESK.index('<geom name="main"') :]
    ends = []
    for impl in ("c", "jax"):
        env = base(Desks(1, free, {"hinge": -0.5}, free=True), impl=impl)
        state = env.reset(seeds.key(1))
        qvel = jnp.asarray(state.data.qvel).at[env.modules["desk"].inner_qvel_ids[0, 0]].set(1.0)
        state = state.replace(data=state.data.replace(qvel=qvel))
        for _ in range(5):
            state = env.step(state, {"move": np.ones((2, 3), np.float32)})
        ends.append(np.asarray(state.data.qpos))
    close(*ends, atol=2e-4)
    assert ends[0][env.modules["desk"].inner_qpos_ids[0, 0]] > 0.05


BALL = DESK.replace('<joint name="hinge" axis="1 0 0" range="-90 0"', '<joint name="hinge" type="ball"')
EQUALITY = DESK.replace("</worldbody>", '</worldbody><equality><joint joint1="drawer" joint2="hinge"/></equality>')
ROUND = DESK.replace('<geom name="main" type="box" pos="0 0 .27" size=".4 .3 .03"', '<geom name="main" size=".3"')
ROUND = ROUND.replace('type="box" size=".03 .3 .27"', 'type="cylinder" size=".03 .27"')
for box in ('type="box" size=".3 .28 .08"', 'type="box" pos="0 0 .02" size=".2 .01 .02"'):
    ROUND = ROUND.replace(box, 'size=".01"')


class Walkers(maax.Agents):
    def __init__(self, n_agents):
        super().__init__(n_agents)
        self.extent = np.array((0.8, 0.8, 0.6), np.float32)

    def make(self, name):
        file = DESK.replace("</mujoco>", "") + "<actuator>"
        return ObjFromXML(
            file + "".join(f'<motor name="{j}" joint="{j}"/>' for j in ("x", "y", "yaw")) + "</actuator></mujoco>", name
        )


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: base(Desks(1, BALL)), r"^make: .*'desk0:hinge', a ball joint; takes hinges and slides inside"),
        (lambda: base(Desks(1, EQUALITY)), r"^make: Desks returned an object with an equality; takes bodies"),
        (
            lambda: base(Desks(1, DESK.replace('name="main" pos="0 0 .3"', 'name="main" pos="0 0 0"'))),
            r"^make: Desks returned a body \[.*-0.3\] m from the middle of its object; takes one in the middle",
        ),
        (lambda: base(Desks(1, pose={"yaw": 1.0})), r"^default_qpos: got a value for 'desk0:yaw'; takes joints inside"),
        (
            lambda: base(Desks(1, pose={"drawer": 0.5})),
            r"^default_qpos: got 0.5 for 'desk0:drawer'; takes a value in its range \[0, 0.4\]",
        ),
        (
            lambda: maax.LockObjects(maax.TeamMembership(base(Desks())), ["desk"], method="joint_range"),
            r"^method: got 'joint_range'; the joints inside of desk .* takes 'equality'",
        ),
        (lambda: base(Desks(1, ROUND), impl="jax").engine, r"^impl: got 'jax'; MJX has no contacts between a cylinder"),
        (lambda: maax.Base(1).add_module(Walkers(1)), r"^make: Walkers .* the joint 'drawer' inside.*takes bodies"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_named(make, match):
    with pytest.raises(ValueError, match=match):
        make()
