"""Pictures of `transfer` and `compare`: what agents learn, and with what."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from maax_mjx.benchmarks.axes import COLOURS, Fill, Row, legend, panels
from maax_mjx.benchmarks.transfer import SCRATCH


def transfer(figure: Figure, rows: list[Row]) -> None:
    """Returns over env steps, a panel for every task: each run thin, the mean of the seeds thick."""
    tasks = list(dict.fromkeys(row["env"] for row in rows))
    begins = sorted({row["begin"] for row in rows}, key=lambda begin: begin != SCRATCH)
    for ax, task in zip(panels(figure, 1, len(tasks))[0], tasks, strict=True):
        for begin, colour in zip(begins, COLOURS, strict=False):
            runs = [np.array(row["curve"]) for row in rows if (row["env"], row["begin"]) == (task, begin)]
            for run in runs:
                ax.plot(run[:, 0] / 1e6, run[:, 1], color=colour, linewidth=0.6, alpha=0.5)
            steps = runs[0][:, 0]
            mean = np.mean([np.interp(steps, run[:, 0], run[:, 1]) for run in runs], axis=0)
            name = "from scratch" if begin == SCRATCH else "from hide-and-seek"
            ax.plot(steps / 1e6, mean, color=colour, linewidth=1.8, label=name)
        ax.set_title(task, fontsize=10)
        ax.set_xlabel("million env steps")
        ax.set_ylabel("return of an episode")
        ax.grid(alpha=0.3, linewidth=0.5)
    legend(figure, 2)


def compare(figure: Figure, rows: list[Row]) -> None:
    """Numbers of runs over env steps, a panel for every number and a colour for every label."""
    labels = list(dict.fromkeys(row["run"] for row in rows))
    numbers = list(rows[0]["curves"])
    n_rows = 2 if len(numbers) == 4 else 1
    axes = [ax for row in panels(figure, n_rows, len(numbers) // n_rows) for ax in row]
    for ax, number in zip(axes, numbers, strict=True):
        for i, label in enumerate(labels):
            runs = [row["curves"][number] for row in rows if row["run"] == label]
            for j, run in enumerate(runs):
                x, y = np.array(run).T
                named = {"label": label} if j == 0 else {}
                ax.plot(x / 1e6, y, color=COLOURS[i % len(COLOURS)], linewidth=1.2, **named)
        ax.set_title(number.removeprefix("episode_").replace("_", " "), fontsize=10)
        ax.set_xlabel("million env steps")
        ax.grid(alpha=0.3, linewidth=0.5)
    legend(figure)


FIGURES: dict[str, Fill] = {"transfer": transfer, "compare": compare}
"""Kinds of pictures by the beginning of a file's name."""
