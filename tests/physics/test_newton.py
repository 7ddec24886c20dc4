"""The solver of the jax engine against SciPy's, on problems drawn at random."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from mujoco import mjx
from scipy.optimize import minimize

from maax_mjx.physics import newton

N = 24
WORLD = """
<mujoco>
  <option solver="Newton" iterations="20" ls_iterations="{ls_iterations}" cone="{cone}" integrator="{integrator}"/>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="a" pos="0 0 1"><freejoint/><geom size=".1" mass="2"/></body>
    <body name="b" pos="0 1 1"><freejoint/><geom size=".1"/></body>
    <body name="c" pos="1 0 1"><joint axis="1 0 0" frictionloss="{loss}"/><geom size=".1" pos=".3 0 0"/></body>
  </worldbody>
  <equality><connect body1="a" body2="b" anchor="0 .5 0"/></equality>
</mujoco>
"""


def model(loss=0.0, cone="pyramidal", integrator="Euler", ls_iterations=20):
    text = WORLD.format(loss=loss, cone=cone, integrator=integrator, ls_iterations=ls_iterations)
    return mujoco.MjModel.from_xml_string(text)


def problems(data):
    """N random problems of this size: rows, their weights and references, and forces without them."""
    rng = seeds.rng(0)
    rows, nv = data._impl.efc_J.shape
    half = rng.normal(size=(N, nv, nv))
    inertia = half @ half.transpose(0, 2, 1) / nv + np.eye(nv)
    force = rng.normal(size=(N, nv)) * 10
    drawn = {
        "rows": rng.normal(size=(N, rows, nv)) * (rng.random((N, rows, 1)) < 0.7),
        "weight": np.exp(rng.uniform(-1, 5, (N, rows))),
        "reference": rng.normal(size=(N, rows)) * 20,
        "inertia": inertia,
        "force": force,
        "free": np.linalg.solve(inertia, force[..., None])[..., 0],
        "warm": rng.normal(size=(N, nv)) * 10,
    }
    return {name: value.astype(np.float32) for name, value in drawn.items()}


def with_problem(data, p):
    impl = data._impl.replace(efc_J=p["rows"], efc_D=p["weight"], efc_aref=p["reference"], M=p["inertia"])
    return data.replace(_impl=impl, qfrc_smooth=p["force"], qacc_smooth=p["free"], qacc_warmstart=p["warm"])


def minimum(p, n_equalities):
    """SciPy's, in float64: the accelerations and their cost, and the cost of others."""
    p = {name: value.astype(float) for name, value in p.items()}
    always = np.arange(len(p["weight"])) < n_equalities

    def parts(qacc):
        jar = p["rows"] @ qacc - p["reference"]
        return np.where((jar < 0) | always, jar, 0), p["inertia"] @ qacc - p["force"]

    def cost(qacc):
        pushed, excess = parts(qacc)
        return 0.5 * (p["weight"] * pushed**2).sum() + 0.5 * excess @ (qacc - p["free"])

    def gradient(qacc):
        pushed, excess = parts(qacc)
        return excess + p["rows"].T @ (p["weight"] * pushed)

    found = minimize(cost, p["free"], jac=gradient, method="BFGS", options={"gtol": 1e-7, "maxiter": 2000})
    return found.x, cost


@pytest.mark.parametrize("ls_iterations", [20, 1])
def test_finds_what_scipy_finds(ls_iterations):
    m = model(ls_iterations=ls_iterations)
    assert newton.applies(m)
    mx, dx = mjx.put_model(m, impl="jax"), mjx.make_data(m, impl="jax")
    assert dx._impl.ne == 3
    assert len(dx._impl.efc_J) > 20
    drawn = problems(dx)
    solved = jax.jit(jax.vmap(lambda p: newton.solve(mx, with_problem(dx, p))))(jax.tree.map(jnp.asarray, drawn))
    found = [found_by_both(dx, drawn, jax.tree.map(lambda x, i=i: x[i], solved), i) for i in range(N)]
    # One look at 16 lengths is too few for some of these problems, which are harder than those of physics.
    assert np.mean(found) == 1 if ls_iterations > 1 else np.mean(found) >= 0.8


def found_by_both(dx, drawn, solved, i):
    """Whether the solution of problem `i` is SciPy's: accelerations, cost, and forces of the constraints."""
    p = {name: value[i] for name, value in drawn.items()}
    qacc, cost = minimum(p, dx._impl.ne)
    got = np.asarray(solved.qacc, float)
    pushed = p["rows"] @ got - p["reference"]
    pushed = np.where((pushed < 0) | (np.arange(len(pushed)) < 3), pushed, 0)
    force = -p["rows"].T @ (p["weight"] * pushed)
    return (
        np.allclose(got, qacc, rtol=0, atol=1e-3 * np.abs(qacc).max())
        and cost(got) < cost(qacc) + 1e-5 * abs(cost(p["free"].astype(float)))
        and np.allclose(solved.qfrc_constraint, force, rtol=0, atol=2e-3 * np.abs(force).max())
    )


def test_has_the_derivative_of_the_minimum():
    """Of the accelerations with respect to the forces, from a warm start that is the minimum already."""
    m = model()
    mx, dx = mjx.put_model(m, impl="jax"), mjx.make_data(m, impl="jax")
    p = {name: jnp.asarray(value[0]) for name, value in problems(dx).items()}
    p = p | {"warm": newton.solve(mx, with_problem(dx, p)).qacc}

    def qacc(force):
        free = jnp.linalg.solve(p["inertia"], force)
        return newton.solve(mx, with_problem(dx, p | {"force": force, "free": free})).qacc

    jacobian = np.asarray(jax.jit(jax.jacfwd(qacc))(p["force"]))
    jar = p["rows"] @ p["warm"] - p["reference"]
    active = (jar < 0) | (np.arange(len(jar)) < 3)
    hessian = p["inertia"] + (p["rows"].T * (p["weight"] * active)) @ p["rows"]
    np.testing.assert_allclose(jacobian, np.linalg.inv(hessian.astype(float)), atol=1e-4)


@pytest.mark.parametrize("other", [{"loss": 1.0}, {"cone": "elliptic"}, {"integrator": "implicitfast"}])
def test_leaves_other_models_to_mjx(other):
    assert not newton.applies(model(**other))
