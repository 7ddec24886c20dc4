"""The distribution of actions against SciPy, for every kind of space."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from helpers import seeds

from maax_mjx.training.actions import Head, entropies, log_prob, mode, sample

HEADS = (Head("grab", 1, 2, ()), Head("lock", 3, 2, (3,)), Head("move", 3, 11, (3,)), Head("turn", 2, 0, (2,)))


@pytest.fixture(scope="module")
def out():
    rng = seeds.rng(0)
    out = {head.name: jnp.asarray(rng.normal(size=(5, 4, head.width)), jnp.float32) for head in HEADS}
    return out | {"turn log std": jnp.asarray(rng.normal(size=(5, 4, 2)) * 0.3, jnp.float32)}


def by_scipy(out, action, i, j):
    """The log-probability and the entropy of one agent's action, part by part."""
    chance, spread = 0.0, 0.0
    for head in HEADS:
        numbers = np.asarray(out[head.name][i, j], float)
        values = np.asarray(action[head.name][i, j]).reshape(head.n)
        for k in range(head.n):
            if head.bins:
                logits = numbers.reshape(head.n, head.bins)[k]
                one = scipy.stats.multinomial(1, np.exp(logits) / np.exp(logits).sum())
                chance += one.logpmf(np.eye(head.bins)[int(values[k])])
                spread += one.entropy()
            else:
                one = scipy.stats.norm(numbers[k], np.exp(float(out[f"{head.name} log std"][i, j, k])))
                chance += one.logpdf(values[k])
                spread += one.entropy()
    return chance, spread


def test_log_probabilities_and_entropies_are_those_of_scipy(out):
    action = sample(HEADS, out, seeds.key(0))
    chances, spreads = log_prob(HEADS, out, action), sum(entropies(HEADS, out).values())
    for i, j in np.ndindex(5, 4):
        np.testing.assert_allclose((chances[i, j], spreads[i, j]), by_scipy(out, action, i, j), rtol=1e-4, atol=1e-4)


def test_actions_have_the_shapes_of_the_space_and_the_most_likely_is_one(out):
    action, best = sample(HEADS, out, seeds.key(0)), mode(HEADS, out)
    for head in HEADS:
        assert action[head.name].shape == best[head.name].shape == (5, 4, *head.shape)
        assert (action[head.name].dtype == jnp.int32) == bool(head.bins)
    assert (log_prob(HEADS, out, best) >= log_prob(HEADS, out, action)).all()


def test_draws_are_as_frequent_as_their_probabilities(out):
    n = 4000
    drawn = jax.vmap(lambda key: sample(HEADS, out, key))(jax.random.split(seeds.key(1), n))
    for head in HEADS:
        x = np.asarray(drawn[head.name], float).reshape(n, 5, 4, head.n)
        if head.bins:
            logits = np.asarray(out[head.name], float).reshape(5, 4, head.n, head.bins)
            chances = np.exp(logits) / np.exp(logits).sum(-1, keepdims=True)
            found = np.stack([(x == k).mean(0) for k in range(head.bins)], axis=-1)
            # Six standard errors, over some 500 frequencies.
            assert (np.abs(found - chances) < 6 * np.sqrt(chances * (1 - chances) / n) + 1e-3).all()
        else:
            std = np.exp(np.asarray(out["turn log std"]))
            assert (np.abs(x.mean(0) - np.asarray(out[head.name])) < 6 * std / np.sqrt(n)).all()
            assert (np.abs(x.std(0) / std - 1) < 6 / np.sqrt(2 * n)).all()
