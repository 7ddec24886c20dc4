"""The benchmark of training at its smallest."""

from __future__ import annotations

import pytest
from helpers import toys

from maax_mjx.benchmarks import train_speed


@pytest.mark.slow
def test_train_speed(run, folder):
    toys.register()
    options = {"env": ("echo",), "impl": ("c",), "worlds": (4,), "preset": "laptop", "turns": 1, "minibatches": (2,)}
    nets = {"encoder": ("flat", "pool"), "core": ("none",), "epochs": (1,)}
    rows = run(train_speed, folder / "train_speed_cpu.json", **options, **nets, part=("env", "train"))
    # The environment alone has no networks, so that it is timed once.
    assert [(row["part"], row["encoder"], row["epochs"]) for row in rows] == [
        ("env", "", 0), ("train", "flat", 1), ("train", "pool", 1),
    ]  # fmt: skip
    for row in rows:
        assert row["unroll"] == 40
        assert 0 < row["env_steps_per_s"] <= row["fastest"]
    (played,) = run(train_speed, folder / "play_cpu.json", **options, **nets | {"encoder": ("flat",)}, part=("play",))
    assert played["core"] == "none"
    assert played["minibatches"] == 0
