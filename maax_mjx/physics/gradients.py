"""Derivatives of a physics step, forward and reverse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.custom_derivatives import SymbolicZero, zero_from_primal
from jax.flatten_util import ravel_pytree


class NotDifferentiableError(RuntimeError):
    """The error of a derivative that an engine does not have; the message says which, and what has it."""


def not_differentiable(fn: Callable, message: str) -> Callable:
    """Makes `fn` raise `NotDifferentiableError(message)` where it is differentiated."""
    wrapped = jax.custom_jvp(fn)

    def jvp(primals: Any, tangents: Any) -> Any:
        raise NotDifferentiableError(message)

    wrapped.defjvp(jvp)
    return wrapped


def with_jacobian(fn: Callable, message: str) -> Callable:
    """Gives `fn(x, fixed) -> (y, rest)` the tangent J @ dx, with J = dy/dx computed forward.

    MuJoCo's solvers iterate until they converge, through which JAX differentiates forward only. The tangent being
    linear in dx, reverse mode can transpose it; and J is computed once for all directions. Columns of J are left out
    where a part of x has no tangent.

    Args:
        fn: of `x`, a dict of arrays, and `fixed`, any tree. It returns a tree `y` and a tree `rest` that gets no
            derivative.
        message: of the `NotDifferentiableError` where a derivative with respect to `fixed` is asked for.
    """
    wrapped = jax.custom_jvp(fn)

    def jvp(primals: tuple, tangents: tuple) -> tuple:
        (x, fixed), (dx, d_fixed) = primals, tangents
        if any(not isinstance(t, SymbolicZero) for t in jax.tree.leaves(d_fixed, is_leaf=_is_zero)):
            raise NotDifferentiableError(message)
        moving = {name: t for name, t in dx.items() if not isinstance(t, SymbolicZero)}
        point, unravel = ravel_pytree({name: x[name] for name in moving})

        def of(point: jax.Array) -> tuple:
            y, rest = fn(x | unravel(point), fixed)
            return ravel_pytree(y)[0], (y, rest)

        jacobian, (y, rest) = jax.jacfwd(of, has_aux=True)(point)
        dy = ravel_pytree(y)[1](jacobian @ ravel_pytree(moving)[0])
        return (y, rest), (dy, jax.tree.map(zero_from_primal, rest))

    wrapped.defjvp(jvp, symbolic_zeros=True)
    return wrapped


def _is_zero(x: Any) -> bool:
    return isinstance(x, SymbolicZero)
