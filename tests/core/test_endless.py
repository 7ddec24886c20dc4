"""Games without a horizon: `horizon=None`."""

from __future__ import annotations

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.toys import QUIET

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.adapters.team import OneTeam

LATE = 10**9
N = 3


class Ends(maax.Wrapper):
    """Ends the game by its rules after four steps."""

    name = "ends"

    def begin(self, key, params):
        return self.env.begin(key, params)

    def transition(self, state, action):
        state = self.env.advance(state, action)
        return state.replace(terminated=state.step == 4)


@pytest.fixture(scope="module")
def endless():
    """A game whose agents see how much time is left."""
    return maax.make("tag", impl="c", horizon=None, observations="ego", n_boxes=0, n_ramps=0, scenario="empty")


def late(env, n_steps=LATE):
    """One step from a state of long ago."""
    state = env.reset(seeds.key(0))
    return env.step(state.replace(step=jnp.int32(n_steps)), env.sample_action(seeds.key(1)))


def test_time_alone_ends_no_episode(endless):
    assert endless.base.horizon is None
    after = late(endless)
    assert not after.done
    np.testing.assert_array_equal(after.obs["time_left"], 1.0)
    timed = maax.make("tag", endless.made.config, horizon=LATE)
    assert late(timed).truncated
    np.testing.assert_array_equal(late(timed).obs["time_left"], 0.0)
    # Nothing else differs.
    np.testing.assert_array_equal(late(timed, 5).data.qpos, late(endless, 5).data.qpos)


def test_a_fault_cuts_it_off(endless):
    state = endless.reset(seeds.key(0))
    above = jnp.asarray(state.data.qpos).at[endless.base.agents.qpos_ids[0, 2]].set(9.0)
    broken = endless.step(state.replace(data=state.data.replace(qpos=above)), endless.sample_action(seeds.key(1)))
    assert broken.truncated
    assert broken.metrics["physics_fault"]


def test_batches_begin_anew_where_the_rules_end_a_game():
    env = Ends(maax.make("standard", impl="c", horizon=None, n_hiders=1, n_seekers=1, **QUIET))
    worlds = maax.Worlds(env, N, donate=False)
    states = worlds.reset(seeds.key(0))
    first = np.asarray(states.data.qpos)
    for t in range(1, 9):
        states = worlds.step(states, worlds.sample_action(jax.random.key(t)))
        np.testing.assert_array_equal(states.terminated, t % 4 == 0)
        np.testing.assert_array_equal(states.step, t % 4)
        assert not np.asarray(states.truncated).any()
    assert states.totals()["episodes"] == 2 * N
    assert np.abs(np.asarray(states.data.qpos) - first).max() > 0.1
    with pytest.raises(ValueError, match=r"^stagger: got True with horizon=None; takes False"):
        worlds.reset(seeds.key(0), stagger=True)


def test_preparation_takes_no_share_of_it():
    with pytest.raises(ValueError, match=r"^prep_fraction: got 0.4 with horizon=None; takes 0 there"):
        maax.make("hide_and_seek", impl="c", horizon=None)
    env = maax.make("hide_and_seek", impl="c", horizon=None, prep_fraction=0)
    assert env.inner(maax.PreparationPhase).n_steps == 0


def test_other_libraries_are_told_of_faults(endless):
    of = OneTeam(endless)
    inside = of.begin(seeds.key(0))
    state = inside.state.replace(step=jnp.int32(LATE))
    for truncated in (False, True):
        assert of.done(inside._replace(state=state.replace(truncated=jnp.asarray(truncated)))) == float(truncated)


@pytest.mark.slow
def test_the_contract(endless):
    maax.testing.check_env(endless, n_steps=2)


@pytest.mark.slow
def test_training_goes_on_without_ends(endless, tmp_path):
    """Two iterations with finite numbers; what needs episodes is refused."""
    tiny = {"ppo.unroll": 4, "ppo.chunk": 4, "ppo.minibatches": 1, "ppo.epochs": 1, "net.hidden": 8, "net.core": "none"}
    tiny |= {"net.encoder": "flat", "league.share": 0.0}
    with pytest.raises(ValueError, match=r"^ppo.bootstrap: got 'horizon' for a game with horizon=None; takes 'end'"):
        training.Trainer(endless, tmp_path / "no", "laptop", 8, **tiny, **{"ppo.bootstrap": "horizon"})
    trainer = training.Trainer(endless, tmp_path / "run", "laptop", 8, **tiny)
    done = trainer.run(steps=2 * 4 * 8)
    assert trainer.states.totals()["episodes"] == 0
    rows = [json.loads(line) for line in (done.folder / "metrics.jsonl").read_text().splitlines()]
    assert len(rows) == 2
    assert np.isfinite([x for row in rows for x in row.values() if isinstance(x, float)]).all()
    assert done.policy.make_env().base.horizon is None
    with pytest.raises(ValueError, match=r"^env: got an endless game, horizon=None; takes one with a horizon"):
        training.evaluate(done.policy, episodes=2)
