"""Advantages against a sum over all later steps, and the scale of values against NumPy."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

from maax_mjx.training.returns import DECAY, ValueScale, advantages

T, N = 30, 40


def by_hand(reward, value, after, end, last, fault, gamma, lam):
    """The sum of all discounted errors until the episode is over, or a step that was rolled back."""
    delta = reward + gamma * np.where(end, 0.0, after) - value
    result = np.zeros_like(delta)
    for t in range(len(delta)):
        for u in range(t, len(delta)):
            if fault[u]:
                break
            result[t] += (gamma * lam) ** (u - t) * delta[u]
            if last[u]:
                break
    return result


@pytest.mark.parametrize("cut", [False, True])
def test_advantages_are_discounted_sums_of_errors(cut):
    rng = seeds.rng(0)
    reward, value, after = (rng.normal(size=(T, N)).astype(np.float32) for _ in range(3))
    last = rng.random((T, N)) < 0.15
    end = last & (rng.random((T, N)) < 0.5) if cut else last
    fault = last & (rng.random((T, N)) < 0.3)
    # Within an episode the value after a step is that before the next one.
    after[:-1] = np.where(last[:-1], after[:-1], value[1:])
    found = advantages(*map(jnp.asarray, (reward, value, after, end, last, fault)), 0.99, 0.9)
    wanted = np.stack(
        [by_hand(*(x[:, i] for x in (reward, value, after, end, last, fault)), 0.99, 0.9) for i in range(N)], axis=1
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4)
    assert (np.asarray(found)[fault] == 0).all()


def test_a_fault_neither_pays_nor_costs():
    """Whatever the reward of the step that was rolled back, no step's advantage changes."""
    value = jnp.arange(5.0)[:, None]
    no = jnp.zeros((5, 1), bool)
    fault = no.at[3].set(True)
    found = [
        advantages(jnp.zeros((5, 1)).at[3].set(pay), value, value + 1, no, fault, fault, 0.99, 0.95)
        for pay in (-10.0, 0.0, 10.0)
    ]
    assert (found[0] == found[1]).all()
    assert (found[0] == found[2]).all()


def test_the_scale_follows_the_targets():
    rng, scale = seeds.rng(0), ValueScale.new()
    assert scale.normalised(jnp.float32(3.0)) == 3.0
    first = second = weight = 0.0
    for _ in range(50):
        x = rng.normal(7.0, 3.0, 100)
        scale = scale.updated(jnp.float32(x.mean()), jnp.float32((x**2).mean()))
        first, second = DECAY * first + (1 - DECAY) * x.mean(), DECAY * second + (1 - DECAY) * (x**2).mean()
        weight = DECAY * weight + 1 - DECAY
    mean = first / weight
    np.testing.assert_allclose(scale.moments, (mean, np.sqrt(second / weight - mean**2)), rtol=1e-3)
    np.testing.assert_allclose(scale.denormalised(scale.normalised(jnp.float32(-2.0))), -2.0, atol=1e-4)
