"""Curves of a run as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maax_mjx.common.whole import whole

POINTS = 400
"""Points of a curve; of more, neighbours are averaged."""
WINDOW = 20
"""Iterations of a running mean."""
PANELS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("reward per step", ("reward_",)),
    ("caught, share of the steps", ("episode_caught",)),
    ("metres", ("episode_max_",)),
    ("objects locked (number)", ("episode_boxes_locked", "episode_ramps_locked")),
    ("entropy, nats", ("entropy_",)),
    ("explained variance", ("explained_",)),
    ("divergence; share clipped", ("kl", "clipped")),
    ("env steps/s", ("env_steps_per_s",)),
)
"""Titles of the panels, and the beginnings of the names of what they show."""


def draw_curves(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draws the metrics of a run over its env steps, completely or not at all.

    Args:
        rows: a dict per iteration.
        path: the picture.
    """
    if not rows:
        return
    # Not pyplot, which would choose a backend for the user's own figures.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = sorted({name for row in rows for name in row})
    panels = [(title, [n for n in names if n.startswith(starts)]) for title, starts in PANELS]
    panels = [(title, found) for title, found in panels if found]
    figure = Figure(figsize=(11, 2.6 * -(-len(panels) // 2)), layout="constrained")
    FigureCanvasAgg(figure)
    for i, (title, found) in enumerate(panels):
        axes = figure.add_subplot(-(-len(panels) // 2), 2, i + 1)
        for name in found:
            kept = [(row["steps"], row[name]) for row in rows if _tells(row, name)]
            if kept:
                points = np.asarray(kept, float)
                x, y = _thinned(points)
                (pale,) = axes.plot(x / 1e6, y, alpha=0.25, linewidth=1)
                x, y = _thinned(np.stack([points[:, 0], _running(points[:, 1])], axis=1))
                label = name.removeprefix("episode_").replace("_", " ")
                axes.plot(x / 1e6, y, label=label, color=pale.get_color(), linewidth=1.4)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("million env steps", fontsize=8)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
        if axes.lines:
            axes.legend(fontsize=7)
    figure.suptitle(f"pale: every iteration; full: the mean of the last {WINDOW}", fontsize=8)
    with whole(path) as part:
        figure.savefig(part, dpi=100)


def _tells(row: Mapping[str, Any], name: str) -> bool:
    """Whether a row has a number of that name; those of episodes mean nothing where none ended."""
    return row.get(name) is not None and bool(row.get("episodes", 1) or not name.startswith("episode_"))


def _running(values: np.ndarray) -> np.ndarray:
    """The mean of each of some values (n,) and those before it, of a window at most."""
    return np.stack([values[max(0, i + 1 - WINDOW) : i + 1].mean() for i in range(len(values))])


def _thinned(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns x and y of at most some points (n, 2), each the mean of its neighbours."""
    groups = np.array_split(points, min(len(points), POINTS))
    means = np.stack([group.mean(axis=0) for group in groups])
    return means[:, 0], means[:, 1]
