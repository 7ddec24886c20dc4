"""The picture of a run's metrics."""

import numpy as np
import pytest
from helpers import seeds
from matplotlib.figure import Figure

from maax_mjx.training.curves import draw_curves


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Draws rows, and returns the panels by their titles."""
    figures = []

    def keep(figure, path, **_):
        figures.append(figure)
        path.touch()

    monkeypatch.setattr(Figure, "savefig", keep)

    def draw(rows):
        draw_curves(rows, tmp_path / "curves.png")
        return {axes.get_title(): axes for axes in figures[-1].axes}

    return draw


def test_a_running_mean_is_above_pale_iterations(drawn):
    noisy = seeds.rng(0).normal(size=100)
    rows = [{"steps": 1e6 * (i + 1), "reward_seekers": x} for i, x in enumerate(noisy)]
    pale, mean = drawn(rows)["reward per step"].lines
    assert (pale.get_alpha(), pale.get_color()) == (0.25, mean.get_color())
    assert (mean.get_alpha(), mean.get_label()) == (None, "reward seekers")
    assert mean.zorder >= pale.zorder
    np.testing.assert_allclose(pale.get_ydata(), noisy)
    np.testing.assert_allclose(mean.get_ydata()[[0, 9, 99]], [noisy[0], noisy[:10].mean(), noisy[80:].mean()])
    np.testing.assert_allclose(mean.get_xdata(), np.arange(1, 101))


def test_numbers_of_objects_say_so_and_iterations_without_an_end_are_left_out(drawn):
    rows = [{"steps": i, "episodes": i % 2, "episode_boxes_locked": 2.0 * (i % 2), "kl": 0.1} for i in range(40)]
    panels = drawn(rows)
    np.testing.assert_allclose(panels["objects locked (number)"].lines[1].get_ydata(), [2.0] * 20)
    assert len(panels["divergence; share clipped"].lines[0].get_ydata()) == 40
