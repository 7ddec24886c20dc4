"""A curriculum of box counts, moved by a scripted judge."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import maax_mjx as maax

N, LEVELS = 6, (1, 2, 4)


def test_levels_follow_success():
    env = maax.make("standard", impl="c", n_boxes=(1, 4))
    curriculum = maax.Curriculum([env.default_params.replace(n_boxes=n) for n in LEVELS])
    levels, key = curriculum.start(N), jax.random.key(0)
    able = jnp.array([True, True, True, False, False, False])
    everyone = jnp.ones(N, bool)
    update = jax.jit(curriculum.update)
    levels = update(key, levels, everyone, able)
    np.testing.assert_array_equal(levels, [1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(update(key, levels, ~everyone, able), levels)
    levels = update(key, levels, everyone, able)
    np.testing.assert_array_equal(levels, [2, 2, 2, 0, 0, 0])
    beyond = [np.asarray(update(jax.random.key(i), levels, everyone, able))[:3] for i in range(30)]
    assert set(np.concatenate(beyond)) == {0, 1, 2}
    np.testing.assert_array_equal(curriculum.params(levels)["n_boxes"], [[4, 4]] * 3 + [[1, 1]] * 3)


def test_worlds_grow_with_a_scripted_agent():
    """Agents of the even worlds always win: after some episodes, these have the most boxes, and nothing is retraced."""
    env = maax.make("standard", impl="c", n_boxes=(1, 4), horizon=2)
    worlds = maax.Worlds(env, N)
    curriculum = maax.Curriculum([env.default_params.replace(n_boxes=n) for n in LEVELS])
    levels = curriculum.start(N)
    states = worlds.reset(jax.random.key(1), curriculum.params(levels))
    wins = jnp.arange(N) % 2 == 0
    seen = []
    for t in range(12):
        states = worlds.step(states, worlds.sample_action(jax.random.key(t)))
        if states.done.any():
            seen.append((np.asarray(levels), np.asarray(states.world.active["box"].sum(axis=1))))
        levels = curriculum.update(jax.random.key(t), levels, states.done, wins)
        states = worlds.with_params(states, curriculum.params(levels))
    for before, n_boxes in seen:
        np.testing.assert_array_equal(n_boxes, np.array(LEVELS)[before])
    assert max(n[0] for _, n in seen) == 4
    assert all(n[1] == 1 for _, n in seen)
    assert worlds._step._cache_size() == 1


def test_mistakes():
    with pytest.raises(ValueError, match="levels: got"):
        maax.Curriculum([])
    a, b = (maax.make("standard", impl="c", scenario=s).default_params for s in ("quad", "random"))
    with pytest.raises(ValueError, match="takes the same for all"):
        maax.Curriculum([a, b])
