"""Pieces that all pictures of results are drawn with."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

Row = dict[str, Any]
"""A row of a record, as JSON has it."""
Curves = dict[str, list[tuple[float, float]]]
"""Points (x, y) by the name of their curve."""
Fill = Callable[[Figure, list[Row]], None]
"""A kind of picture: draws the rows of a record into an empty figure."""

# Okabe and Ito's, which colour-blind readers tell apart; markers differ as well.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKERS = "osD^vXP"
PANEL = (5.0, 4.2)
"""Inches of one panel, width and height."""


def panels(figure: Figure, n_rows: int, n_columns: int) -> list[list[Axes]]:
    """A figure's empty axes, row by row."""
    figure.set_size_inches(PANEL[0] * n_columns, PANEL[1] * n_rows)
    return figure.subplots(n_rows, n_columns, squeeze=False).tolist()


def curves(rows: Iterable[Row], name: Callable[[Row], str], x: str, y: str) -> Curves:
    """The points (x, y) of every curve by its name, in the order of the rows."""
    found: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
    for row in rows:
        found[name(row)].append((row[x], row[y]))
    return dict(found)


def plot(ax: Axes, lines: Curves, x: str, y: str, *, log: bool = True) -> None:
    """Draws curves, with the labels of both axes, over a logarithmic y axis or a plain one."""
    for (name, points), colour, marker in zip(lines.items(), COLOURS, MARKERS, strict=False):
        ax.plot(*zip(*points, strict=True), color=colour, marker=marker, markersize=4, linewidth=1.3, label=name)
    ax.set_yscale("log" if log else "linear")
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.grid(alpha=0.3, linewidth=0.5)


def legend(figure: Figure, columns: int = 4) -> None:
    """One legend for all panels, above them; they have the same curves."""
    lines, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(lines, names, loc="outside upper center", ncols=columns, fontsize=8)
