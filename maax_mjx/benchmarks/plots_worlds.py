"""Pictures of `sampling` and `load`: what it takes to make worlds."""

from __future__ import annotations

from matplotlib.figure import Figure

from maax_mjx.benchmarks.axes import Fill, Row, curves, legend, panels, plot


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


FIGURES: dict[str, Fill] = {"sampling": sampling, "load": load}
"""Kinds of pictures by benchmark."""
