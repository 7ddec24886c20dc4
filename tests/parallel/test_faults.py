"""Worlds with faults are kept with what led there, and their last step can be made again and looked at."""

from __future__ import annotations

import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import maax_mjx as maax
from maax_mjx.cli import main
from maax_mjx.core.faults import astray
from maax_mjx.parallel import faults

GAME = {"n_boxes": 1, "n_ramps": 0, "scenario": "empty", "impl": "c"}
N, ASTRAY = 6, 4


def thrown(env, states, world):
    """The states with one world's first agent about to leave the arena at 2,000 m/s."""
    velocity = states.data.qvel.at[world, env.base.agents.qvel_ids[0, 0]].set(2e3)
    return states.replace(data=states.data.replace(qvel=velocity))


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Worlds of which one went astray in its fifth step, and the folder of it."""
    folder = tmp_path_factory.mktemp("kept") / "faults"
    env = maax.make("tag", **GAME)
    worlds = maax.Worlds(env, N, keep_faults=folder)
    states = worlds.reset(jax.random.key(3))
    seen = []
    for i in range(5):
        action = worlds.sample_action(jax.random.key(i))
        states = thrown(env, states, ASTRAY) if i == 4 else states
        seen.append(jax.device_get((states.data.qpos[ASTRAY], action)))
        states = worlds.step(states, action)
    return worlds, states, seen


def test_the_last_states_and_actions_are_kept(kept):
    worlds, states, seen = kept
    (file,) = worlds.faults()
    assert file.name == "0.npz"
    fault = maax.load_fault(file, worlds.env)
    assert fault.about == {"world": ASTRAY, "episode": 0, "step": 4, "engine": "c"}
    np.testing.assert_array_equal(fault.recording.states.step[:, 0], range(5))
    np.testing.assert_array_equal(fault.recording.states.data.qpos[:, 0], [qpos for qpos, _ in seen])
    for name, actions in fault.actions.items():
        np.testing.assert_array_equal(actions, [action[name][ASTRAY] for _, action in seen])
    assert bool(states.metrics["physics_fault"][ASTRAY])


def test_its_last_step_goes_astray_again(kept):
    worlds, *_ = kept
    fault = maax.load_fault(worlds.faults()[0], worlds.env)
    assert bool(worlds.env.step(fault.state, fault.action_at()).metrics["physics_fault"])
    found = fault.diagnose()
    assert found.fault
    assert len(found.moments) == worlds.env.base.n_frames + 1
    assert found.moments[found.first].astray == ["player_0"]
    text = str(found)
    assert "player_0 is" in text
    assert "m outside of the arena" in text
    assert "player_0 was the fastest, with" in text


def test_what_is_shown_is_what_the_step_does(kept):
    """Of a step without a fault: the last of the physics steps is where the step ends."""
    worlds, *_ = kept
    env = worlds.env
    state = env.reset(jax.random.key(8))
    action = env.sample_action(jax.random.key(9))
    found = maax.diagnose(env, state, action)
    after = env.step(state, action)
    assert found.first is None
    assert "nothing went astray" in str(found)
    assert not found.fault
    ends = np.asarray(after.data.qpos)[env.base.position_ids]
    np.testing.assert_array_equal(list(found.moments[-1].position.values()), ends)
    starts = np.asarray(state.data.qpos)[env.base.position_ids]
    np.testing.assert_array_equal(list(found.moments[0].position.values()), starts)


def test_states_before_step_as_they_did(kept):
    """From every frame the kept action leads to the next one, to the rounding that the engine no longer carries."""
    worlds, *_ = kept
    fault = maax.load_fault(worlds.faults()[0], worlds.env)
    for i in range(3):
        after = worlds.env.step(fault.state_at(i), fault.action_at(i))
        np.testing.assert_allclose(after.data.qpos, fault.recording.states.data.qpos[i + 1, 0], atol=1e-5)
    assert fault.diagnose(-3).first is None
    with pytest.raises(ValueError, match="moment: got 5; takes an index of one of the 5 frames"):
        fault.state_at(5)


def test_contacts_and_equalities_are_named(kept):
    """A box pushed 2 cm into an agent by hand: 2 cm deep, whichever way the engine gets it out."""
    env = maax.make("tag", **GAME)
    state = env.reset(jax.random.key(8))
    base, qpos = env.base, np.array(state.data.qpos)
    box, agent = base.modules["box"], base.agents
    radius = base.model.geom_size[agent.geom_ids[0], 0] + base.model.geom_size[box.geom_ids[0], 0]
    qpos[agent.qpos_ids[0, :2]] = qpos[box.qpos_ids[0, :2]] - [radius - 0.02, 0]
    qpos[box.qpos_ids[0, 3]] = 0
    found = maax.diagnose(
        env, state.replace(data=state.data.replace(qpos=jnp.asarray(qpos))), env.sample_action(jax.random.key(0))
    )
    first = {frozenset(pair[:2]): pair[2] for pair in found.moments[0].deep}
    assert first[frozenset(("player_0", "box0"))] == pytest.approx(0.02, abs=2e-3)


def test_plain_mujoco_loads_the_world(kept):
    worlds, *_ = kept
    fault = maax.load_fault(worlds.faults()[0], worlds.env)
    model = mujoco.MjModel.from_xml_path(str(worlds.faults()[0].with_suffix(".xml")))
    np.testing.assert_allclose(model.key_qpos[0], fault.state.data.qpos, rtol=1e-6)


def test_other_worlds_files_and_states_are_refused(kept, tmp_path):
    worlds, states, _ = kept
    plain = maax.Worlds(worlds.env, N)
    with pytest.raises(ValueError, match=r"states: got those of worlds with keep_faults for worlds without"):
        plain.step(states, plain.sample_action(jax.random.key(0)))
    assert plain.remembering(states).recent == ()
    again = worlds.remembering(plain.remembering(states))
    assert jax.tree.map(jnp.shape, again) == jax.tree.map(jnp.shape, states)
    with pytest.raises(ValueError, match="keep_faults: got None for these worlds"):
        plain.faults()
    with pytest.raises(ValueError, match="keep_faults: got 3; takes a folder"):
        maax.Worlds(worlds.env, N, keep_faults=3)
    with pytest.raises(ValueError, match="which is not there; takes a file of keep_faults"):
        maax.load_fault(tmp_path / "9.npz", worlds.env)
    with pytest.raises(ValueError, match=r"env: got standard\(impl='c'\), and .*0.npz is of tag; takes the env"):
        maax.load_fault(worlds.faults()[0], maax.make("standard", impl="c"))
    state = worlds.env.reset(jax.random.key(0))
    for action, said in ((None, "takes"), (jnp.zeros((4, 3)), "takes"), ({}, "takes")):
        with pytest.raises(ValueError, match=said):
            maax.diagnose(worlds.env, state, action)
    for other in ({"n_boxes": 2}, {"world_params.gravity": -1.0}):
        (name,) = other
        with pytest.raises(ValueError, match=rf"env: got another one than .*0.npz is of, env.{name}=.*; takes the env"):
            maax.load_fault(worlds.faults()[0], maax.make("tag", **GAME | other))


def test_there_is_an_end_to_them(kept, tmp_path, monkeypatch):
    """All worlds astray in every step: as many files as there may be, those of an earlier run counted."""
    monkeypatch.setattr(faults, "MOST", 3)
    env = kept[0].env
    worlds = maax.Worlds(env, N, keep_faults=tmp_path)
    (tmp_path / "1.npz").write_bytes(b"of an earlier run")
    worlds = maax.Worlds(env, N, keep_faults=tmp_path)

    def policy(state, key, throw):
        return {**env.sample_action(key), "move": jnp.where(throw, jnp.nan, jnp.zeros((env.n_agents, 3)))}

    worlds.rollout(worlds.reset(jax.random.key(0)), policy, 4, jnp.asarray(True))
    assert [file.name for file in worlds.faults()] == ["1.npz", "2.npz"]


def test_the_shell_says_what_went_wrong(kept, tmp_path, capsys):
    worlds, *_ = kept
    (file,) = worlds.faults()
    main(["info", str(file), "--json"])
    told = json.loads(capsys.readouterr().out)
    assert (told["world"], told["step"], told["fault again"]) == (str(ASTRAY), "4", "yes")
    assert told["game"].startswith("tag(")
    assert "player_0 is" in told["about"]
    main(["replay", str(file), "--out", str(tmp_path / "fault.png"), "--view", "plan"])
    assert (tmp_path / "fault.png").stat().st_size > 1000
    for words, said in (
        (["info", str(tmp_path / "none.npz")], "which is not there"),
        (["info", "tagg"], "did you mean 'tag'"),
    ):
        with pytest.raises(SystemExit):
            main(words)
        assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("place", "closed", "wrong"),
    [
        ((-0.24, 3, 0.2), True, True),  # where a trained hider stood behind the outer wall
        ((3, 6.24, 0.2), True, True),
        ((-0.1, 3, 0.2), True, False),
        ((-0.24, 3, 0.2), False, False),
        ((3, 3, -0.24), False, True),
    ],
)
def test_behind_the_outer_wall_is_astray(place, closed, wrong):
    plan = SimpleNamespace(floor_size=jnp.float32(6), closed=jnp.bool_(closed))
    assert bool(astray(plan, jnp.float32([place]), np.array([True]))[0]) is wrong
