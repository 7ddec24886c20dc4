"""`Worlds`: automatic resets, a layout of its own for every episode, and worlds that do not know of each other."""

from __future__ import annotations

from collections import Counter
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

from maax_mjx import Agents, Base, Boxes, State, WallScenarios, Worlds, WorldsState, to_mjcf
from maax_mjx.parallel.memory import check_memory
from maax_mjx.parallel.shards import Shards

N, FEW, HORIZON = 24, 12, 5
STEPS = 3 * HORIZON
STATE_FIELDS = tuple(State.__dataclass_fields__)
BEGINNING = ("obs", "world", "params", "step", "key", "data")


class Paid(Base):
    """Agents get 1, 2, ... per step, a world ends when its first agent turns with full torque; traces are counted."""

    def __init__(self, n_agents, horizon, *modules):
        super().__init__(n_agents, horizon=horizon, impl="c")
        self.traces = Counter()
        for module in (WallScenarios("quad"), Agents(n_agents), *modules):
            self.add_module(module)

    def begin(self, key, params):
        self.traces["reset"] += 1
        return super().begin(key, params)

    def transition(self, state, action):
        self.traces["step"] += 1
        state = super().transition(state, action)
        reward = state.reward + jnp.arange(1.0, self.n_agents + 1)
        return state.replace(reward=reward, terminated=action["move"][0, 2] == 1.0)


def host(tree):
    """A copy on the host, keys as their data, so that donation cannot reach it."""

    def copy(x):
        return np.array(jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x)

    return jax.tree.map(copy, tree)


def assert_equal(got, expected, rounding=0.0):
    """Whole numbers and bools exactly, floats but for the rounding between one program and another."""
    for (path, a), (_, b) in zip(*map(jax.tree.leaves_with_path, (got, expected)), strict=True):
        tol = rounding if a.dtype.kind == "f" else 0.0
        np.testing.assert_allclose(a, b, rtol=tol, atol=tol, err_msg=jax.tree_util.keystr(path))


assert_close = partial(assert_equal, rounding=2e-6)


def single(states):
    return State(**{name: getattr(states, name) for name in STATE_FIELDS})


def outcome(states):
    """All that becomes of the worlds. What is drawn ahead, and when, is a matter of the whole batch."""
    sums = {name: getattr(states, name) for name in ("final_obs", "episode_return", "episode_length", "counts", "seed")}
    return {"state": single(states), **sums}


def play(worlds, states, moves):
    """The states, before the first step and after each, on the host."""
    history = [host(states)]
    for move in moves:
        states = worlds.step(states, {"move": move})
        history.append(host(states))
    return history


def episode_keys(key, n, episode):
    """The keys of the given episode (n,) of every world, as `Worlds` promises them."""
    seeds = jax.vmap(lambda i: jax.random.fold_in(key, i))(jnp.arange(n))
    return jax.vmap(jax.random.fold_in)(seeds, jnp.asarray(episode))


def layouts(state):
    """One row per world: initial configuration and walls."""
    fields = state.world.fields["geom_pos"], state.world.fields["geom_size"]
    return np.concatenate([np.reshape(x, (len(x), np.prod(x.shape[1:]))) for x in (state.data.qpos, *fields)], axis=1)


def n_boxes(states):
    return np.asarray(states.obs["box_mask"]).sum(axis=1)


@pytest.fixture(scope="module")
def env():
    return Paid(2, HORIZON, Boxes((0, 2)))


@pytest.fixture(scope="module")
def many(env):
    return Worlds(env, N)


@pytest.fixture(scope="module")
def few(env):
    return Worlds(env, FEW, donate=False)


@pytest.fixture(scope="module")
def moves():
    """(T, N, 2, 3): two horizons with ends here and there, then one in which a third of all worlds ends each step."""
    rng = seeds.rng(0)
    moves = rng.uniform(-0.5, 0.5, (STEPS, N, 2, 3)).astype(np.float32)
    ends = rng.random((STEPS, N)) < np.where(np.arange(STEPS) < 2 * HORIZON, 0.05, 0.35)[:, None]
    ends[HORIZON - 1] = False
    moves[..., 0, 2] = np.where(ends, 1.0, moves[..., 0, 2])
    return moves


@pytest.fixture(scope="module")
def run(many, moves):
    key = seeds.key(7)
    return SimpleNamespace(key=key, history=play(many, many.reset(key), moves))


@pytest.fixture(scope="module")
def reference(env, run, moves, batch_reset, batch_step):
    """What every step of the run has to be, from single-world functions: (stepped, next episode's first state)."""
    out = []
    for before, move in zip(run.history, moves, strict=False):
        state = single(before).replace(key=jax.random.wrap_key_data(before.key))
        stepped = batch_step(env, state, {"move": move})
        begun = batch_reset(env, episode_keys(run.key, N, before.counts["episodes"] + 1))
        out.append((host(stepped), host(begun)))
    return out


def where(mask, tree):
    return jax.tree.map(lambda x: x[mask], tree)


def test_ends_lengths_returns_and_counts(run, moves):
    age, length, episodes = (np.zeros(N, int) for _ in range(3))
    total = 0
    for states, move in zip(run.history[1:], moves, strict=True):
        age, length = age + 1, length + 1
        terminated, truncated = move[:, 0, 2] == 1.0, age == HORIZON
        done = terminated | truncated
        episodes, total = episodes + done, total + done.sum()
        np.testing.assert_array_equal(states.terminated, terminated)
        np.testing.assert_array_equal(states.truncated, truncated)
        np.testing.assert_array_equal(states.reward, np.tile([1.0, 2.0], (N, 1)))
        np.testing.assert_array_equal(states.episode_length, length)
        np.testing.assert_array_equal(states.episode_return, length[:, None] * [1.0, 2.0])
        np.testing.assert_array_equal(states.counts["episodes"], episodes)
        age, length = np.where(done, 0, age), np.where(done, 0, length)
        np.testing.assert_array_equal(states.step, age)
        assert not states.metrics["physics_fault"].any()
    assert total > 2 * N, "more ends than horizons"


def test_a_step_ends_as_the_single_world_step_does(run, reference):
    for states, (stepped, _) in zip(run.history[1:], reference, strict=True):
        done, ending = stepped.done, ("reward", "terminated", "truncated", "metrics")
        assert_close({k: getattr(states, k) for k in ending}, {k: getattr(stepped, k) for k in ending})
        assert_close(states.final_obs, stepped.obs)
        assert_equal(where(~done, states.obs), where(~done, states.final_obs))
        assert_close(where(~done, single(states)), where(~done, stepped))
        moved = np.abs(states.obs["agent_pos"] - states.final_obs["agent_pos"]).max(axis=(1, 2))
        assert (moved[done] > 0).all()


def test_episodes_begin_as_the_single_world_reset_does(env, run, reference, batch_reset):
    first = run.history[0]
    assert_close(single(first), host(batch_reset(env, episode_keys(run.key, N, np.zeros(N, int)))))
    assert_equal(first.obs, first.final_obs)
    assert not first.episode_length.any()
    for states, (stepped, begun) in zip(run.history[1:], reference, strict=True):
        done = stepped.done
        for name in BEGINNING:
            assert_close(where(done, getattr(states, name)), where(done, getattr(begun, name)))


def test_every_episode_of_every_world_has_its_own_layout(run):
    seen = [layouts(run.history[0])]
    seen += [layouts(where(s.terminated | s.truncated, single(s))) for s in run.history[1:]]
    seen = np.concatenate(seen)
    assert len(np.unique(seen, axis=0)) == len(seen) > 3 * N
    doors = np.concatenate([s.world.plan.doors.reshape(N, -1) for s in run.history])
    assert len(np.unique(doors, axis=0)) > N


@pytest.mark.parametrize("staggered", [False, True])
def test_a_world_does_not_depend_on_the_others(many, few, moves, run, staggered):
    others = moves.copy()
    others[:, FEW:] = -others[:, FEW:]
    others[::2, FEW::2, 0, 2] = 1.0
    ages = np.concatenate([np.arange(FEW) % HORIZON, np.arange(FEW) * 3 % HORIZON]).astype(np.int32)

    def begin(worlds):
        states = worlds.reset(run.key)
        return states.replace(step=jnp.asarray(ages[: worlds.n_worlds])) if staggered else states

    alone = play(few, begin(few), moves[:, :FEW])
    for crowd in (play(many, begin(many), moves), play(many, begin(many), others)):
        for a, b in zip(alone, crowd, strict=True):
            assert_equal(outcome(a), where(slice(FEW), outcome(b)))
    assert alone[-1].counts["episodes"].min() >= 3


def test_the_same_key_gives_the_same_trajectory(many, moves, run):
    assert_equal(play(many, many.reset(run.key), moves), run.history)
    first = layouts(many.reset(seeds.key(8)))
    assert not (first == layouts(run.history[0])).all(axis=1).any()


def test_undonated_states_may_be_used_again(few, moves, run):
    states = few.reset(run.key)
    before = host(states)
    once = host(few.step(states, {"move": moves[0, :FEW]}))
    few.step(states, {"move": moves[1, :FEW]})
    assert_equal(host(few.step(states, {"move": moves[0, :FEW]})), once)
    assert_equal(host(states), before)


def test_the_states_keep_their_shape(few, run):
    states = few.reset(run.key)
    assert isinstance(states, WorldsState)
    after = few.step(states, few.sample_action(run.key))
    for x in (after, few.with_params(after, few.env.default_params)):
        assert jax.tree.structure(x) == jax.tree.structure(states)
        kinds = [[(v.shape, v.dtype, getattr(v, "weak_type", False)) for v in jax.tree.leaves(t)] for t in (x, states)]
        assert kinds[0] == kinds[1]
    assert {v.shape[0] for v in jax.tree.leaves(after)} == {FEW}


@pytest.fixture(scope="module")
def brief():
    """`brief(horizon)`: worlds of one agent without boxes."""
    made = {}
    return lambda horizon: made.setdefault(horizon, Worlds(Paid(1, horizon), N, donate=False))


@pytest.fixture(scope="module")
def rollout(brief):
    """A whole rollout as one compiled program."""
    worlds = brief(2)

    def body(states, move):
        states = worlds.step_fn(states, {"move": move})
        return states, (outcome(states), states.metrics)

    return worlds, jax.jit(lambda states, moves: jax.lax.scan(body, states, moves))


@pytest.mark.slow
def test_scan_equals_the_loop(rollout, moves, run):
    worlds, scan = rollout
    moves = moves[:, :, :1]
    last, (outcomes, _) = host(scan(worlds.reset(run.key), moves))
    history = play(worlds, worlds.reset(run.key), moves)
    assert_close(last, history[-1])
    for t, states in enumerate(history[1:]):
        assert_close(where(t, outcomes), outcome(states))


def test_nan_in_a_compiled_rollout_ends_that_world_only(rollout, moves, run):
    worlds, scan = rollout
    moves = np.minimum(moves[:, :, :1], 0.5)
    clean, (clean_outcomes, _) = host(scan(worlds.reset(run.key), moves))
    moves[2, 4, 0, 0] = np.nan
    last, (outcomes, metrics) = host(scan(worlds.reset(run.key), moves))
    assert np.argwhere(metrics["physics_fault"]).tolist() == [[2, 4]]
    assert outcomes["state"].truncated[2].tolist() == [i == 4 for i in range(N)]
    assert outcomes["state"].truncated[3].tolist() == [i != 4 for i in range(N)]
    assert last.counts["physics_fault"].tolist() == [int(i == 4) for i in range(N)]
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(outcomes))
    rest = np.arange(N) != 4
    assert_equal(where((slice(None), rest), outcomes), where((slice(None), rest), clean_outcomes))
    assert not clean.counts["physics_fault"].any()


def test_nothing_is_compiled_or_traced_again(env, few, run, moves, caplog):
    params = few.env.default_params
    few.step(few.reset(run.key), {"move": moves[0, :FEW]})
    traces = Counter(env.traces)
    assert min(traces["reset"], traces["step"]) > 0

    def use(seed, low, high):
        each = jax.tree.map(lambda x: jnp.tile(x, (FEW, 1)), params).replace(n_boxes=[[low, high]] * FEW)
        for new, stagger in ((None, False), (params.replace(n_boxes=(low, high)), True), (each, False)):
            states = few.reset(seeds.key(seed), new, stagger=stagger)
            for t, move in enumerate(moves[:, :FEW]):
                states = few.step(states, {"move": move + seed / 100 if t % 2 else jnp.asarray(move)})
                if t % 4 == 3:
                    states = few.with_params(states, each if t == 7 else params.replace(n_boxes=high))
            assert states.counts["episodes"].min() >= 2
            assert env.traces == traces

    def compiled(call, *args):
        caplog.clear()
        with jax.log_compiles():
            call(*args)
        return [r.getMessage() for r in caplog.records if r.getMessage().startswith("Compiling")]

    assert compiled(jax.jit(lambda x: x + 1), jnp.ones(3))  # compiling is seen
    use(1, 0, 1)
    assert compiled(use, 2, 1, 2) == []


def test_with_params_holds_from_the_next_episode_on(few, moves, run, batch_reset):
    states = few.reset(run.key)
    assert len(set(n_boxes(states).tolist())) > 1
    begun, params = n_boxes(states), few.env.default_params
    states = few.with_params(states, params.replace(n_boxes=(2, 2)))
    fresh = np.zeros(FEW, bool)
    for move in moves[: 2 * HORIZON, :FEW]:
        states = few.step(states, {"move": move})
        fresh |= np.asarray(states.done)
        np.testing.assert_array_equal(n_boxes(states), np.where(fresh, 2, begun))
    assert fresh.all()
    assert states.params["n_boxes"].tolist() == [[2, 2]] * FEW
    # The old ranges again, on the way to which a world drawn ahead under the others must not come into play.
    states = few.with_params(states, params)
    episode = np.asarray(states.counts["episodes"]) + 1
    expected = n_boxes(batch_reset(few.env, episode_keys(run.key, N, np.resize(episode, N))))[:FEW]
    assert (expected != 2).any()
    for move in moves[:HORIZON, :FEW]:
        states = few.step(states, {"move": move})
        first = np.asarray(states.done & (states.counts["episodes"] == episode))
        np.testing.assert_array_equal(n_boxes(states)[first], expected[first])


def test_params_per_world(few, moves, run):
    counts = np.arange(FEW) % 3
    each = jax.tree.map(lambda x: jnp.tile(x, (FEW, 1)), few.env.default_params)
    each = each.replace(n_boxes=np.stack([counts, counts], axis=1))
    states = few.reset(run.key, each)
    for move in moves[: HORIZON + 1, :FEW]:
        np.testing.assert_array_equal(n_boxes(states), counts)
        states = few.step(states, {"move": move})
    np.testing.assert_array_equal(n_boxes(states), counts)
    states = few.with_params(states, each.replace(n_boxes=np.stack([2 - counts, 2 - counts], axis=1)))
    for _ in range(HORIZON):
        states = few.step(states, {"move": np.zeros((FEW, 2, 3), np.float32)})
    np.testing.assert_array_equal(n_boxes(states), 2 - counts)


def test_stagger_spreads_the_ends(many, run):
    still = np.zeros((2 * HORIZON, N, 2, 3), np.float32)
    lockstep, spread = (play(many, many.reset(run.key, stagger=s), still) for s in (False, True))
    assert [int(s.truncated.sum()) for s in lockstep[1:]] == [0, 0, 0, 0, N] * 2
    ends = np.stack([s.truncated for s in spread[1:]])
    assert np.ptp(ends.sum(axis=1)) <= 1
    assert (ends[:HORIZON].sum(axis=0) == 1).all()
    np.testing.assert_array_equal(ends[:HORIZON], ends[HORIZON:])
    assert_equal(spread[0].obs, lockstep[0].obs)
    for t, states in enumerate(spread[1 : HORIZON + 1]):
        assert (states.episode_length[ends[t]] == t + 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [1, 2])
def test_all_worlds_at_once_when_nothing_is_drawn_ahead(brief, horizon, batch_reset):
    worlds, key = brief(horizon), seeds.key(11)
    history = play(worlds, worlds.reset(key), np.zeros((4 * horizon, N, 1, 3), np.float32))
    seen = []
    for k, states in enumerate(history[::horizon]):
        expected = host(batch_reset(brief(2).env, episode_keys(key, N, np.full(N, k))))
        for name in BEGINNING:
            assert_close(getattr(states, name), getattr(expected, name))
        assert (states.counts["episodes"] == k).all()
        assert k == 0 or states.truncated.all()
        seen.append(layouts(states))
    seen = np.concatenate(seen)
    assert len(np.unique(seen, axis=0)) == len(seen)


def test_states_from_the_host_go_on(few, run):
    """As a checkpoint restores them."""
    states, action = few.reset(run.key), few.sample_action(run.key)
    restored = jax.tree.map(
        lambda x: x if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key) else np.asarray(x), states
    )
    np.testing.assert_array_equal(few.step(restored, action).data.qpos, few.step(states, action).data.qpos)


def test_donated_states_are_refused_everywhere(many, run):
    states, action = many.reset(run.key), many.sample_action(run.key)
    many.step(states, action)
    for use in (lambda: many.step(states, action), lambda: to_mjcf(many.env, states, 0)):
        with pytest.raises(RuntimeError, match=r"donated to an earlier Worlds\.step"):
            use()


def test_a_step_within_compiled_code_is_the_same(few, run):
    """There JAX takes no compiler options."""
    states, action = few.reset(run.key), few.sample_action(run.key)
    within = jax.jit(lambda states, action: few.step(states, action))(states, action)
    assert_close(host(within), host(few.step(states, action)))


def test_worlds_that_would_fill_the_memory_are_refused_before_they_are_made(env):
    with pytest.raises(ValueError, match=r"n_worlds: got 2,000,000,000; takes fewer than [\d,]+: states of"):
        Worlds(env, 2_000_000_000)


def test_memory_is_that_of_all_devices_of_which_a_process_asks_its_own(env):
    def of_another():
        raise RuntimeError("not of this process")

    other = SimpleNamespace(process_index=1, platform="gpu", memory_stats=of_another)
    own = SimpleNamespace(process_index=0, platform="gpu", memory_stats=lambda: {"bytes_limit": 10**9})
    check_memory("n_worlds", env, 1_000, [other, own])
    with pytest.raises(ValueError, match="would fill the memory of 2 GB"):
        check_memory("n_worlds", env, 10**8, [other, own])


@pytest.mark.parametrize("method", ["jit", "shard_map"])
def test_what_is_donated_is_replaced_in_its_own_place(method):
    """Read or not: an output in the memory of another array would have to wait for a copy of that."""
    step = Shards(4, method=method).compile(lambda _, x: {"new": 2 * x["old"], "old": x["old"]}, (0,), donate=(0,))
    index = step.args[0]
    program = step.func.lower(index, {"new": jnp.zeros(4), "old": jnp.ones(4)}).compile().as_text()
    assert "copy(" not in program
    assert program.count("may-alias") == 2
