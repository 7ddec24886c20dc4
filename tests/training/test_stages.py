"""Stages: a truth table, and that games count what the bounds are about."""

from __future__ import annotations

import jax
import pytest

import maax_mjx as maax
from maax_mjx.training.stages import STAGES, stage_of

QUADRANT = {
    "seen": 0.3, "enclosed_prep": 0.6, "doors_blocked_prep": 0.8, "boxes_locked_prep": 1.2, "max_box_move_prep": 0.6,
    "breach": 0.1, "elevated": 0.0, "seekers_carried_ramp": 0.1, "ramp_inside_prep": 0.2, "max_ramp_move_prep": 0.1,
}  # fmt: skip
USED = {"breach": 0.3, "elevated": 0.3, "seekers_carried_ramp": 0.7}
INSIDE = {"ramp_inside_prep": 0.6, "max_ramp_move_prep": 0.8}


@pytest.mark.parametrize(
    ("changed", "stage"),
    [
        ({}, "doors blocked"),
        ({"seen": 0.41}, ""),
        ({"boxes_locked_prep": 0.9}, ""),
        (USED, "ramps used"),
        (USED | {"elevated": 0.29}, "doors blocked"),
        (INSIDE, "ramps carried in"),
        (INSIDE | {"breach": 0.16}, "doors blocked"),
        (INSIDE | USED, "ramps used"),
    ],
)
def test_the_furthest_stage_whose_bounds_hold(changed, stage):
    metrics = {f"episode_{name}": x for name, x in (QUADRANT | changed).items()}
    assert stage_of("hide_and_seek_quadrant", metrics | {"kl": 0.1}) == stage
    assert stage_of("tag", metrics) == ""


@pytest.mark.parametrize("game", STAGES)
def test_games_with_tools_count_all_that_stages_are_told_by(game):
    counted = jax.eval_shape(maax.make(game, impl="c", tools=True).reset, jax.random.key(0)).metrics
    assert {name for stage in STAGES[game] for name in stage.bounds} <= set(counted)
