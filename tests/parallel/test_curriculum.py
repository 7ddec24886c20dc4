"""A curriculum of box counts, moved by a scripted judge."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax

N, LEVELS = 6, (1, 2, 4)


def test_levels_follow_success():
    env = maax.make("standard", impl="c", n_boxes=(1, 4))
    curriculum = maax.Curriculum([env.default_params.replace(n_boxes=n) for n in LEVELS])
    levels, key = curriculum.start(N), seeds.key(0)
    able = jnp.array([True, True, True, False, False, False])
    everyone = jnp.ones(N, bool)
    update = jax.jit(curriculum.update)
    for playing, upcoming in (([0] * 6, [1, 1, 1, 0, 0, 0]), ([1, 1, 1, 0, 0, 0], [1, 1, 1, 0, 0, 0])):
        levels = update(key, levels, everyone, able)
        np.testing.assert_array_equal(levels.playing, playing)
        np.testing.assert_array_equal(levels.upcoming, upcoming)
    same = update(key, levels, ~everyone, able)
    np.testing.assert_array_equal(same.upcoming, levels.upcoming)
    levels = update(key, levels, everyone, able)
    np.testing.assert_array_equal(levels.upcoming, [2, 2, 2, 0, 0, 0])
    np.testing.assert_array_equal(curriculum.params(levels)["n_boxes"], [[4, 4]] * 3 + [[1, 1]] * 3)
    levels = update(key, levels, everyone, able)
    np.testing.assert_array_equal(levels.playing, [2, 2, 2, 0, 0, 0])
    beyond = [np.asarray(update(seeds.key(i), levels, everyone, able).upcoming)[:3] for i in range(30)]
    assert set(np.concatenate(beyond)) == {0, 1, 2}


class Counted(maax.Worlds):
    """Counts how often its step is traced, and so compiled."""

    traces = 0

    def step_fn(self, states, action):
        self.traces += 1
        return super().step_fn(states, action)


@pytest.mark.slow
def test_worlds_grow_with_a_scripted_agent():
    """Agents of the even worlds master any number of boxes, the others one: these never get beyond two."""
    env = maax.make("standard", impl="c", n_boxes=(1, 4), horizon=2)
    worlds = Counted(env, N)
    curriculum = maax.Curriculum([env.default_params.replace(n_boxes=n) for n in LEVELS])
    levels = curriculum.start(N)
    states = worlds.reset(seeds.key(1), curriculum.params(levels))
    seen = []
    for t in range(30):
        n_boxes = states.world.active["box"].sum(axis=1)
        np.testing.assert_array_equal(n_boxes, np.array(LEVELS)[levels.playing])
        seen.append(np.asarray(n_boxes))
        states = worlds.step(states, worlds.sample_action(seeds.key(t)))
        wins = (jnp.arange(N) % 2 == 0) | (n_boxes == 1)
        levels = curriculum.update(seeds.key(t), levels, states.done, wins)
        states = worlds.with_params(states, curriculum.params(levels))
    seen = np.stack(seen)
    assert seen[:, ::2].max() == 4
    assert (seen[:, 1::2].max(axis=0) == 2).all()
    assert (seen[:, 1::2] == 1).mean() > 0.3
    assert worlds.traces == 1


def test_mistakes():
    with pytest.raises(ValueError, match="levels: got"):
        maax.Curriculum([])
    a, b = (maax.make("standard", impl="c", scenario=s).default_params for s in ("quad", "random"))
    with pytest.raises(ValueError, match="takes the same for all"):
        maax.Curriculum([a, b])
    with pytest.raises(ValueError, match="levels: got"):
        maax.Curriculum(5)
    with pytest.raises(ValueError, match="level: got 9; takes 0 to 0"):
        maax.Curriculum([a]).start(3, 9)
