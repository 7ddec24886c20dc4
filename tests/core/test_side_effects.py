"""Nothing appears by a side effect, and nothing that was given is changed."""

import copy

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.seeds import key

import maax_mjx as maax
from maax_mjx.wrappers import find, find_all

equal = np.testing.assert_array_equal


def world(**fields):
    return maax.TeamMembership(maax.make("standard", impl="c", scenario="empty", **fields))


# --- the environment that was given ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_bare_environment_and_two_variants_of_it_live_side_by_side():
    bare = world(n_boxes=2)
    locks = maax.LockObjects(bare, objects=("box",))
    both = maax.GrabObjects(maax.LockObjects(bare, objects=("box", "ramp")))
    maax.LockObjects(bare)  # one that is thrown away
    # Four joints of each locked object; for each of four agents' holds on each object a centre and a yaw.
    assert [env.base.model.neq for env in (bare, locks, both)] == [0, 2 * 4, 3 * 4 + 4 * 3 * 2]
    assert [sorted(env.action_space) for env in (bare, locks, both)] == [
        ["move"], ["lock", "move"], ["grab", "lock", "move"],
    ]  # fmt: skip
    states = [jax.jit(env.reset)(key(0)) for env in (bare, locks, both)]
    for state in states[1:]:
        equal(state.data.qpos, states[0].data.qpos)
    assert len(bare.base.modules) == len(locks.base.modules) - 1 == len(both.base.modules) - 2


def test_looking_at_a_space_seals_nothing():
    env = world()
    assert env.observation_space["box_obs"].shape == (1, 9)
    locks = maax.LockObjects(env)
    assert locks.observation_space["box_lock"].shape == (4, 1, 3)
    assert "box_lock" not in env.observation_space.spaces


@pytest.mark.slow
def test_a_module_can_be_added_after_a_look():
    env = maax.make("standard", impl="c", n_ramps=0)
    before = env.base.model.nbody
    assert "cylinder_obs" not in env.observation_space.spaces
    env.add_module(maax.Cylinders(2))
    assert env.base.model.nbody == before + 2
    assert env.observation_space["cylinder_obs"].shape[0] == 2
    assert env.reset(key(0)).data.qpos.size == env.base.model.nq


@pytest.mark.slow
def test_two_locks_with_rules_of_their_own():
    env = maax.LineOfSight(world(n_boxes=1, n_ramps=1))
    env = maax.LockObjects(env, objects=("box",), lock_type="any", radius=100.0)
    env = maax.LockObjects(env, objects=("ramp",), lock_type="all", radius=100.0, action_name="lock_ramp")
    assert {name: space.shape for name, space in env.action_space.spaces.items()} == {
        "move": (4, 3), "lock": (4, 1), "lock_ramp": (4, 1),
    }  # fmt: skip
    state, step = jax.jit(env.reset)(key(0)), jax.jit(env.step)
    still, some = jnp.zeros((4, 3)), jnp.array([[1], [0], [0], [0]])
    state = step(state, {"move": still, "lock": some, "lock_ramp": some})
    # Of "any", one who wants it is enough; of "all", those near who do not want it prevail.
    assert bool(state.mechanics["locks"].locked[0])
    assert not bool(state.mechanics["lock_ramps"].locked[0])
    state = step(state, {"move": still, "lock": some, "lock_ramp": jnp.ones((4, 1), int)})
    assert bool(state.mechanics["lock_ramps"].locked[0])
    equal(state.obs["ramp_lock"][..., 2], 1)
    stats = maax.TrackStats(env).reset(key(0)).metrics
    assert {"boxes_locked", "ramps_locked"} <= set(stats)


@pytest.mark.slow
def test_copies_share_nothing_and_behave_alike():
    env = maax.make("hide_and_seek", impl="c", grab=maax.GrabConfig(), n_boxes=2)
    twin = copy.deepcopy(env)
    assert twin.base is not env.base
    assert all(twin.base.modules[name] is not module for name, module in env.base.modules.items())
    assert find(twin, maax.LockObjects).modules[0] is twin.base.modules["box"]
    state, other = jax.jit(env.reset)(key(1)), jax.jit(twin.reset)(key(1))
    action = env.sample_action(key(2))
    a, b = jax.jit(env.step)(state, action), jax.jit(twin.step)(other, action)
    for x, y in zip(jax.tree.leaves(a.obs), jax.tree.leaves(b.obs), strict=True):
        equal(x, y)


def test_a_copy_of_a_module_belongs_to_nobody():
    env = maax.make("standard", impl="c")
    box = copy.deepcopy(env.base.modules["box"])
    with pytest.raises(RuntimeError, match=r"Boxes: is in no environment yet; .*env.add_module\(Boxes"):
        _ = box.qpos_ids


def test_what_cannot_be_copied_is_named():
    class Streams(maax.StateWrapper):
        def __init__(self, env):
            super().__init__(env)
            self.file = (x for x in range(3))

        def observe(self, state):
            return state

    with pytest.raises(ValueError, match=r"env: Streams.file is generator, which cannot be copied"):
        maax.LockObjects(Streams(world()))


# --- ids -------------------------------------------------------------------------------------------------------------


def test_ids_are_there_when_they_are_read():
    """A user's wrapper that reads ids as it is made, before anything was built."""

    class Speed(maax.RewardWrapper):
        def __init__(self, env):
            super().__init__(env)
            self.columns = self.base.agents.qvel_ids[:, :2]

        def reward(self, state):
            return jnp.linalg.norm(state.data.qvel[self.columns], axis=1)

    env = Speed(maax.make("standard", impl="c"))
    model = env.base.model
    for i, columns in enumerate(env.columns):
        assert list(columns) == [model.joint(f"agent{i}:{axis}").dofadr[0] for axis in "xy"]


def test_ids_follow_the_model():
    base = maax.make("standard", impl="c", n_ramps=0)
    before = base.modules["box"].qpos_ids.copy()
    env = maax.Base(4, impl="c")
    ramps, boxes = maax.Ramps(1), maax.Boxes(1)
    for module in (maax.WallScenarios(), maax.Agents(4), ramps, boxes):
        env.add_module(module)
    assert boxes.qpos_ids[0, 0] == before[0, 0] + 4
    env.add_module(maax.Cylinders(1))
    assert boxes.qpos_ids[0, 0] == env.model.joint("box0:x").qposadr[0]


def test_ids_of_a_module_without_an_environment():
    with pytest.raises(RuntimeError, match=r"Agents: is in no environment yet; add it to one first"):
        _ = maax.Agents(2).ctrl_ids


# --- actions ---------------------------------------------------------------------------------------------------------


def test_actions_are_checked_once(monkeypatch):
    from maax_mjx.core import env as module

    calls = []
    check = module.check_action
    monkeypatch.setattr(module, "check_action", lambda *args, **kw: calls.append(args) or check(*args, **kw))
    env = maax.make("hide_and_seek_quadrant", impl="c")
    state = jax.eval_shape(env.reset, key(0))
    jax.eval_shape(env.step, state, jax.eval_shape(env.sample_action, key(0)))
    assert len(calls) == 1
    assert calls[0][0] is env.action_space or calls[0][0] == env.action_space


def test_a_class_that_overrides_a_door_is_refused_with_what_to_do():
    with pytest.raises(ValueError, match=r"step: Old overrides it; takes `transition\(state, action\)` instead"):

        class Old(maax.Wrapper):
            def step(self, state, action):
                return self.env.step(state, action)

    with pytest.raises(ValueError, match=r"reset: Older overrides it; takes `begin\(key, params\)` instead"):

        class Older(maax.Base):
            def reset(self, key, params=None):
                return super().reset(key, params)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: maax.LockObjects(maax.LockObjects(world())), "action_name: got 'lock', which env has already"),
        (lambda: maax.LockObjects(maax.LockObjects(world()), action_name="hold"), r"objects: got \['box', 'ramp'\]"),
        (lambda: maax.LockObjects(world(), action_name="lock it"), "action_name: got 'lock it'"),
        (lambda: maax.GrabObjects(maax.GrabObjects(world())), "GrabObjects: env has a wrapper named 'grabs' already"),
        (lambda: maax.LockObjects(world(), objects=("boxes",)), "objects: got 'boxes'; .*did you mean 'box'"),
    ],
)
def test_bad_input(make, says):
    with pytest.raises(ValueError, match=says):
        make()


def test_all_layers_of_a_kind():
    env = maax.LockObjects(maax.LockObjects(world(), ["box"]), ["ramp"], action_name="lock_ramp")
    assert [layer.name for layer in find_all(env, maax.LockObjects)] == ["lock_ramps", "locks"]
