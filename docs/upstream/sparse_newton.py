"""MuJoCo's Newton solver ends far from the minimum where its matrices are sparse; with dense ones it finds it."""

from pathlib import Path

import mujoco
import numpy as np

import maax_mjx as maax
from maax_mjx.physics import overlaid_model

GAME = maax.make("hide_and_seek_full", boxsize_obs=True, observations="ego", observe="all", impl="c").base
saved = np.load(Path(__file__).with_suffix(".npz"))
fields = {
    name: saved[f"field_{name}"].reshape(len(rows), *getattr(GAME.model, name).shape[1:])
    for name, rows in GAME.overlay.items()
}
model = overlaid_model(GAME.model, GAME.overlay, fields)


def accelerations(solver, jacobian, iterations):
    """Of the saved state, from a cold start, and how many iterations they took."""
    model.opt.solver, model.opt.jacobian, model.opt.iterations = int(solver), int(jacobian), iterations
    model.opt.tolerance = 1e-14
    data = mujoco.MjData(model)
    for name in ("qpos", "qvel", "ctrl", "eq_active"):
        getattr(data, name)[:] = saved[name]
    mujoco.mj_forward(model, data)
    return data.qacc.copy(), int(data.solver_niter[: max(data.nisland, 1)].max()), data.nefc


Solver, Jacobian = mujoco.mjtSolver, mujoco.mjtJacobian
minimum, _, n_rows = accelerations(Solver.mjSOL_CG, Jacobian.mjJAC_SPARSE, 100_000)
print(f"{model.nv} degrees of freedom, {n_rows} rows; off the minimum, which conjugate gradients find, by up to")
off = {}
for jacobian in (Jacobian.mjJAC_SPARSE, Jacobian.mjJAC_DENSE):
    found, n, _ = accelerations(Solver.mjSOL_NEWTON, jacobian, 1000)
    off[jacobian] = float(np.abs(found - minimum).max())
    amount = "more than 100" if off[jacobian] > 100 else f"{off[jacobian]:.3f}"
    print(f"  {jacobian.name}: {amount} m/s2 or rad/s2, after {n} iterations of Newton's method")
assert off[Jacobian.mjJAC_DENSE] < 0.1
assert off[Jacobian.mjJAC_SPARSE] > 100, "sparse matrices are as good now"
