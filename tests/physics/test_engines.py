"""Engines by name: a user's own, and what is refused."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.seeds import key

import maax_mjx as maax
from maax_mjx.physics import impls, overlaid_model, select
from maax_mjx.physics.c_engine import CEngine

JAM = Path(__file__).parents[2] / "docs" / "upstream" / "sparse_newton.npz"


@pytest.fixture(autouse=True)
def registry(monkeypatch):
    """A registry of its own for the test."""
    monkeypatch.setattr(select, "_ENGINES", dict(select._ENGINES))


class Halved(CEngine):
    """Half of every force."""

    def step(self, fields, data, n_frames):
        return super().step(fields, data.replace(ctrl=data.ctrl / 2), n_frames)


def make_halved(model, overlay, contacts_per_world, n_equalities):
    return Halved(model, overlay)


def test_a_users_engine_steps_the_game():
    maax.register_engine("halved", make_halved)
    assert impls() == ("auto", "c", "halved", "jax", "warp")
    moved = {}
    for impl, force in (("c", 0.5), ("halved", 1.0)):
        env = maax.make("tag", impl=impl, observations="raw", n_boxes=0, n_ramps=0)
        state = jax.jit(env.reset)(key(0))
        moved[impl] = jax.jit(env.step)(state, {"move": jnp.full((4, 3), force)}).data.qpos
    np.testing.assert_array_equal(moved["halved"], moved["c"])


def test_a_jam_is_solved_by_dense_matrices():
    """MuJoCo's own choice, sparse ones, is 1,500 m/s2 beside the minimum in this state of 60 degrees of freedom."""
    with np.load(JAM) as saved:
        given = dict(saved)
    base = maax.make("hide_and_seek_full", boxsize_obs=True, observations="ego", observe="all", impl="c").base
    fields = {
        name: given[f"field_{name}"].reshape(len(rows), *getattr(base.model, name).shape[1:])
        for name, rows in base.overlay.items()
    }
    model = overlaid_model(base.model, base.overlay, fields)
    model.opt.solver, model.opt.iterations, model.opt.tolerance = mujoco.mjtSolver.mjSOL_CG, 100_000, 1e-14
    right = mujoco.MjData(model)
    for name in ("qpos", "qvel", "ctrl", "eq_active"):
        getattr(right, name)[:] = given[name]
    mujoco.mj_step(model, right)
    data = base.engine.init(fields, given["qpos"]).replace(
        qvel=given["qvel"], ctrl=given["ctrl"], eq_active=given["eq_active"] > 0
    )
    after, _ = jax.jit(base.engine.advance, static_argnums=2)(fields, data, 1)
    np.testing.assert_allclose(after.qvel, right.qvel, atol=1e-4)


@pytest.mark.parametrize(
    ("register", "says"),
    [
        (lambda: maax.register_engine("c", make_halved), r"name: got 'c'; takes a name that is not taken"),
        (lambda: maax.register_engine("auto", make_halved), r"name: got 'auto'"),
        (lambda: maax.register_engine("mine", "engine"), r"make: got 'engine'; takes a function"),
        (lambda: maax.make("tag", impl="wrap"), "impl: got 'wrap'; did you mean 'warp'.*takes one of "),
    ],
)
def test_what_is_refused(register, says):
    with pytest.raises(ValueError, match=says):
        register()


def test_an_engine_that_is_none():
    maax.register_engine("odd", lambda *_: 3)
    env = maax.make("standard", impl="odd")
    with pytest.raises(ValueError, match="impl: the engine registered as 'odd' is 3; takes an Engine"):
        env.reset(key(0))


def test_warnings_of_mujoco_leave_no_file_and_go_to_its_logger(
    tmp_path, monkeypatch, caplog, env_c, batch_reset, batch_step
):
    """A state that MuJoCo warns about: its world is a fault, and the working directory stays empty."""
    monkeypatch.chdir(tmp_path)
    states = batch_reset(env_c, jax.random.split(key(0), 2))
    states = states.replace(data=states.data.replace(qvel=states.data.qvel.at[1].set(1e12)))
    with caplog.at_level("DEBUG", "mujoco"):
        after = batch_step(env_c, states, {"move": jnp.zeros((2, 4, 3))})
        jax.block_until_ready(after)
    assert after.metrics["physics_fault"].tolist() == [False, True]
    assert not list(tmp_path.iterdir())
    assert any("unstable" in record.message for record in caplog.records)
