"""Kernels that do all iterations of MJX-Warp's Newton solver in one launch, a world in each block.

The solver launches its iterations for all worlds until the slowest is done, ten kernels each, of which every one reads
the worlds' rows anew (docs/upstream/solver_iterations.md). A world's rows and Hessian are some kilobytes, which fit
into the shared memory of a block: here they are read once, and no world waits for another. The Hessian is added up anew
whenever a row's state changes, not corrected, so that no rounding is left in it (docs/upstream/hessian.md).
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

SOURCE = Path(__file__).with_suffix(".cuh")
"""The kernel in C++, of which CUDA makes one for GPUs and Clang one for CPUs."""

MAX_DOFS = 64
"""Degrees of freedom of a world at most: sets of them are words of 64 bits."""
MAX_SHARED = 48 * 1024
"""Bytes of shared memory that a block has without asking for more."""
LANES = 32
"""Threads of a block."""
RESIDENT_SHARE = 0.5
"""Rows that are copied into shared memory, as a share of those that a world has room for. A world has a quarter of them
in the mean; those with more are done by a second kernel, which reads rows where they are."""
ENTRIES_PER_ROW = 8
"""Entries of such a row that there is room for, in the mean."""


class Size(NamedTuple):
    """What the kernels are compiled for.

    Attributes:
        nv: degrees of freedom.
        rows: constraint rows of a world that there is room for.
        sparse: whether rows of the Jacobian are kept as their entries that are not zero, with their columns.
        stride: entries from a row of a dense Jacobian to the next.
        iterations, ls_iterations: of the solver and of each of its line searches, at most.
        warmstart: whether a step begins at the last one's accelerations.
    """

    nv: int
    rows: int
    sparse: bool
    stride: int
    iterations: int
    ls_iterations: int
    warmstart: bool

    @property
    def resident_rows(self) -> int:
        """Rows that are copied into shared memory."""
        return min(self.rows, max(LANES, round(RESIDENT_SHARE * self.rows)))

    @property
    def resident_entries(self) -> int:
        """Entries of these rows."""
        return min(ENTRIES_PER_ROW, self.nv) * self.resident_rows

    @property
    def shared_bytes(self) -> int:
        """Shared memory of the larger of the two kernels."""
        dofs = 4 * (self.nv + 1) * (self.nv + 2) // 2 + (8 * 4 + 2 * 8 + 4) * self.nv + 8
        row = 8 + 4 * 4 + 1 + 2
        return dofs + max(row * self.rows, (row + 2) * self.resident_rows + 4 * self.resident_entries) + 64

    @property
    def fits(self) -> bool:
        """Whether the kernels can solve such worlds."""
        return 0 < self.nv <= MAX_DOFS and 0 < self.rows < 2**15 and self.shared_bytes <= MAX_SHARED


@cache
def newton_kernels(size: Size, states: tuple[tuple[str, int], ...]) -> tuple[Any, Any]:
    """Returns two kernels that are launched one after the other, with a block of `LANES` threads for each world.

    The first solves worlds whose rows fit into `Size.resident_rows` and `resident_entries`, the second all others.

    Args:
        size: what to compile for.
        states: names and numbers of the states of rows and of the bits for overflows, as the source calls them.
    """
    return _newton_kernel(size, states, resident=True), _newton_kernel(size, states, resident=False)


def _newton_kernel(size: Size, states: tuple[tuple[str, int], ...], resident: bool) -> Any:
    # Warp takes seconds to import, and the types that it declares are not those of kernels.
    wp: Any = import_module("warp")
    defined = {
        "NV": size.nv,
        "CAPACITY": size.rows,
        "ROWS": size.resident_rows if resident else size.rows,
        "ENTRIES": size.resident_entries,
        "RESIDENT": int(resident),
        "SPARSE": int(size.sparse),
        "STRIDE": size.stride,
        "WARMSTART": int(size.warmstart),
        "ITERATIONS": size.iterations,
        "LS_ITERATIONS": size.ls_iterations,
        **dict(states),
    }
    snippet = "".join(f"#define {name} {value}\n" for name, value in defined.items()) + SOURCE.read_text()

    @wp.func_native(snippet)
    def newton(
        world: int,
        lane: int,
        tolerance: float,
        ls_tolerance: float,
        n_equalities: int,
        n_frictions: int,
        n_rows: int,
        inertia_id: wp.array2d[int],
        M: wp.array[float],
        row_length: wp.array[int],
        row_address: wp.array[int],
        columns_of_rows: wp.array2d[int],
        J: wp.array2d[float],
        efc_D: wp.array[float],
        efc_aref: wp.array[float],
        frictionloss: wp.array[float],
        qacc_warmstart: wp.array[float],
        qacc_smooth: wp.array[float],
        qfrc_smooth: wp.array[float],
        n_iterations: wp.array[int],
        overflow: wp.array[int],
        qacc_out: wp.array[float],
        ma_out: wp.array[float],
        qfrc_constraint_out: wp.array[float],
        force_out: wp.array[float],
        state_out: wp.array[int],
    ): ...

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def solve(
        tolerance: wp.array[float],
        ls_tolerance: wp.array[float],
        n_equalities: wp.array[int],
        n_frictions: wp.array[int],
        n_rows: wp.array[int],
        inertia_id: wp.array2d[int],
        M: wp.array2d[float],
        row_length: wp.array2d[int],
        row_address: wp.array2d[int],
        columns_of_rows: wp.array3d[int],
        J: wp.array3d[float],
        efc_D: wp.array2d[float],
        efc_aref: wp.array2d[float],
        frictionloss: wp.array2d[float],
        qacc_warmstart: wp.array2d[float],
        qacc_smooth: wp.array2d[float],
        qfrc_smooth: wp.array2d[float],
        n_iterations: wp.array[int],
        overflow: wp.array[int],
        qacc: wp.array2d[float],
        ma: wp.array2d[float],
        qfrc_constraint: wp.array2d[float],
        force: wp.array2d[float],
        state: wp.array2d[int],
    ):
        world, lane = wp.tid()
        newton(
            world,
            lane,
            tolerance[world % tolerance.shape[0]],
            ls_tolerance[world % ls_tolerance.shape[0]],
            n_equalities[world],
            n_frictions[world],
            n_rows[world],
            inertia_id,
            M[world],
            row_length[world],
            row_address[world],
            columns_of_rows[world],
            J[world],
            efc_D[world],
            efc_aref[world],
            frictionloss[world],
            qacc_warmstart[world],
            qacc_smooth[world],
            qfrc_smooth[world],
            n_iterations,
            overflow,
            qacc[world],
            ma[world],
            qfrc_constraint[world],
            force[world],
            state[world],
        )

    return solve
