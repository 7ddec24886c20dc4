"""Kernels that repair Hessians of MJX-Warp's Newton solver, which in float32 lose what is light beside what is stiff.

The solver adds constraint rows that become active to its Hessian, and subtracts those that no longer are. A stiff row
leaves its rounding behind, which can be more than the inertia of a light body: the matrix is no longer positive
definite, and its whole world is no number after the step (docs/upstream/hessian.md).
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

KEPT = 0.03
"""Share of a row that was subtracted that must be left in an entry, else it is added up anew. Where so much is left,
the row added a relative error of 2e-6 at most."""
STIFF = 1e5
"""How many times the inertia of its degrees of freedom a subtracted row has to be in an entry. What float32 leaves of a
lighter one is less than 6e-3 of that inertia."""
SLOTS = 4
"""Rows of a world that are looked at together, each by one thread."""
BLOCKS, LANES = 1024, 32
"""Entries that are added up together, each by so many threads."""


class RepairKernels(NamedTuple):
    """Two kernels that are launched one after the other, after rows were subtracted.

    Few rows are stiff, and most worlds subtract none. So one kernel looks, with few threads, and another repairs, with
    many for each entry: the solver launches both in every iteration, and they should cost nothing where there is
    nothing to do.
    """

    find: Any
    """Lists the subtracted rows that are stiff; launched with (n_worlds, SLOTS) threads."""
    repair: Any
    """Adds up anew the entries of which the subtraction of such a row left less than `KEPT`; launched with BLOCKS tiles
    of LANES threads."""


@cache
def repair_kernels(sparse: bool, active: int) -> RepairKernels:
    """Returns the kernels that find stiff rows that were subtracted and repair what they left.

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

    @wp.func
    def entries(length: wp.array2d[int], nv: int, world: int, row: int) -> int:
        """Number of entries of a row that are kept."""
        if wp.static(sparse):
            return length[world, row]
        return nv

    @wp.func
    def pair(index: int) -> wp.vec2i:
        """The index-th pair a >= b, counted along the rows of a triangle."""
        a = int((wp.sqrt(float(8 * index + 1)) - 1.0) * 0.5)
        return wp.vec2i(a, index - a * (a + 1) // 2)

    @wp.func
    def place(columns: wp.array3d[int], address: wp.array2d[int], world: int, row: int, ab: wp.vec2i) -> wp.vec2i:
        """Where the Hessian has the product of a pair of a row's entries: in its upper triangle, which is read."""
        first = column(columns, address, world, row, ab[0])
        second = column(columns, address, world, row, ab[1])
        return wp.vec2i(wp.min(first, second), wp.max(first, second))

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def find(
        nv: int,
        inertia_id: wp.array2d[int],
        inertia: wp.array2d[float],
        length: wp.array2d[int],
        address: wp.array2d[int],
        columns: wp.array3d[int],
        jacobian: wp.array3d[float],
        stiffness: wp.array2d[float],
        state: wp.array2d[int],
        changed: wp.array2d[int],
        n_changed: wp.array[int],
        stiff: wp.array[wp.vec2i],
        n_stiff: wp.array[int],
    ) -> None:
        world, slot = wp.tid()
        for index in range(slot, n_changed[world], SLOTS):
            row = changed[world, index]
            if state[world, row] == active:
                continue
            # No entry is further beyond its inertia than the worst on the diagonal.
            for k in range(entries(length, nv, world, row)):
                at = column(columns, address, world, row, k)
                entry = value(jacobian, address, world, row, k)
                if stiffness[world, row] * entry * entry > STIFF * inertia[world, inertia_id[at, at]]:
                    stiff[wp.atomic_add(n_stiff, 0, 1)] = wp.vec2i(world, row)
                    break

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def repair(
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
        stiff: wp.array[wp.vec2i],
        n_stiff: wp.array[int],
        hessian: wp.array3d[float],
    ) -> None:
        block, lane = wp.tid()
        for found in range(block, n_stiff[0], BLOCKS):
            world, row = stiff[found][0], stiff[found][1]
            n = entries(length, nv, world, row)
            n_pairs = n * (n + 1) // 2
            for start in range(0, n_pairs, wp.block_dim()):
                # Each thread looks at one entry; then all add up each that is lost.
                lost = int(0)  # noqa: RUF046, UP018
                if start + lane < n_pairs:
                    ab = pair(start + lane)
                    subtracted = value(jacobian, address, world, row, ab[0])
                    subtracted *= stiffness[world, row] * value(jacobian, address, world, row, ab[1])
                    ij = place(columns, address, world, row, ab)
                    i, j = ij[0], ij[1]
                    light = inertia[world, inertia_id[i, i]] * inertia[world, inertia_id[j, j]]
                    subtracted = wp.abs(subtracted)
                    if subtracted > STIFF * wp.sqrt(light) and wp.abs(hessian[world, i, j]) < KEPT * subtracted:
                        lost = 1
                is_lost = wp.tile(lost)
                for k in range(wp.min(wp.block_dim(), n_pairs - start)):
                    if is_lost[k] == 0:
                        continue
                    ij = place(columns, address, world, row, pair(start + k))
                    i, j = ij[0], ij[1]
                    part = float(0.0)  # noqa: UP018
                    for other in range(lane, n_rows[world], wp.block_dim()):
                        if state[world, other] != active:
                            continue
                        at_i, at_j = float(0.0), float(0.0)  # noqa: UP018
                        if wp.static(sparse):
                            for e in range(length[world, other]):
                                at = column(columns, address, world, other, e)
                                if at == i:
                                    at_i = value(jacobian, address, world, other, e)
                                if at == j:
                                    at_j = value(jacobian, address, world, other, e)
                        else:
                            at_i = value(jacobian, address, world, other, i)
                            at_j = value(jacobian, address, world, other, j)
                        part += stiffness[world, other] * at_i * at_j
                    total = wp.tile_sum(wp.tile(part))
                    if lane == 0:
                        # The inertia has its lower triangle. Rows that share the entry all find the same total.
                        whole = total[0]
                        if inertia_id[j, i] >= 0:
                            whole += inertia[world, inertia_id[j, i]]
                        hessian[world, i, j] = whole

    return RepairKernels(find, repair)
