"""The contract of every environment, the jitted functions, and what an agent feels."""

from __future__ import annotations

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from helpers import seeds

import maax_mjx as maax
from maax_mjx.core.env import Base
from maax_mjx.testing import check_env


@pytest.mark.slow
def test_check_env_jax():
    """A whole game, with counts that are drawn; all games on `c` are checked with the tasks."""
    few = {"n_hiders": (1, 2), "n_seekers": 1, "n_boxes": (0, 1), "n_ramps": 0, "scenario": "empty"}
    check_env(maax.make("hide_and_seek", impl="jax", **few), n_worlds=2, n_steps=2, seed=seeds.seed(0))


@pytest.mark.slow
def test_check_env_warp():
    pytest.importorskip("warp")
    few = {"n_hiders": 1, "n_seekers": 1, "n_boxes": (0, 1), "n_ramps": 0, "scenario": "empty"}
    check_env(maax.make("standard", impl="warp", **few), n_worlds=2, n_steps=2, seed=seeds.seed(0))


@jax.custom_batching.custom_vmap
def in_a_batch(x):
    """1 under vmap, else 0: what a batch gives need not be what a loop gives."""
    return jnp.zeros_like(x)


@in_a_batch.def_vmap
def _(axis_size, in_batched, x):
    return jnp.ones_like(x), in_batched[0]


CHANCE = np.random.default_rng()


class Broken(Base):
    """Two agents on an open floor, with one thing wrong."""

    wrong = ""

    def begin(self, key, params):
        if self.wrong == "one world":
            key = seeds.key(0)
        out = super().begin(key, params)
        if self.wrong == "vmap":
            out = out.replace(reward=out.reward + in_a_batch(out.data.qpos[0]))
        return out

    def transition(self, state, action):
        out = super().transition(state, action)
        match self.wrong:
            case "dtype":
                return out.replace(reward=out.reward.astype(jnp.int32))
            case "tree":
                return out.replace(metrics=out.metrics | {"new": out.step})
            case "shape":
                return out.replace(reward=out.reward[:1])
            case "nan":
                return out.replace(reward=out.reward * jnp.nan)
            case "space":
                return out.replace(obs=out.obs | {"agent_pos": out.obs["agent_pos"][:1]})
            case "step":
                return out.replace(step=state.step)
            case "chance":
                noise = jax.pure_callback(lambda: np.float32(CHANCE.uniform()), jax.ShapeDtypeStruct((), "float32"))
                return out.replace(reward=out.reward + noise)
            case "numpy":
                return out.replace(reward=out.reward + np.float32(np.random.uniform()))  # noqa: NPY002
            case "refused":
                raise ValueError("no reward")
            case "typo":
                return out.replace(terminate=True)
            case "bool":
                return out.replace(terminated=bool(out.step > 3))
        return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("dtype", r"step changed a shape or dtype .*: state\.reward was float32\[2\] and is int32\[2\]"),
        ("tree", "step changed the tree"),
        ("shape", r"state\.reward was float32\[2\] and is float32\[1\]"),
        ("nan", "not finite"),
        ("space", "step changed a shape or dtype"),
        ("step", r"state\.step is 0"),
        ("chance", "two runs from the same key differ"),
        ("numpy", "draws from the generator of NumPy or Python, once, while it is traced"),
        ("refused", "world 0, step 1: no reward"),
        (
            "bool",
            r"step 1: a rule turns .* `if` \(test_env.py, line \d+: .*bool\(out.step > 3\)\)\), .*; takes jnp.where",
        ),
        ("one world", "two different keys the same world"),
        ("vmap", "vmap and loop"),
    ],
)
def test_check_env_finds_what_is_wrong(wrong, message):
    env = Broken(2, impl="c")
    env.wrong = wrong
    env.add_module(maax.WallScenarios("empty"))
    env.add_module(maax.Agents(2))
    with pytest.raises(AssertionError, match=message):
        check_env(env, n_worlds=2, n_steps=2, seed=seeds.seed(0))


class Declares(maax.ObservationWrapper):
    """Adds an array, and declares what it was told to."""

    def __init__(self, env, columns, gives=True):
        super().__init__(env)
        self._columns, self._gives = columns, gives

    def declared(self):
        return self.env.declared() | ({"own": maax.Observed(("agent",), self._columns)} if self._columns else {})

    def observation(self, state):
        return state.obs | ({"own": jnp.zeros((self.n_agents, 2))} if self._gives else {})


def test_check_env_holds_observations_against_their_declarations(env_c):
    two = (maax.Column("a"), maax.Column("b"))
    with pytest.raises(AssertionError, match="'own' is observed and not declared; say whose it is, in Declares"):
        check_env(Declares(env_c, ()))
    with pytest.raises(AssertionError, match="own"):
        check_env(Declares(env_c, two[:1]))
    with pytest.raises(AssertionError, match=r"\['own'\] are declared and not observed"):
        check_env(Declares(env_c, two, gives=False))


def test_a_wrapper_that_forgets_its_environment_says_so(env_c):
    class Forgetful(maax.ObservationWrapper):
        def __init__(self, env, gain):
            self.gain = gain

    with pytest.raises(AttributeError, match="env: Forgetful has none; takes a first line super"):
        _ = Forgetful(env_c, 2.0).base


class Gear(maax.ActionWrapper):
    """Has another part of the action, of any space."""

    def __init__(self, env, part):
        super().__init__(env)
        self.part = part

    @property
    def action_space(self):
        return spaces.Dict({**self.env.action_space.spaces, "gear": self.part})

    def action(self, state, action):
        return {"move": action["move"]}


@pytest.mark.parametrize(
    "part",
    [
        spaces.Discrete(2),
        spaces.MultiDiscrete([2, 2, 2, 3]),
        spaces.MultiDiscrete([2, 2, 2, 2], start=[1, 1, 1, 1]),
        spaces.Box(np.array([-1, -1, -1, 0]), np.array([1, 1, 1, 9]), dtype=np.float32),
        spaces.Box(-np.inf, np.inf, (4,)),
        spaces.Box(0, 255, (4,), np.uint8),
    ],
)
def test_actions_that_agents_cannot_share_are_refused(env_c, part):
    env = Gear(env_c, part)
    for use in (lambda: env.sample_action(seeds.key(0)), lambda: maax.Worlds(env, 2), lambda: maax.TeamMembership(env)):
        with pytest.raises(ValueError, match=r"^action_space: got .* for 'gear'; takes a Box with bounds, floats"):
            use()
    with pytest.raises(AssertionError, match=r"action_space: got .* for 'gear'"):
        check_env(env)


def test_bounds_of_ones_own_are_drawn_within_and_said(env_c):
    env = Gear(env_c, spaces.Box(-2.0, 5.0, (4, 2)))
    drawn = np.asarray(jax.vmap(env.sample_action)(jax.random.split(seeds.key(0), 200))["gear"])
    assert -2 <= drawn.min() < -1.9
    assert 4.9 < drawn.max() <= 5
    action = env.sample_action(seeds.key(0))
    with pytest.raises(ValueError, match=r"'gear' holds NaN; takes numbers in \[-2, 5\]"):
        env.step(env.reset(seeds.key(0)), action | {"gear": np.full((4, 2), np.nan, np.float32)})


def test_jitted_by_name_and_by_env(env_c):
    reset, step = maax.jitted("standard", impl="c")
    state = reset(seeds.key(0))
    again = maax.jitted(env_c)[0](seeds.key(0))
    np.testing.assert_array_equal(state.data.qpos, again.data.qpos)
    state = step(state, {"move": jnp.zeros((4, 3))})
    assert int(state.step) == 1


def test_jitted_can_be_scanned_and_vmapped(env_c):
    reset, step = maax.jitted(env_c)
    states = jax.vmap(reset)(jax.random.split(seeds.key(0), 3))
    action = {"move": jnp.ones((3, 4, 3))}
    states, _ = jax.lax.scan(lambda s, _: (jax.vmap(step)(s, action), None), states, length=3)
    np.testing.assert_array_equal(states.step, [3, 3, 3])


def test_public_functions_have_docstrings():
    for name in maax.__all__:
        thing = getattr(maax, name)
        assert inspect.getdoc(thing), name


def test_agents_feel_their_motors(env_c, batch_reset, batch_step):
    """Terminal speed is force over damping, 100 / 10, which yaw reaches at once and x only where the room is long."""
    states = batch_reset(env_c, jax.random.split(seeds.key(0), 2))
    move = jnp.zeros((2, 4, 3)).at[:, 0].set(jnp.array([0.0, 0.0, 1.0]))
    for _ in range(40):
        states = batch_step(env_c, states, {"move": move})
    qvel = states.obs["agent_qpos_qvel"][:, 0, 4:]
    np.testing.assert_allclose(qvel[:, 3], 10.0, atol=0.05)
    before = states.obs["agent_pos"][:, 1:]
    for _ in range(10):
        states = batch_step(env_c, states, {"move": move})
    np.testing.assert_allclose(states.obs["agent_pos"][:, 1:], before, atol=1e-4)


def test_controls_are_clamped_not_wrong(env_c, batch_reset, batch_step):
    states = batch_reset(env_c, jax.random.split(seeds.key(0), 2))
    one, ten = (batch_step(env_c, states, {"move": jnp.full((2, 4, 3), v)}) for v in (1.0, 10.0))
    np.testing.assert_array_equal(one.data.qpos, ten.data.qpos)


def test_observations(env_ranges, batch_reset, batch_step):
    states = batch_reset(env_ranges, jax.random.split(seeds.key(5), 32))
    rng = seeds.rng(0)
    for _ in range(60):
        move = rng.choice([-1.0, 1.0], (32, 4, 3)).astype(np.float32)
        states = batch_step(env_ranges, states, {"move": move})
    qpos, qvel = np.asarray(states.data.qpos), np.asarray(states.data.qvel)
    model, obs = env_ranges.model, jax.device_get(states.obs)
    for i in range(4):
        q = qpos[:, [model.joint(f"agent{i}:{j}").qposadr[0] for j in ("x", "y", "z", "yaw")]]
        v = qvel[:, [model.joint(f"agent{i}:{j}").dofadr[0] for j in ("x", "y", "z", "yaw")]]
        np.testing.assert_array_equal(obs["agent_qpos_qvel"][:, i], np.concatenate([q, v], axis=1))
        heading = np.arctan2(np.sin(q[:, 3] - np.pi / 2), np.cos(q[:, 3] - np.pi / 2))
        np.testing.assert_allclose(np.cos(obs["agent_angle"][:, i, 0]), np.cos(heading), atol=1e-5)
        np.testing.assert_allclose(np.sin(obs["agent_angle"][:, i, 0]), np.sin(heading), atol=1e-5)
        assert (np.abs(obs["agent_angle"]) <= np.pi + 1e-6).all()
    for kind, n in (("box", 3), ("ramp", 2)):
        for i in range(n):
            q = qpos[:, [model.joint(f"{kind}{i}:{j}").qposadr[0] for j in ("x", "y", "z", "yaw")]]
            v = qvel[:, [model.joint(f"{kind}{i}:{j}").dofadr[0] for j in ("x", "y", "z", "yaw")]]
            want = np.concatenate([q[:, :3], np.cos(q[:, 3:]), np.sin(q[:, 3:]), v], axis=1)
            present = obs[f"{kind}_mask"][:, i]
            np.testing.assert_allclose(obs[f"{kind}_obs"][present, i], want[present], atol=1e-6)
            assert (obs[f"{kind}_obs"][~present, i] == 0).all()
            assert 0 < present.sum() < 32
