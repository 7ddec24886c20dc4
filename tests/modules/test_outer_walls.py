"""Outer walls keep in what is pressed deep into them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from helpers import seeds

import maax_mjx as maax

DEEP = 0.06
"""Metres from the edge of the floor to the middle of what is pressed in: beyond the middle of the wall that is seen."""


def test_what_is_pressed_beyond_a_walls_middle_comes_back():
    """An agent and a box, at all four sides, come back into the arena, though nothing pushes them."""
    env = maax.make("standard", impl="c", scenario="empty", n_hiders=1, n_seekers=0, n_boxes=1, n_ramps=0, n_frames=10)
    state = jax.jit(env.reset)(seeds.key(0))
    agent, box = env.base.agents.qpos_ids[0], env.base.modules["box"].qpos_ids[0]
    starts = []
    for axis in (0, 1):
        for place in (DEEP, 6 - DEEP):
            at = np.array([3.0, 3.0])
            at[axis] = place
            starts += [np.array(state.data.qpos) for _ in range(2)]
            starts[-2][agent[:2]] = starts[-1][box[:2]] = at
            starts[-2][box[:2]] = starts[-1][agent[:2]] = (2.0, 2.0)
    states = jax.tree.map(lambda x: jnp.stack([x] * len(starts)), state)
    states = states.replace(data=states.data.replace(qpos=jnp.asarray(np.stack(starts), jnp.float32)))
    step, still = jax.jit(jax.vmap(env.step)), {"move": jnp.zeros((len(starts), 1, 3))}
    for _ in range(20):
        states = step(states, still)
        assert not states.metrics["physics_fault"].any()
    for ids in (agent, box):
        xy = np.asarray(states.data.qpos)[:, ids[:2]]
        assert ((xy > 0.15) & (xy < 5.85)).all(), xy
