"""Redraws the pictures of results from their JSON files: `python -m maax_mjx.benchmarks.plots --help`.

A kind of picture is one function of an empty figure and a record's rows; `figures` names the files that it draws.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Row = dict[str, Any]
Curves = dict[str, list[tuple[float, float]]]
Fill = Callable[[Figure, list[Row]], None]

# Okabe and Ito's, which colour-blind readers tell apart; markers differ as well.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKERS = "osD^vXP"
PANEL = (5.0, 4.2)


def sampling(figure: Figure, rows: list[Row]) -> None:
    """Thesis figure 4.4: the time to scatter points on a growing floor, and how full each way makes a floor."""
    names = {"poisson": "Poisson disc (SciPy, host)", "darts": "naive darts (NumPy, host)", "field": "separation field"}

    def way(row: Row) -> str:
        batch = "1 world" if row["worlds"] == 1 else f"{row['worlds']:,} worlds at once"
        return names[row["method"]] + (f", {batch}" if row["method"] == "field" else "")

    sweeps = {
        "edge": ("edge_m", "ms_per_world", "floor edge (m)", "time per world (ms)", "on a growing floor"),
        "density": ("wanted", "found", "points wanted", "points placed (mean)", "on a floor of {edge_m:g} m"),
    }
    shown = list(dict.fromkeys(row["sweep"] for row in rows))
    for sweep, ax in zip(shown, panels(figure, 1, len(shown))[0], strict=True):
        x, y, x_label, y_label, where = sweeps[sweep]
        picked = [row for row in rows if row["sweep"] == sweep]
        where = where.format(**picked[0])
        plot(ax, curves(picked, way, x, y), x_label, y_label, log=sweep == "edge")
        ax.set_title(f"Points {rows[0]['radius_m']:g} m apart {where}", fontsize=10)
    legend(figure)


def load(figure: Figure, rows: list[Row]) -> None:
    """Thesis figure 4.3a: what it takes to load a world, by part, against its size and what is in it."""
    parts = {
        "total_s": "total",
        "spec_s": "MuJoCo spec",
        "model_s": "MuJoCo model",
        "engine_s": "engine",
        "reset_s": "first reset (compiles)",
        "step_s": "first step (compiles)",
        "next_reset_s": "any later reset",
    }
    sweeps = {
        "floor": ("edge_m", "floor edge (m)", "a growing floor"),
        "objects": ("n_boxes", "boxes", "more boxes"),
        "dense": ("edge_m", "floor edge (m)", "a growing floor, boxes per area constant"),
    }
    impls, shown = (list(dict.fromkeys(row[name] for row in rows)) for name in ("impl", "sweep"))
    for impl, axes in zip(impls, panels(figure, len(impls), len(shown)), strict=True):
        for sweep, ax in zip(shown, axes, strict=True):
            x, label, title = sweeps[sweep]
            picked = [row for row in rows if row["impl"] == impl and row["sweep"] == sweep]
            lines = {name: [(row[x], row[part]) for row in picked] for part, name in parts.items()}
            plot(ax, lines, label, "time (s)")
            ax.set_title(f"{impl}: {title}", fontsize=10)
    legend(figure)


def figures() -> dict[str, Fill]:
    """All kinds of pictures, by the beginning of the files' names, up to the first underscore."""
    from maax_mjx.benchmarks import plots_cost, plots_scaling  # which draw with what is here

    return {"sampling": sampling, "load": load, **plots_cost.FIGURES, **plots_scaling.FIGURES}


def draw(path: Path, fill: Fill) -> Path:
    """Draws a record into a PNG of the same name beside it.

    Args:
        path: a JSON file that `record.write` wrote.
        fill: what to draw of its rows.

    Returns:
        The picture's path.

    Raises:
        ValueError: a file that is no such record, or has no rows.
    """
    try:
        record = json.loads(path.read_text())
        rows, where = record["rows"], caption(record["conditions"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"path: got {path}; takes a benchmark's JSON record ({error!r})") from error
    if not rows:
        raise ValueError(f"path: got {path}, which has no rows; takes a record of at least one")
    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    fill(figure, rows)
    figure.supxlabel(where, fontsize=8, color="#555555")
    picture = path.with_suffix(".png")
    figure.savefig(picture, dpi=130)
    return picture


def caption(conditions: dict[str, Any]) -> str:
    """Where and when a record was measured."""
    devices = conditions["devices"]
    count = f"{len(devices)} x " if len(devices) > 1 else ""
    versions = ", ".join(f"{name} {conditions['packages'][name]}" for name in ("jax", "mujoco"))
    return f"{count}{devices[0]}, {conditions['cpus']} CPU cores; {versions}; {conditions['date']}"


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


@dataclass
class Config:
    """Options.

    Attributes:
        folder: whose JSON files are drawn, each into a PNG beside it; files without a kind of picture are passed over.
    """

    folder: Path = Path(__file__).parent / "results"


def main(config: Config) -> None:
    """Draws every picture and prints its path."""
    if not config.folder.is_dir():
        raise ValueError(f"folder: got {config.folder}; takes a folder of JSON records")
    known = figures()
    for path in sorted(config.folder.glob("*.json")):
        fill = known.get(path.stem.split("_")[0])
        if fill is not None:
            print(draw(path, fill))


if __name__ == "__main__":
    main(tyro.cli(Config))
