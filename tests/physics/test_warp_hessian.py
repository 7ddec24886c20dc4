"""Warp's Newton solver, with its Hessian repaired, against C MuJoCo where stiff rows become inactive."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from mujoco import mjx

from maax_mjx.physics.mjx_internals import repair_hessians
from maax_mjx.physics.warp_hessian import BLOCKS, KEPT, LANES, SLOTS, STIFF, repair_kernels

BALLS = """
<mujoco>
  <option jacobian="{jacobian}"/>
  <default><geom friction=".001"/></default>
  <worldbody>
    <geom type="plane" size="2 2 1"/>
    <body pos="0 0 .1"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
    <body pos="1 0 .1"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
  </worldbody>
</mujoco>
"""
"""Two balls that lie 1 mm deep in a plane."""

BOX = """
<mujoco>
  <option jacobian="{jacobian}"/>
  <default><geom friction=".01"/></default>
  <worldbody>
    <geom type="plane" size="2 2 1"/>
    <body pos="0 0 .05">
      <freejoint/>
      <inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>
      <geom type="box" size=".5 .5 .05"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A wide box on a plane, which weighs less than its corners' contacts are stiff."""


def accelerations(xml, up, force, depth=0.001):
    """Accelerations of the first step from rest, by C MuJoCo and by Warp."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    at = data.qpos.astype(np.float32) - depth * up
    data.qpos[:], data.qfrc_applied[:] = at, force
    mujoco.mj_step(model, data)
    m = mjx.put_model(model, impl="warp")
    fresh = mjx.make_data(model, impl="warp", naconmax=16, njmax=32)
    step = jax.jit(jax.vmap(lambda qpos, force: mjx.step(m, fresh.replace(qpos=qpos, qfrc_applied=force))))
    after = step(*(jnp.asarray(x, jnp.float32)[None] for x in (at, force)))
    return data.qacc, np.asarray(after.qacc[0])


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_a_lifted_ball_leaves_the_plane(jacobian):
    repair_hessians()
    ours, warp = accelerations(BALLS.format(jacobian=jacobian), np.array([1, 1]), [20, 0])
    np.testing.assert_allclose(warp, ours, atol=1e-3)


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
@pytest.mark.parametrize(("inertia", "tilt", "atol"), [(0.005, 0, 5e-3), (0.02, 6, 5e-2)])
def test_a_lifted_box_does_not_turn_about_the_vertical(jacobian, inertia, tilt, atol):
    repair_hessians()
    up, force = np.array([0, 0, 1, 0, 0, 0, 0]), [0, 0, 20, tilt, 0, 0]
    ours, warp = accelerations(BOX.format(jacobian=jacobian, inertia=inertia), up, force)
    assert np.abs(ours[5]) < 1e-3
    # Rows lighter than `STIFF` leave their rounding: in the second box 1e-3 of its acceleration by the tilt.
    np.testing.assert_allclose(warp, ours, atol=atol)


ACTIVE = 1
"""State of rows that are in the Hessian."""


@pytest.mark.parametrize("sparse", [False, True])
def test_what_little_is_left_of_is_added_up_anew_and_all_else_stays(sparse):
    """Of random rows, most of which were subtracted, over more degrees of freedom than one warp has threads."""
    rng, n_worlds, nv, n_rows = seeds.rng(0), 3, 40, 30
    jacobian = np.zeros((n_worlds, n_rows, nv), np.float32)
    columns = np.sort(rng.permuted(np.tile(np.arange(nv), (n_worlds, n_rows, 1)), axis=2)[..., :6], axis=2)
    np.put_along_axis(jacobian, columns, rng.normal(size=columns.shape).astype(np.float32), axis=2)
    stiffness = np.exp(rng.uniform(0, 12, (n_worlds, n_rows))).astype(np.float32)
    state = (rng.random((n_worlds, n_rows)) < 0.3).astype(np.int32) * ACTIVE
    mass = np.tril(np.where(np.arange(nv)[:, None] // 4 == np.arange(nv) // 4, rng.uniform(0.1, 1, (nv, nv)), 0))
    inertia_id = np.full((nv, nv), -1, np.int32)
    inertia_id[np.nonzero(mass)] = np.arange(np.count_nonzero(mass))
    inertia = np.tile(mass[np.nonzero(mass)], (n_worlds, 1)).astype(np.float32)

    left = np.where(state == ACTIVE, stiffness, 0)
    exact = np.triu(mass.T + np.einsum("wr,wri,wrj->wij", left, jacobian, jacobian, dtype=float))
    terms = np.abs(np.einsum("wr,wri,wrj->wrij", stiffness, jacobian, jacobian, dtype=float))
    given = np.triu(exact + np.triu(rng.normal(size=exact.shape))).astype(np.float32)
    light = np.sqrt(np.outer(np.diag(mass), np.diag(mass)))
    subtracted = np.where((state != ACTIVE)[..., None, None], terms, 0)
    little, gone = (
        np.triu((KEPT * rows).max(1) > np.abs(given))
        for rows in (subtracted, np.where(subtracted > STIFF * light, subtracted, 0))
    )
    assert 20 < gone.sum() < exact.size / 4
    assert (little & ~gone).any(), "rows that are not stiff stay"

    changed = np.tile(rng.permutation(n_rows).astype(np.int32), (n_worlds, 1))
    warp = pytest.importorskip("warp")
    length = np.full((n_worlds, n_rows), 6, np.int32)
    address = np.tile(6 * np.arange(n_rows, dtype=np.int32), (n_worlds, 1))
    kept = np.take_along_axis(jacobian, columns, axis=2).reshape(n_worlds, 1, -1)
    hessian = warp.array(given, dtype=float, device="cpu")

    def on_cpu(*arrays):
        return [warp.array(x, dtype=float if x.dtype == np.float32 else int, device="cpu") for x in arrays]

    model = [nv, *on_cpu(inertia_id, inertia)]
    entries = columns.reshape(n_worlds, 1, -1).astype(np.int32)
    rows = on_cpu(length, address, entries, kept if sparse else jacobian, stiffness, state)
    n_each = np.full(n_worlds, n_rows, np.int32)
    stiff = warp.empty(n_worlds * n_rows, dtype=warp.vec2i, device="cpu")
    n_stiff = warp.zeros(1, dtype=int, device="cpu")
    kernels = repair_kernels(sparse, ACTIVE)
    warp.launch(
        kernels.find,
        dim=(n_worlds, SLOTS),
        inputs=[*model, *rows, *on_cpu(changed, n_each)],
        outputs=[stiff, n_stiff],
        device="cpu",
    )
    warp.launch_tiled(
        kernels.repair,
        dim=[BLOCKS],
        inputs=[*model, *on_cpu(n_each), *rows, stiff, n_stiff],
        outputs=[hessian],
        device="cpu",
        block_dim=LANES,
    )
    listed = stiff.numpy()[: n_stiff.numpy()[0]]
    wanted = (np.where(subtracted > STIFF * light, subtracted, 0) > 0).any((2, 3))
    np.testing.assert_array_equal(np.sort(listed @ [n_rows, 1]), np.flatnonzero(wanted))
    np.testing.assert_array_equal(hessian.numpy()[~gone], given[~gone])
    np.testing.assert_allclose(hessian.numpy()[gone], exact[gone], rtol=1e-4, atol=1e-3)
    assert np.abs(given - exact)[gone].max() > 1, "what was given was wrong"
