"""The benchmark of updates at its smallest."""

from __future__ import annotations

import pytest
from helpers import toys

from maax_mjx.benchmarks import updates


@pytest.mark.slow
def test_updates_by_part(run, folder):
    toys.register()
    options = {"env": ("echo",), "preset": "laptop", "rows": (4,), "minibatches": (1,), "chunk": (2,)}
    (row,) = run(updates, folder / "updates_cpu.json", **options, core=("gru",))
    assert row["ns"] > 0
    assert sum(row["parts_ns"].values()) == pytest.approx(row["traced_ns"], rel=0.01)
    assert row["parts_ns"]["entities"] > 0
    assert row["parts_ns"]["memory"] > 0


@pytest.mark.parametrize(
    ("source", "part"),
    [
        ("jit(updated)/while/body/transpose(jvp(Tower))/core/while/body/dot_general", "memory"),
        ("jit(updated)/while/body/jvp(Tower)/embed own for box/dot_general", "entities"),
        ("jit(updated)/while/body/jvp(Tower)/norm in/mul", "layers"),
        ("jit(updated)/while/body/rows/gather", "rows"),
        ("jit(updated)/while/body/optimiser/mul", "optimiser"),
        ("jit(updated)/while/body/reduce_sum", "the rest"),
    ],
)
def test_operations_belong_to_the_layer_that_names_them(source, part):
    assert updates.part_of(source) == part
