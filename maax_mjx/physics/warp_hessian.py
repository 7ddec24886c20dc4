"""A kernel that repairs Hessians of MJX-Warp's Newton solver, which in float32 lose what is light beside what is stiff.

The solver adds constraint rows that become active to its Hessian, and subtracts those that no longer are. A stiff row
leaves its rounding behind, which can be more than the inertia of a light body: the matrix is no longer positive
definite, and its whole world is no number after the step (docs/upstream/hessian.md).
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

KEPT = 0.03
"""Share of a row that was subtracted that must be left in an entry, else it is added up anew. Where so much is left,
the row added a relative error of 2e-6 at most."""
STIFF = 1e4
"""How many times the inertia of its degrees of freedom a subtracted row has to be in an entry. What float32 leaves of a
lighter one is less than 6e-4 of that inertia."""
SLOTS, LANES = 4, 32
"""Rows of a world that are looked at together, each by so many threads."""


@cache
def repair_kernel(sparse: bool, active: int) -> Any:
    """Returns the kernel, which adds up anew the entries of which the subtraction of a stiff row left less than `KEPT`.

    It is launched with (n_worlds, SLOTS, LANES) threads, after rows were subtracted.

    Args:
        sparse: whether rows of the Jacobian are kept as their entries that are not zero, with their columns.
        active: the state of rows that are in the Hessian.
    """
    # Warp takes seconds to import, and the types that it declares are not those of kernels.
    wp: Any = import_module("warp")

    @wp.func
    def column(columns: wp.array3d[int], address: wp.array2d[int], world: int, row: int, k: int) -> int:
        """Column of the k-th entry of a row that is kept."""
        if wp.static(sparse):
            return columns[world, 0, address[world, row] + k]
        return k

    @wp.func
    def value(jacobian: wp.array3d[float], address: wp.array2d[int], world: int, row: int, k: int) -> float:
        """The k-th entry of a row that is kept."""
        if wp.static(sparse):
            return jacobian[world, 0, address[world, row] + k]
        return jacobian[world, row, k]

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def kernel(
        nv: int,
        inertia_id: wp.array2d[int],
        inertia: wp.array2d[float],
        n_rows: wp.array[int],
        length: wp.array2d[int],
        address: wp.array2d[int],
        columns: wp.array3d[int],
        jacobian: wp.array3d[float],
        stiffness: wp.array2d[float],
        state: wp.array2d[int],
        changed: wp.array2d[int],
        n_changed: wp.array[int],
        hessian: wp.array3d[float],
    ) -> None:
        world, slot, lane = wp.tid()
        for index in range(slot, n_changed[world], SLOTS):
            row = changed[world, index]
            if state[world, row] == active:
                continue
            n = nv
            if wp.static(sparse):
                n = length[world, row]
            for pair in range(lane, n * (n + 1) // 2, LANES):
                # Pairs a >= b, counted along the rows of a triangle.
                a = int((wp.sqrt(float(8 * pair + 1)) - 1.0) * 0.5)
                b = pair - a * (a + 1) // 2
                lost = value(jacobian, address, world, row, a) * value(jacobian, address, world, row, b)
                lost = wp.abs(stiffness[world, row] * lost)
                first, second = column(columns, address, world, row, a), column(columns, address, world, row, b)
                i, j = wp.min(first, second), wp.max(first, second)
                # Most rows are light, and end here.
                light = inertia[world, inertia_id[i, i]] * inertia[world, inertia_id[j, j]]
                if lost <= STIFF * wp.sqrt(light) or wp.abs(hessian[world, i, j]) >= KEPT * lost:
                    continue
                # The Hessian's upper triangle is read, and the inertia has its lower one.
                # What a kernel changes in a loop is declared by a call.
                total = float(0.0)  # noqa: UP018
                if inertia_id[j, i] >= 0:
                    total = float(inertia[world, inertia_id[j, i]])
                for other in range(n_rows[world]):
                    if state[world, other] != active:
                        continue
                    at_i, at_j = float(0.0), float(0.0)  # noqa: UP018
                    if wp.static(sparse):
                        for k in range(length[world, other]):
                            at = column(columns, address, world, other, k)
                            if at == i:
                                at_i = value(jacobian, address, world, other, k)
                            if at == j:
                                at_j = value(jacobian, address, world, other, k)
                    else:
                        at_i = value(jacobian, address, world, other, i)
                        at_j = value(jacobian, address, world, other, j)
                    total += stiffness[world, other] * at_i * at_j
                # Rows that share the entry all find the same total.
                hessian[world, i, j] = total

    return kernel
