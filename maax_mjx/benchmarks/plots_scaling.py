"""Pictures of `scaling`, `engines` and `objects`, beside what the thesis measured (dashed)."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from maax_mjx.benchmarks.axes import COLOURS, MARKERS, Curves, Fill, Row, curves, legend, panels, plot

BATCHES = (2, 4, 8, 16, 32, 64, 128, 256, 512)
THESIS = {
    "thesis: M": (148.9, 310.2, 624.0, 681.9, 835.3, 943.9, 1011.1, 1049.3, 1069.5),
    "thesis: M without outer walls": (149.8, 300.5, 603.9, 1203.8, 2476.0, 4996.3, 10087.2, 10966.4, 13302.5),
    "thesis: Ant": (217.3, 427.0, 839.1, 1585.6, 2801.5, 5158.6, 7730.8, 10115.3, 10023.3),
}
"""Steps per second of `BATCHES`, in Brax on a Quadro 6000 (figure 6.3, table 6.1)."""
THESIS_MUJOCO = (411.3, 705.1, 874.3, 869.2, 883.6, 879.7, 878.4, 882.1)
"""Steps per second of M in MuJoCo on 8 cores, batches 2 to 256 (figure 6.4)."""
THESIS_OBJECTS = {
    ("boxes", "walls"): (10.8, 15.4, 15.8, 16.9, 20.3, 22.5, 25.4, 27.7, 31.8, 35.5),
    ("boxes", "none"): (4.2, 16.3, 16.5, 16.5, 16.7, 16.6, 16.6, 16.5, 16.6, 16.6),
    ("ramps", "walls"): (10.7, 16.7, 16.9, 17.7, 20.8, 23.1, 25.7, 28.3, 32.4, 36.0),
}
"""Seconds for 1,000 steps of a single world with 0 to 9 objects (figure 6.1)."""
DASHES = ("#888888", "#bbbbbb", "#555555")
SHOWN = 1000
"""Env steps that times are shown for, as in the thesis."""


def scaling(figure: Figure, rows: list[Row]) -> None:
    """Thesis figure 6.3: time and steps per second against the batch, an engine a row."""
    rows = _measured(rows)
    outer = {"": "", "walls": "", "none": " without outer walls", "limits": " with limits for walls"}
    steps = {"env": "env steps", "bare": "engine alone"}
    impls = list(dict.fromkeys(row["impl"] for row in rows))
    iterations = list(dict.fromkeys(row["iterations"] for row in rows))

    def name(row: Row) -> str:
        solver = f", {row['iterations']} iterations" if len(iterations) > 1 else ""
        return f"{row['scene'].split('-')[0]}{outer[row['outer']]}, {steps[row['what']]}{solver}"

    for impl, (left, right) in zip(impls, panels(figure, len(impls), 2), strict=True):
        picked = sorted((row for row in rows if row["impl"] == impl), key=lambda row: row["worlds"])
        times = [row | {"shown_s": row["seconds"] * SHOWN / row["steps"]} for row in picked]
        _batches(left, curves(times, name, "worlds", "shown_s"), f"time per {SHOWN:,} steps (s)")
        _batches(right, curves(picked, name, "worlds", "steps_per_s"), "steps per second, all worlds")
        dashed(left, {k: [(n, n * SHOWN / y) for n, y in zip(BATCHES, v, strict=True)] for k, v in THESIS.items()})
        dashed(right, {k: list(zip(BATCHES, v, strict=True)) for k, v in THESIS.items()})
        for ax in (left, right):
            ax.set_title(f"{impl}, {_iterations(iterations)}\n{_lengths(picked)}", fontsize=9)
    legend(figure, 3)


def engines(figure: Figure, rows: list[Row]) -> None:
    """Thesis figure 6.4: the engines' steps per second, and faulty worlds; solid lines: most iterations."""
    rows = sorted(_measured(rows), key=lambda row: row["worlds"])
    names, held, iterations = (list(dict.fromkeys(r[k] for r in rows)) for k in ("engine", "held", "iterations"))
    iterations.sort(reverse=True)
    for n, (left, right) in zip(sorted(held), panels(figure, len(held), 2), strict=True):
        for engine, colour, marker in zip(names, COLOURS, MARKERS, strict=False):
            for count, style in zip(iterations, ("-", ":", "-."), strict=False):
                picked = [r for r in rows if (r["engine"], r["held"], r["iterations"]) == (engine, n, count)]
                x = [row["worlds"] for row in picked]
                look: dict[str, Any] = dict(
                    color=colour, marker=marker, linestyle=style, label=f"{engine}, {count} iterations"
                )
                if picked:
                    left.plot(x, [row["steps_per_s"] for row in picked], **look)
                    right.plot(x, [100 * row["faults"] / row["worlds"] for row in picked], **look)
        dashed(
            left,
            {
                "thesis: M in Brax": list(zip(BATCHES, THESIS["thesis: M"], strict=True)),
                "thesis: M in MuJoCo, 8 cores": list(zip(BATCHES, THESIS_MUJOCO, strict=False)),
            },
        )
        protocol = "actions redrawn" if n == 1 else f"full force held for {n} steps"
        _batches(left, {}, "steps per second, all worlds")
        _batches(right, {}, "faulty worlds at the end (%)", log=False)
        right.set_ylim(-4, 104)
        for ax in (left, right):
            ax.set_title(f"{protocol}\n{_lengths(rows)}", fontsize=9)
    legend(figure, 3)


def objects(figure: Figure, rows: list[Row]) -> None:
    """Thesis figures 6.1 and 4.3b: time of a rollout against boxes, ramps and the floor, an engine a row."""
    rows = _measured(rows)
    closed = {"walls": "outer walls", "none": "no outer walls", "limits": "limits"}
    impls, sweeps = (list(dict.fromkeys(row[name] for row in rows)) for name in ("impl", "sweep"))
    sweeps.sort(key=["boxes", "ramps", "floor"].index)
    for impl, axes in zip(impls, panels(figure, len(impls), len(sweeps)), strict=True):
        for sweep, ax in zip(sweeps, axes, strict=True):
            x = {"boxes": "n_boxes", "ramps": "n_ramps", "floor": "edge_m"}[sweep]
            picked = [row for row in rows if (row["impl"], row["sweep"]) == (impl, sweep)]
            picked.sort(key=lambda row: row[x])
            picked = [row | {"shown_s": row["seconds"] * SHOWN / row["steps"]} for row in picked]
            label = f"time per {SHOWN:,} steps (s)"
            if sweep == "floor":
                parts = {
                    "shown_s": label,
                    "build_s": "building the model (s)",
                    "compile_s": "compilation and start (s)",
                }
                lines = {name: [(row[x], row[part]) for row in picked] for part, name in parts.items()}
                plot(ax, lines, "floor edge (m); boxes at each point", "time (s)")
                for row in picked:
                    ax.annotate(f"{row['n_boxes']}", (row[x], row["shown_s"]), (0, 5), textcoords="offset points")
            else:
                lines = curves(picked, lambda row: f"{closed[row['outer']]}, {row['joints']}", x, "shown_s")
                plot(ax, lines, sweep, label)
                theirs = {k: v for k, v in THESIS_OBJECTS.items() if k[0] == sweep}
                dashed(ax, {f"thesis, one world: {closed[k[1]]}": list(enumerate(v)) for k, v in theirs.items()})
            ax.set_title(f"{impl}: {picked[0]['worlds']:,} worlds; {_lengths(picked)}" if picked else impl, fontsize=9)
            ax.margins(y=0.35)  # Room for the legend.
            ax.legend(fontsize=7, ncols=2, loc="lower center")


def dashed(ax: Axes, lines: Curves) -> None:
    """Adds the thesis's curves."""
    for (name, points), colour in zip(lines.items(), DASHES, strict=False):
        ax.plot(*zip(*points, strict=True), color=colour, linestyle="--", linewidth=1.2, label=name)


def _batches(ax: Axes, lines: Curves, y: str, *, log: bool = True) -> None:
    plot(ax, lines, "worlds", y, log=log)
    ax.set_xscale("log", base=2)


def _measured(rows: list[Row]) -> list[Row]:
    found = [row for row in rows if row["seconds"] is not None]
    if not found:
        raise ValueError("rows: none was measured; takes at least one with figures")
    return found


def _iterations(iterations: list[int]) -> str:
    return f"{iterations[0]} solver iterations" if len(iterations) == 1 else "solver iterations as named"


def _lengths(rows: list[Row]) -> str:
    """Lengths of the rollouts, where they differ by the batch."""
    most: dict[int, int] = {}
    for row in rows:
        most[row["steps"]] = max(most.get(row["steps"], 0), row["worlds"])
    ordered = sorted(most.items(), key=lambda item: item[1])
    if len(ordered) == 1:
        return f"T = {ordered[0][0]:,}"
    return ", ".join(f"T = {steps:,} up to {worlds:,} worlds" for steps, worlds in ordered)


FIGURES: dict[str, Fill] = {"scaling": scaling, "engines": engines, "objects": objects}
"""Kinds of pictures by benchmark."""
