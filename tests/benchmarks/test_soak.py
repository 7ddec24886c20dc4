"""Soaks of trained agents: what is counted, and that a run in pieces comes to the same as one."""

from __future__ import annotations

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import maax_mjx as maax
from maax_mjx.benchmarks import soak
from maax_mjx.wrappers.grabs.wrapper import GrabObjects


@pytest.fixture(scope="module")
def worlds():
    return maax.Worlds(maax.make("hide_and_seek_quadrant", impl="c"), 4)


def test_what_agents_do_is_told_by_height_and_grabs(worlds):
    """One world each: as it begins, an agent lifted, an agent that holds a box, and both; an absent one counts not."""
    states = worlds.reset(jax.random.key(0))
    agents, grabs = worlds.env.base.agents, states.mechanics[GrabObjects.name]
    assert (np.asarray(grabs.held) == -1).all()
    height = states.data.xpos.at[jnp.array([1, 3]), agents.body_ids[0], 2].set(0.9)
    held = grabs.held.at[2:, 1].set(0)
    mechanics = dict(states.mechanics) | {GrabObjects.name: grabs.replace(held=held)}
    states = states.replace(data=states.data.replace(xpos=height), mechanics=mechanics)
    nothing, up, holds = [False, False, True], [True, False, False], [False, True, False]
    assert np.asarray(soak.doing(worlds.env, states)).tolist() == [nothing, up, holds, up]
    absent = states.world.active[agents.kind].at[1, 0].set(False)
    there = dict(states.world.active) | {agents.kind: absent}
    states = states.replace(world=states.world.replace(active=there))
    assert np.asarray(soak.doing(worlds.env, states))[1].tolist() == nothing


@pytest.mark.slow
@pytest.mark.usefixtures("made_once")
def test_trained_agents_play_on_from_where_they_were(tmp_path):
    """Two runs of ten steps are one of twenty: steps by what agents did, worlds, and memories of the networks."""

    def play(name, steps):
        options = {"folder": tmp_path / name, "out": tmp_path / f"{name}.json", "chunk": 10, "every": 1}
        soak.main(
            soak.Config(policy="quadrant/forts", impl="c", worlds=4, physics_steps=float(4 * 15 * steps), **options)
        )
        return json.loads((tmp_path / f"{name}.json").read_text())["rows"][0]

    play("pieces", 10)
    pieces, alone = play("pieces", 20), play("alone", 20)
    assert (pieces["runs"], alone["runs"]) == (2, 1)
    assert (pieces["env"], pieces["policy"], pieces["held"]) == ("hide_and_seek_quadrant", "quadrant/forts", 0)
    assert pieces["by_doing"] == alone["by_doing"]
    assert sum(did["physics_steps"] for did in alone["by_doing"].values()) == alone["physics_steps"] == 4 * 15 * 20
    assert alone["by_doing"]["holding something"]["physics_steps"] > 0
    memories = [_memory(tmp_path / name) for name in ("pieces", "alone")]
    np.testing.assert_array_equal(*memories)
    assert np.abs(memories[0]).max() > 0


def _memory(folder):
    policy = maax.training.Policy.load("quadrant/forts")
    worlds = maax.Worlds(policy.make_env(impl="c"), 4)
    memory = policy.on(worlds.env).memory(4)
    runs = jnp.zeros((), int)
    others = maax.Checkpoints(folder).restore(worlds, tally=soak.Tally.nothing(), memory=memory, runs=runs)
    return np.asarray(others[1]["memory"])
