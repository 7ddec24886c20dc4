"""Object counting: boxes go where they are to go, out of sight, whatever the agent does."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.tasks.transfer.counting import AGENT
from maax_mjx.wrappers.wrapper import find

N, STEPS, HIDDEN = 16, 80, 65


@functools.cache
def test_it_was_not_published():
    with pytest.raises(ValueError, match="published: got True; object_counting takes False"):
        maax.make("object_counting", impl="c", published=True)


def env():
    return maax.make("object_counting", impl="c", n_boxes=(4, 6), observations="split")


@functools.cache
def played():
    """Worlds whose agent pushes as hard as it can; what it saw before every step, and where everything was after it."""
    worlds, task = maax.Worlds(env(), N), find(env(), maax.ObjectCounting)

    def push(state, key):
        action = env().sample_action(key)
        return action | {"move": jnp.full_like(action["move"], 10)}, {
            "counts": task.counts(state), "arrived": task.arrived(state)
        }  # fmt: skip

    keep = ("obs", "data.qpos", "world.active", "extras", "mechanics.counting", "metrics.physics_fault")
    _, kept = worlds.rollout(worlds.reset(seeds.key(0)), push, STEPS, keep=keep)
    return jax.device_get(kept)


@pytest.mark.slow
def test_everything_is_seen_at_first_and_nothing_in_the_end():
    sees, there = played()["obs"]["sees_box"][:, :, 0], played()["world.active"]["box"][0]
    assert sees.shape == (STEPS, N, 6)
    np.testing.assert_array_equal(sees[0], there)
    assert not sees[HIDDEN:].any()
    assert played()["extras"]["arrived"][HIDDEN:].all()
    assert not played()["extras"]["arrived"][0].any()
    assert not played()["metrics.physics_fault"].any()


@pytest.mark.slow
def test_nothing_tells_of_boxes_behind_the_screens():
    """Whichever side each of six boxes is on, none is in sight and the lidar reads the same: all 64 cases."""
    game = maax.make("object_counting", impl="c", observations="raw")
    boxes, n = game.base.modules["box"], 64
    state = jax.jit(game.reset)(seeds.key(0))
    sides = (np.arange(n)[:, None] >> np.arange(6)) & 1
    qpos = np.broadcast_to(state.data.qpos, (n, len(state.data.qpos))).copy()
    qpos[:, boxes.qpos_ids[:, 0]] = np.where(sides, 0.3, 8.7)
    states = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape)), state)
    left = states.mechanics["counting"].replace(left=jnp.asarray(sides == 1))
    states = states.replace(
        data=states.data.replace(qpos=jnp.asarray(qpos)), mechanics=states.mechanics | {"counting": left}
    )
    still = jax.tree.map(jnp.zeros_like, jax.vmap(game.sample_action)(jax.random.split(seeds.key(1), n)))
    after = jax.jit(jax.vmap(game.step))(states, still)
    assert not np.asarray(after.obs["sees_box"]).any()
    lidar = np.asarray(after.obs["lidar"])
    np.testing.assert_array_equal(lidar, np.broadcast_to(lidar[:1], lidar.shape))
    assert lidar.min() < 1, "it sees the screens"


@pytest.mark.slow
def test_boxes_end_on_the_side_that_is_counted():
    """By where they are, not by what the wrapper remembers."""
    boxes = env().base.modules["box"]
    x, there = played()["data.qpos"][-1][:, boxes.qpos_ids[:, 0]], played()["world.active"]["box"][0]
    np.testing.assert_allclose(np.minimum(x, 9 - x)[there], 0.3, atol=0.01)
    left = ((x < 4.5) & there).sum(axis=1)
    counts = played()["extras"]["counts"]
    np.testing.assert_array_equal(counts, np.broadcast_to(np.stack([left, there.sum(axis=1) - left], -1), counts.shape))
    assert 0 < left.sum() < there.sum(), "both sides, in sixteen worlds"


@pytest.mark.slow
def test_nobody_leaves_their_place():
    """Boxes stay on their lanes, and the agent where it is, looking the same way."""
    boxes, agents = env().base.modules["box"], env().base.agents
    qpos = played()["data.qpos"]
    y = qpos[..., boxes.qpos_ids[:, 1]]
    there = played()["world.active"]["box"][0]
    assert np.abs(y - y[:1])[:, there].max() < 0.01
    agent = qpos[..., agents.qpos_ids[0]]
    np.testing.assert_allclose(agent[..., :2], np.broadcast_to(AGENT, agent[..., :2].shape), atol=0.01)
    np.testing.assert_allclose(agent[..., 3], 0, atol=0.01)


@pytest.mark.slow
def test_boxes_set_out_one_by_one():
    """Each at its own time, at no more than its speed."""
    x = played()["data.qpos"][..., env().base.modules["box"].qpos_ids[:, 0]]
    starts, there = played()["mechanics.counting"].starts[0], played()["world.active"]["box"][0]
    moved = np.abs(np.diff(x, axis=0))
    assert moved.max() <= 3.0 * env().base.dt + 1e-4
    # The difference of steps t and t + 1 is the move of step t + 1.
    first = (moved > 1e-4).argmax(axis=0) + 1
    late = there & (starts > 0)
    np.testing.assert_array_equal(first[late], starts[late])
    assert starts.min() >= 0
    assert starts.max() <= 40


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"n_boxes": 0}, "which hold no objects"),
        ({"n_boxes": 7}, "n_boxes: got 7; object_counting takes up to 6"),
        ({"grid_size": 30}, "floor_size, grid_size: got 9.0 and 30; object_counting takes 9.0 and 90"),
        ({"task.speed": 0.0}, "speed: got 0.0"),
        ({"task.last_start": -1}, "last_start: got -1"),
    ],
)
def test_what_cannot_be_counted_is_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        maax.make("object_counting", impl="c", **fields)
