"""Newton's method for MuJoCo's constraints on accelerators: the minimum that `mjx.solve` looks for, in less time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from maax_mjx.physics.connects import with_velocity_terms
from maax_mjx.physics.mjx_internals import constraint_rows

POINTS = np.array([
    0, 1e-6, 1e-5, 1e-4, 1e-3, 1 / 64, 1 / 16, 1 / 8, 1 / 4, 3 / 8, 1 / 2, 5 / 8, 3 / 4, 7 / 8, 1, 3 / 2, 2, 4, 16,
])  # fmt: skip
"""Step lengths that a line search looks at first: in tight places a row begins to push after a millionth of a step."""
PARTS = np.linspace(0, 1, 18)[1:-1]
"""Parts of the interval that is left, where it looks next."""
HALVINGS = 4
"""Halvings of the interval per pass, each an iteration of a line search."""
MAX_PASSES = 3
"""Passes after which the interval is so short that hardly a row changes in it."""
ACCURACY = 1e-4
"""Share of the constraint forces that may be out of balance at the end; in float32 one step from afar leaves more."""


class Point(NamedTuple):
    """The place that the solver has reached.

    Attributes:
        qacc: (nv,) acceleration.
        ma: (nv,) inertia matrix times `qacc`.
        jar: (nefc,) constraint rows times `qacc`, less their reference.
        active: (nefc,) bool, the rows that push.
        grad: (nv,) gradient of the cost.
    """

    qacc: jax.Array
    ma: jax.Array
    jar: jax.Array
    active: jax.Array
    grad: jax.Array


class Progress(NamedTuple):
    """The loop's carry: the point, how many steps were made, and whether it is the last."""

    point: Point
    n: jax.Array
    done: jax.Array


def applies(model: mujoco.MjModel) -> bool:
    """Tells whether `step` takes a model: Euler's method, and costs that pyramidal cones without friction loss have."""
    option = model.opt
    return (
        option.solver == mujoco.mjtSolver.mjSOL_NEWTON
        and option.integrator == mujoco.mjtIntegrator.mjINT_EULER
        and option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
        and not (model.dof_frictionloss.any() or model.tendon_frictionloss.any())
    )


def step(m: mjx.Model, d: mjx.Data) -> mjx.Data:
    """Does what `mjx.step` does, without sensors, with `solve` for `mjx.solve`, and connects as MuJoCo has them."""
    stages = (mjx.fwd_position, mjx.fwd_velocity, with_velocity_terms, mjx.fwd_actuation, mjx.fwd_acceleration)
    for stage in stages:
        d = stage(m, d)
    with jax.named_scope("solve"):
        d = solve(m, d) if constraint_rows(d).jacobian.size else d.replace(qacc=d.qacc_smooth)
    return mjx.euler(m, d)


def solve(m: mjx.Model, d: mjx.Data) -> mjx.Data:
    """Finds the accelerations at which constraint forces, inertia and other forces balance.

    The cost that MuJoCo minimises (MuJoCo documentation, Computation, "Primal problem") is convex, and quadratic
    between the places where rows begin or cease to push. So a full Newton step after which the same rows push has found
    the minimum, and the slope along a line never falls, which makes a line search a search for one zero.

    Where the iterations end before the minimum, forces are those that belong to the accelerations reached. Those of the
    rows are not in balance there, and rows are so stiff that they would throw agents out of the arena.

    Args:
        m: a model to which `applies` applies.
        d: data with the rows of `mjx.fwd_position` and the forces of `mjx.fwd_acceleration`.

    Returns:
        The data with `qacc` and `qfrc_constraint`.
    """
    rows, weight, reference, n_equalities = constraint_rows(d)
    inertia = mjx.full_m(m, d)
    always = np.arange(rows.shape[0]) < n_equalities
    passes = int(np.clip(-(-m.opt.ls_iterations // HALVINGS), 1, MAX_PASSES))
    scale = 1 / jnp.maximum(jnp.trace(inertia), mujoco.mjMINVAL)

    def pushes(jar: jax.Array) -> jax.Array:
        return (jar < 0) | always.reshape(-1, *[1] * (jar.ndim - 1))

    def at(qacc: jax.Array, ma: jax.Array, jar: jax.Array) -> Point:
        active = pushes(jar)
        return Point(qacc, ma, jar, active, ma - d.qfrc_smooth + rows.T @ jnp.where(active, weight * jar, 0))

    def start(qacc: jax.Array) -> Point:
        return at(qacc, inertia @ qacc, rows @ qacc - reference)

    def cost(point: Point) -> jax.Array:
        pushed = jnp.where(point.active, weight * point.jar, 0)
        return 0.5 * (jnp.dot(pushed, point.jar) + jnp.dot(point.ma - d.qfrc_smooth, point.qacc - d.qacc_smooth))

    def improve(progress: Progress) -> Progress:
        before = progress.point
        hessian = inertia + (rows.T * jnp.where(before.active, weight, 0)) @ rows
        factor = jax.scipy.linalg.cho_factor((hessian + hessian.T) * 0.5)
        search = -jax.scipy.linalg.cho_solve(factor, before.grad)
        ms, js = inertia @ search, rows @ search
        settled = (pushes(before.jar + js) == before.active).all()
        slope, curvature = jnp.dot(search, before.ma - d.qfrc_smooth), jnp.dot(search, ms)

        def slopes(steps: jax.Array) -> jax.Array:
            there = before.jar[:, None] + js[:, None] * steps
            return slope + steps * curvature + (weight * js) @ jnp.where(pushes(there), there, 0)

        def curvatures(steps: jax.Array) -> jax.Array:
            pushing = pushes(before.jar[:, None] + js[:, None] * steps)
            return curvature + jnp.where(pushing, (weight * js * js)[:, None], 0).sum(axis=0)

        with jax.named_scope("line_search"):
            step = jnp.where(settled, 1.0, _zero(slopes, curvatures, passes, before.jar.dtype))
        after = at(before.qacc + step * search, before.ma + step * ms, before.jar + step * js)
        # The difference of two costs would be rounded to nothing where a step is short.
        old, new = (jnp.where(point.active, point.jar, 0) for point in (before, after))
        gain = -step * (slope + 0.5 * step * curvature) - 0.5 * jnp.dot(weight * (new - old), new + old)
        better = settled | (gain > 0)
        small = (gain * scale < m.opt.tolerance) | (jnp.linalg.norm(after.grad) * scale < m.opt.tolerance)
        accurate = jnp.linalg.norm(after.grad) <= ACCURACY * jnp.linalg.norm(after.ma - d.qfrc_smooth)
        n = progress.n + 1
        point = jax.tree.map(lambda old, new: jnp.where(better, new, old), before, after)
        return Progress(point, n, (settled & accurate) | small | ~better | (n >= m.opt.iterations))

    warm, smooth = start(d.qacc_warmstart), start(d.qacc_smooth)
    if m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_WARMSTART:
        first = smooth
    else:
        first = jax.tree.map(lambda a, b: jnp.where(cost(warm) < cost(smooth), a, b), warm, smooth)
    # At least one step: the warm start, where that is the minimum already, would have no derivative.
    begun = Progress(first, jnp.zeros((), jnp.int32), jnp.zeros((), bool))
    last = jax.lax.while_loop(lambda progress: ~progress.done, improve, begun).point
    return d.replace(qacc=last.qacc, qfrc_constraint=last.ma - d.qfrc_smooth)


def _zero(
    slopes: Callable[[jax.Array], jax.Array], curvatures: Callable[[jax.Array], jax.Array], passes: int, dtype: Any
) -> jax.Array:
    """The step length at which a slope that does not fall is zero.

    Looks at many lengths at once, where a bisection would wait for one after the other: what takes time on an
    accelerator is the number of passes over the rows, not their arithmetic.

    Args:
        slopes: from lengths (n,) to the slopes there.
        curvatures: from lengths (n,) to the derivatives of the slopes there.
        passes: how often slopes are asked for.
        dtype: of the lengths.
    """
    points, parts = jnp.asarray(POINTS, dtype), jnp.asarray(PARTS, dtype)
    ends, rises = _around_zero(points, slopes(points))
    for _ in range(passes - 1):
        # Where a stiff row begins to push, the slope bends upwards. A length short of the bend gets nowhere: the row is
        # not in the next Hessian. So the zeros of both ends' tangents are looked at, too: after one bend, that of the
        # upper end is the zero itself.
        tangents = ends - rises / jnp.maximum(curvatures(ends), mujoco.mjMINVAL)
        steps = jnp.concatenate([ends[0] + (ends[1] - ends[0]) * parts, jnp.clip(tangents, ends[0], ends[1])])
        there = slopes(steps)
        ends, rises = _around_zero(
            jnp.concatenate([ends[:1], steps, ends[1:]]), jnp.concatenate([rises[:1], there, rises[1:]])
        )
    # Between neighbours the slope is a straight line, unless a row begins or ceases to push just there.
    return ends[0] + (ends[1] - ends[0]) * jnp.clip(-rises[0] / jnp.maximum(rises[1] - rises[0], mujoco.mjMINVAL), 0, 1)


def _around_zero(steps: jax.Array, slopes: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The neighbours between which the slopes, which do not fall, pass zero: their lengths (2,) and slopes (2,).

    The first length is the least and the last the greatest; the others need no order.
    """
    below = (slopes < 0).at[jnp.array([0, -1])].set(jnp.array([True, False]))
    low = jnp.argmax(jnp.where(below, steps, -jnp.inf))
    high = jnp.argmin(jnp.where(below, jnp.inf, steps))
    pair = jnp.stack([low, high])
    return steps[pair], slopes[pair]
