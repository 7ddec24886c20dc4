"""Pictures of `transfer`: what agents learn with and without what they knew before."""

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


FIGURES: dict[str, Fill] = {"transfer": transfer}
"""Kinds of pictures by the beginning of a file's name."""
