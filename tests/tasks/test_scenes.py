"""Scripted agents: the game works in the physics, and the rules decide it."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from helpers import seeds

from maax_mjx.tasks import scenes, scripted

pytestmark = pytest.mark.slow

N = 16


def start(scene):
    return jax.jit(jax.vmap(scene.reset))(jax.random.split(seeds.key(0), N))


def play(scene, states):
    """The last states of 16 plays."""
    return jax.jit(jax.vmap(lambda state: scene.play(state)[0]))(states)


def test_a_seeker_catches_hiders_in_an_empty_room():
    scene = scenes.catch("c")
    last = play(scene, start(scene))
    assert not last.metrics["physics_fault"].any()
    assert (np.asarray(last.metrics["catches"]) > 0).mean() > 0.9


def test_a_locked_box_in_the_door_keeps_the_seeker_out():
    """And without it, the same seeker gets in and catches the same hider."""
    scene = scenes.closed_door("c")
    states = start(scene)
    closed = play(scene, states)
    assert closed.mechanics["locks"].locked[:, 0].all()
    assert (np.asarray(closed.metrics["boxes_locked_prep"]) == 1).mean() > 0.9
    assert not np.asarray(closed.metrics["catches"]).any()
    opened = play(scenes.closed_door("c", close=False), states)
    assert (np.asarray(opened.metrics["catches"]) > 0).mean() > 0.6, "it was 0.93 of 160"
    seeker = closed.data.xpos[:, scene.env.base.agents.body_ids[1], :2]
    door = jax.jit(jax.vmap(lambda s: scripted.quadrant_door(s, scene.env)[0]))(closed)
    assert (np.linalg.norm(seeker - door, axis=1) < 0.7).mean() > 0.9, "it did not even try"


def test_a_seeker_gets_over_the_wall_by_a_ramp():
    """With the constants of Baker et al.; without the ramp in its way, the wall stops it."""
    scene = scenes.over_the_wall("c")
    states = start(scene)
    base = scene.env.base
    last_of = jax.jit(jax.vmap(lambda state: scene.play(state)[0]))

    @jax.jit
    @jax.vmap
    def inside(state):
        return scripted.in_quadrant(state, scene.env, state.data.xpos[base.agents.body_ids[1], :2])

    away = np.array(states.data.qpos)
    away[:, base.modules["ramp"].qpos_ids[0, :2]] = [1.0, 5.0]
    data = jax.jit(jax.vmap(base.engine.pose))(states.world.fields, states.data.replace(qpos=away))
    assert np.mean(inside(last_of(states))) > 0.9
    assert not inside(last_of(states.replace(data=data))).any()
