"""Derivatives through whole env steps, against each other and against finite differences in float64."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax

pytestmark = pytest.mark.slow

STEPS, EPS = 20, 1e-4


def make(impl="jax", outer="none"):
    alone = {"scenario": "empty", "n_hiders": 1, "n_seekers": 0, "n_ramps": 0}
    return maax.make("standard", impl=impl, outer=outer, **alone)


def facing_a_box(env, gap):
    """The agent at (2, 3), a box in front of it with `gap` between their surfaces."""
    state = env.reset(seeds.key(0))
    agent, box = env.agents.qpos_ids[0], env.modules["box"].qpos_ids[0]
    qpos = state.data.qpos.at[agent[[0, 1, 3]]].set(jnp.array([2.0, 3.0, 0.0]))
    qpos = qpos.at[box[[0, 1, 3]]].set(jnp.array([2.4 + gap, 3.05, 0.0]))
    return state.replace(data=env.engine.pose(state.world.fields, state.data.replace(qpos=qpos)))


def ends(env, actions, state):
    """(3,) the agent's x and y and the box's x after one step for each of `actions` (n, 1, 3)."""
    state, _ = jax.lax.scan(lambda s, a: (env.step(s, {"move": a}), None), state, actions)
    box = state.data.qpos[env.modules["box"].qpos_ids[0][0]]
    return jnp.append(state.data.xpos[env.agents.body_ids[0], :2], box)


@pytest.fixture(scope="module")
def derivatives():
    """In float64: `gap -> (derivatives of the agent's x by jacfwd, by grad, by differences, and the box's way)`."""
    with jax.enable_x64(True):
        env = make()
        run = jax.jit(jax.vmap(lambda actions, state: ends(env, actions, state), in_axes=(0, None)))
        forward = jax.jit(jax.jacfwd(lambda a, s: ends(env, a, s)[0]))
        reverse = jax.jit(jax.grad(lambda a, s: ends(env, a, s)[0]))
        place = jax.jit(lambda gap: facing_a_box(env, gap))

    def at(gap):
        with jax.enable_x64(True):
            state = place(gap)
            actions = jnp.array([0.5, 0.0, 0.0]) + 0.5 * jax.random.uniform(seeds.key(1), (STEPS, 1, 3))
            change = EPS * jnp.eye(actions.size).reshape(-1, *actions.shape)
            ahead, behind = run(actions + change, state), run(actions - change, state)
            differences = np.reshape((ahead - behind)[:, 0] / (2 * EPS), actions.shape)
            way = float(ahead[0, 2] - state.data.qpos[env.modules["box"].qpos_ids[0][0]])
            return np.asarray(forward(actions, state)), np.asarray(reverse(actions, state)), differences, way

    return at


@pytest.mark.parametrize(("gap", "pushed"), [(2.0, False), (0.0, True)])
def test_forward_reverse_and_finite_differences_agree(derivatives, gap, pushed):
    forward, reverse, differences, way = derivatives(gap)
    assert (abs(way) > 0.01) == pushed
    scale = np.abs(differences).max()
    assert np.isfinite(forward).all()
    assert scale > 1e-3
    np.testing.assert_allclose(forward, reverse, atol=1e-4 * scale)
    np.testing.assert_allclose(forward, differences, atol=1e-4 * scale)


def test_the_world_has_no_derivative():
    env = make(outer="walls")
    state = jax.eval_shape(env.reset, seeds.key(0))

    def loss(pos, state):
        fields = state.world.fields | {"geom_pos": pos}
        state = state.replace(world=state.world.replace(fields=fields))
        return env.step(state, {"move": jnp.zeros((1, 3))}).data.qpos.sum()

    with pytest.raises(maax.NotDifferentiableError, match="with respect to actions"):
        jax.eval_shape(jax.grad(loss), state.world.fields["geom_pos"], state)


@pytest.mark.parametrize("impl", ["c", "warp"])
def test_other_engines_say_so(impl):
    if impl == "warp":
        pytest.importorskip("warp")
    env = make(impl)
    state = jax.jit(env.reset)(seeds.key(0))
    for mode in (jax.grad, jax.jacfwd):
        with pytest.raises(maax.NotDifferentiableError, match=f"impl='{impl}' has no derivatives.*impl='jax'"):
            mode(lambda a: env.step(state, {"move": a}).data.qpos[0])(jnp.zeros((1, 3)))
