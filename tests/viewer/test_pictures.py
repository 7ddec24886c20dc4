"""Worlds from above."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from helpers import seeds
from matplotlib.figure import Figure
from PIL import Image

from maax_mjx.core.export import world_of
from maax_mjx.viewer import contact_sheet, draw_plan


@pytest.fixture(scope="module")
def states(env_ranges, batch_reset):
    return batch_reset(env_ranges, jax.random.split(seeds.key(0), 8))


def test_plan_draws_everything_where_it_is(env_ranges, states):
    for i in range(8):
        state = world_of(states, i)
        figure = Figure()
        ax = figure.add_subplot()
        draw_plan(ax, env_ranges, state)
        polygons = [p for p in ax.patches if type(p).__name__ == "Polygon"]
        n_objects = state.world.active["box"].sum() + state.world.active["ramp"].sum()
        assert len(polygons) == n_objects + 4 * 3, "an agent has two hands"
        middles = [(p.get_xy().min(axis=0) + p.get_xy().max(axis=0)) / 2 for p in polygons]
        for body in env_ranges.agents.body_ids:
            assert min(np.linalg.norm(m - state.data.xpos[body][:2]) for m in middles) < 1e-5
        for kind in ("box", "ramp"):
            for body, present in zip(env_ranges.modules[kind].body_ids, state.world.active[kind], strict=True):
                near = [np.linalg.norm(m - state.data.xpos[body][:2]) < 1e-4 for m in middles]
                assert sum(near) == int(present)
        assert len(ax.lines) == 4 + 2, "a heading for every agent and a line for every door"


def test_team_colours_differ(env_ranges, states, tmp_path):
    colours = [tuple(env_ranges.model.geom_rgba[g]) for g in env_ranges.agents.geom_ids]
    assert colours[0] == colours[1] != colours[2] == colours[3]
    contact_sheet(env_ranges, [world_of(states, i) for i in range(3)], tmp_path / "a.png", ["a", "b", "c"])
    assert Image.open(tmp_path / "a.png").size[0] > 900
