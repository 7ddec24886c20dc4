"""Policies with memories, extras and arguments per world; what of a state they saw."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import maax_mjx as maax

N, T, HORIZON = 5, 9, 4
equal = np.testing.assert_array_equal


@pytest.fixture(scope="module")
def env():
    """One hider or more, who prepare for two of four steps."""
    few = {"n_hiders": (1, 3), "n_seekers": 1, "n_boxes": 0, "n_ramps": 0, "lock": None, "scenario": "empty"}
    return maax.make("hide_and_seek", impl="c", horizon=HORIZON, prep_fraction=0.5, **few)


def counting(state, key, memory, gain, own):
    """Remembers how often it was asked; a world's own argument is what it does."""
    memory = {"asked": memory["asked"] + 1}
    action = {"move": jnp.full((4, 3), gain * own)}
    return action, memory, {"asked": memory["asked"], "step": state.step, "active": state.active, "can": state.can_act}


KEEP = ("action", "extras", "extras.asked", "truncated", "active", "can_act", "world.active", "obs.obs_mask")


@pytest.fixture(scope="module")
def played(worlds, start):
    own = jnp.linspace(0.1, 0.9, N)
    memory = {"asked": jnp.full((N,), 10)}
    return worlds.rollout(start, counting, T, jnp.float32(0.5), memory=memory, per_world=(own,), keep=KEEP)


def test_a_memory_is_the_worlds_own_and_zero_where_an_episode_begins(played):
    _, kept = played
    asked, ended = np.full(N, 10), np.asarray(kept["truncated"])
    assert ended.any(axis=0).all()
    for t in range(T):
        asked = asked + 1
        equal(kept["extras.asked"][t], asked)
        asked = np.where(ended[t], 0, asked)
    equal(kept["memory"]["asked"], asked)


def test_arguments_of_all_worlds_and_of_each(played):
    _, kept = played
    want = 0.5 * np.linspace(0.1, 0.9, N)
    np.testing.assert_allclose(kept["action"]["move"], np.broadcast_to(want[:, None, None], (T, N, 4, 3)), rtol=1e-6)


def test_what_the_policy_saw_of_the_agents_in_play(played):
    """In steps that end an episode, `world.active` is the next episode's; `active` is what the policy saw."""
    _, kept = played
    equal(kept["active"], kept["extras"]["active"])
    equal(kept["can_act"], kept["extras"]["can"])
    equal(kept["obs.obs_mask"].any(axis=-1), kept["active"])
    ended = np.asarray(kept["truncated"])
    equal(np.asarray(kept["active"])[~ended], np.asarray(kept["world.active"]["agent"])[~ended])
    # The seeker waits for the first two of four steps; after a staggered start, from its first whole episode on.
    first = np.asarray(kept["truncated"]).argmax(axis=0)
    for w in range(N):
        step = np.asarray(kept["extras"]["step"][first[w] + 1 :, w])
        equal(kept["can_act"][first[w] + 1 :, w, 3], step >= 2)
        equal(kept["can_act"][first[w] + 1 :, w, :3], kept["active"][first[w] + 1 :, w, :3])


def test_going_on_with_the_memory_is_one_long_rollout(worlds, start, played):
    own, gain = jnp.linspace(0.1, 0.9, N), jnp.float32(0.5)
    memory = {"asked": jnp.full((N,), 10)}
    states, parts = start, []
    for n in (4, T - 4):
        states, kept = worlds.rollout(
            states, counting, n, gain, memory=memory, per_world=(own,), keep=("extras.asked",)
        )
        memory = kept["memory"]
        parts.append(kept["extras.asked"])
    equal(np.concatenate(parts), played[1]["extras.asked"])
    np.testing.assert_allclose(states.data.qpos, played[0].data.qpos, atol=1e-6)


def test_records_play_with_memories(worlds, start):
    memory, own = {"asked": jnp.zeros(N, int)}, jnp.zeros(N)
    gain = jnp.float32(0.5)
    _, recording = maax.record(worlds, start, counting, 2, gain, every=1, memory=memory, per_world=(own,))
    assert recording.states.step.shape[0] == 3


def still(state, key):
    return {"move": jnp.zeros((4, 3))}


class Counting:
    """A player that remembers one number."""

    params = ()

    def on(self, env):
        return self

    def memory(self, n_worlds):
        return np.zeros((n_worlds, 1), np.float32)

    @staticmethod
    def play(state, key, memory, params):
        return still(state, key), memory + 1


def test_a_players_memory_has_its_shapes(worlds, start):
    player = Counting()
    _, kept = worlds.rollout(start, player, 1)
    _, kept = worlds.rollout(start, player, 1, memory=kept["memory"])
    assert kept["memory"].shape == (N, 1)
    with pytest.raises(ValueError, match=rf"memory: got shapes \({N}, 3\); takes \({N}, 1\), such as an earlier"):
        worlds.rollout(start, player, 1, memory=jnp.zeros((N, 3)))


class Blinking:
    """A policy with a method of its own, whose name players have as well."""

    def on(self, step):
        return step % 2 == 0

    def __call__(self, state, key):
        return {"move": jnp.where(self.on(state.step), jnp.zeros((4, 3)), 1.0)}


def test_a_policy_of_ones_own_may_have_any_methods(worlds, start):
    states, _ = worlds.rollout(start, Blinking(), 1)
    equal(states.step.shape, (N,))


def test_extras_without_a_memory(worlds, start):
    _, kept = worlds.rollout(start, lambda s, k: (still(s, k), {"t": s.step}), 1, keep=("extras.t",))
    equal(kept["extras.t"][0], start.step)
    assert "memory" not in kept


NONE = {"asked": jnp.zeros(N, int)}
CALLED = r"policy: got still\(state, key\), which is called with \(state, key, "
SHORT = {"per_world": (jnp.zeros(3),)}
MISTAKES = {
    "arguments": (lambda s: None, {}, r"policy: got <lambda>\(s\), which is called with \(state, key\): too many"),
    "memory argument": (still, {"memory": NONE}, CALLED + "memory"),
    "text": (lambda s, k, a: None, {"args": ("fast",)}, r"args\[0\]: got 'fast' in it; takes arrays"),
    "no memory back": (lambda s, k, m: still(s, k), {"memory": NONE}, r"got dict from it; takes \(action, memory\)"),
    "another memory": (lambda s, k, m: (still(s, k), m["asked"]), {"memory": NONE}, "got the memory .* takes the same"),
    "extras": (lambda s, k: (still(s, k), 3), {}, "policy: got 3 as extras; takes a dict of arrays"),
    "action": (lambda s, k: jnp.zeros((4, 3)), {}, r"policy's action: got an array; takes a dict with \['move'\]"),
    "argument per world": (still, SHORT, CALLED + r"args\[0\]"),
    "rows": (lambda s, k, o: still(s, k), SHORT, r"per_world: got an array of shape \(3,\)"),
    "per world": (still, {"per_world": jnp.zeros(N)}, "per_world: got ArrayImpl; takes a tuple of trees"),
    "part": (still, {"keep": ("extras.value",)}, "keep: got 'extras.value'; has no 'value'"),
}


@pytest.mark.parametrize(("policy", "options", "says"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes(worlds, start, policy, options, says):
    options = dict(options)
    args = options.pop("args", ())
    with pytest.raises(ValueError, match=says):
        worlds.rollout(start, policy, 1, *args, **options)
