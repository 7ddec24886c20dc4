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
"""Degrees of freedom of a world at most: 16 blocks of four, whose sets are short words."""
MAX_ADDRESS = 2**15
"""Rows and blocks of entries are numbered in 16 bits."""
LANES = 32
"""Threads of a block."""
RESERVED = 1024
"""Bytes of a block's shared memory that are Warp's."""
LAST_BLOCKS = 512
"""Blocks of the second kernel, which take one world after the other."""
FIRST_ROWS, FIRST_SHARE = 4 * LANES, 0.35
"""Rows of a world that the first kernel has room for: so many, or so large a share of all that there is room for. They
have a quarter in the mean. With less shared memory, more are solved at the same time; the others go to the second."""
ENTRIES_PER_ROW = 2
"""Blocks of four entries that the first kernel has room for, a row in the mean: rows of a contact of two bodies have so
many where bodies have four degrees of freedom, and those of a contact with a wall half."""


class Room(NamedTuple):
    """What a kernel has room for in shared memory.

    Attributes:
        rows: constraint rows of a world.
        entries: blocks of four entries of its Jacobian.
        groups: groups of rows that have the same blocks.
        blocks: blocks of four by four of its Hessian's factor.
        n_blocks: blocks of four degrees of freedom.
    """

    rows: int
    entries: int
    groups: int
    blocks: int
    n_blocks: int

    @property
    def bytes(self) -> int:
        """Shared memory, at most; the source checks it."""
        of_row, of_group, of_dofs = 5 * 4 + 2 * 2 + 2, 3 * 2, 4 * 16 + 9 * 16 + 6 * 4
        of_all = of_row * self.rows + of_group * self.groups + of_dofs * self.n_blocks
        return 80 * self.blocks + 16 * self.entries + of_all + 64


class Size(NamedTuple):
    """What the kernels are compiled for.

    Attributes:
        nv: degrees of freedom.
        rows: constraint rows of a world that there is room for.
        sparse: whether rows of the Jacobian are kept as their entries that are not zero, with their columns.
        stride: entries from a row of a dense Jacobian to the next.
        frictions: whether joints or tendons have dry friction, whose rows are limited from both sides.
        iterations, ls_iterations: of the solver and of each of its line searches, at most.
        warmstart: whether a step begins at the last one's accelerations.
    """

    nv: int
    rows: int
    sparse: bool
    stride: int
    frictions: bool
    iterations: int
    ls_iterations: int
    warmstart: bool

    @property
    def n_blocks(self) -> int:
        """Blocks of four degrees of freedom."""
        return -(-self.nv // 4)

    def room(self, is_last: bool) -> Room:
        """What the first kernel, or the last, has room for."""
        all_blocks = self.n_blocks * (self.n_blocks + 1) // 2
        if is_last:
            entries = self.stride if self.sparse else self.rows * self.n_blocks
            return Room(self.rows, min(entries, self.rows * self.n_blocks), self.rows, all_blocks, self.n_blocks)
        rows = min(self.rows, max(FIRST_ROWS, round(FIRST_SHARE * self.rows)))
        blocks = min(all_blocks, 3 * self.n_blocks)
        return Room(rows, ENTRIES_PER_ROW * rows, 4 * self.n_blocks, blocks, self.n_blocks)

    def fits(self, max_bytes: int) -> bool:
        """Whether the kernels can solve such worlds with so much shared memory for a block."""
        room = self.room(is_last=True)
        return (
            0 < self.nv <= MAX_DOFS
            and 0 < room.rows < MAX_ADDRESS
            and room.entries < MAX_ADDRESS
            and room.bytes <= max_bytes - RESERVED
        )


def launch_newton(size: Size, states: tuple[tuple[str, int], ...], inputs: list[Any], outputs: list[Any]) -> None:
    """Launches the kernels: the first with a block for each world, the last for the worlds that this has left.

    Args:
        size: what to compile for.
        states: names and numbers of the states of rows and of the bits for overflows, as the source calls them.
        inputs, outputs: Warp's arrays as the kernel names them, without those of the worlds that are left.
    """
    wp: Any = import_module("warp")
    n_worlds, device = outputs[0].shape[0], outputs[0].device
    left = [wp.empty(n_worlds, dtype=int, device=device), wp.zeros(1, dtype=int, device=device)]
    for kernel, n_blocks in zip(newton_kernels(size, states), (n_worlds, min(n_worlds, LAST_BLOCKS)), strict=True):
        arrays = {"inputs": [n_blocks, *inputs, *left], "outputs": outputs, "device": device}
        wp.launch_tiled(kernel, dim=[n_blocks], block_dim=LANES, **arrays)


@cache
def newton_kernels(size: Size, states: tuple[tuple[str, int], ...]) -> tuple[Any, Any]:
    """Returns the kernel for worlds that fit into the room that it has, which notes the others, and that for these."""
    return _newton_kernel(size, states, is_last=False), _newton_kernel(size, states, is_last=True)


def _newton_kernel(size: Size, states: tuple[tuple[str, int], ...], is_last: bool) -> Any:
    # Warp takes seconds to import, and the types that it declares are not those of kernels.
    wp: Any = import_module("warp")
    room = size.room(is_last)
    defined = {
        "NV": size.nv,
        "CAPACITY": size.rows,
        "ROWS": room.rows,
        "ENTRIES": room.entries,
        "GROUPS": room.groups,
        "BLOCKS": room.blocks,
        "BYTES": room.bytes,
        "IS_LAST": int(is_last),
        "SPARSE": int(size.sparse),
        "STRIDE": size.stride,
        "FRICTIONS": int(size.frictions),
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
        inertia_length: wp.array[int],
        inertia_address: wp.array[int],
        inertia_column: wp.array[int],
        inertia_id: wp.array2d[int],
        M: wp.array[float],
        row_length: wp.array[int],
        row_address: wp.array[int],
        columns_of_rows: wp.array2d[int],
        J: wp.array2d[float],
        D: wp.array[float],
        reference: wp.array[float],
        frictionloss: wp.array[float],
        qacc_warmstart: wp.array[float],
        qacc_smooth: wp.array[float],
        qfrc_smooth: wp.array[float],
        left: wp.array[int],
        n_left: wp.array[int],
        n_iterations: wp.array[int],
        overflow: wp.array[int],
        qacc_out: wp.array[float],
        ma_out: wp.array[float],
        qfrc_constraint_out: wp.array[float],
        force_out: wp.array[float],
        state_out: wp.array[int],
    ) -> None: ...

    # Shared memory of a function that is written in C++ is none that Warp would know of.
    newton.adj.get_total_required_shared = lambda: room.bytes

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def solve(
        n_blocks: int,
        tolerance: wp.array[float],
        ls_tolerance: wp.array[float],
        n_equalities: wp.array[int],
        n_frictions: wp.array[int],
        n_rows: wp.array[int],
        inertia_length: wp.array[int],
        inertia_address: wp.array[int],
        inertia_column: wp.array[int],
        inertia_id: wp.array2d[int],
        M: wp.array2d[float],
        row_length: wp.array2d[int],
        row_address: wp.array2d[int],
        columns_of_rows: wp.array3d[int],
        J: wp.array3d[float],
        D: wp.array2d[float],
        reference: wp.array2d[float],
        frictionloss: wp.array2d[float],
        qacc_warmstart: wp.array2d[float],
        qacc_smooth: wp.array2d[float],
        qfrc_smooth: wp.array2d[float],
        left: wp.array[int],
        n_left: wp.array[int],
        n_iterations: wp.array[int],
        overflow: wp.array[int],
        qacc: wp.array2d[float],
        ma: wp.array2d[float],
        qfrc_constraint: wp.array2d[float],
        force: wp.array2d[float],
        state: wp.array2d[int],
    ) -> None:
        block, lane = wp.tid()
        end = n_rows.shape[0]
        if wp.static(is_last):
            end = n_left[0]
        for k in range(block, end, n_blocks):
            world = k
            if wp.static(is_last):
                world = left[k]
            newton(
                world,
                lane,
                tolerance[wp.min(world, tolerance.shape[0] - 1)],
                ls_tolerance[wp.min(world, ls_tolerance.shape[0] - 1)],
                n_equalities[world],
                n_frictions[world],
                n_rows[world],
                inertia_length,
                inertia_address,
                inertia_column,
                inertia_id,
                M[world],
                row_length[world],
                row_address[world],
                columns_of_rows[world],
                J[world],
                D[world],
                reference[world],
                frictionloss[world],
                qacc_warmstart[world],
                qacc_smooth[world],
                qfrc_smooth[world],
                left,
                n_left,
                n_iterations,
                overflow,
                qacc[world],
                ma[world],
                qfrc_constraint[world],
                force[world],
                state[world],
            )

    return solve
