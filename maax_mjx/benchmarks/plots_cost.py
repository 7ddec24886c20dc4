"""Pictures of `breakdown`, `kernels`, `fidelity`, `memory`: what a step costs, how true it is, what memory it takes."""

from __future__ import annotations

from matplotlib.figure import Figure

from maax_mjx.benchmarks.axes import COLOURS, Fill, Row, curves, legend, panels, plot

IDLE = "idle"
GREY = "#bbbbbb"
MB = 1e6


def breakdown(figure: Figure, rows: list[Row]) -> None:
    """An env step's parts, stacked, for every game and engine: the time of one world's physics step."""
    ax = panels(figure, 1, 1)[0][0]
    figure.set_size_inches(3.4 + 1.6 * len(rows), 5.0)
    names = [f"{row['env']}\n{row['impl']}, {row['worlds']:,} worlds\n{row['n_frames']} physics steps" for row in rows]
    worlds_frames = [row["worlds"] * row["n_frames"] for row in rows]
    bottom = [0.0] * len(rows)
    parts = [part for part in rows[0]["parts_us"] if any(row["parts_us"][part] for row in rows)]
    seen = [part for part in parts if part != IDLE]
    colours = dict(zip(seen, [*COLOURS, "#f0e442", "#8c564b", "#555555"], strict=False))
    for part in parts:
        shares = [row["parts_us"][part] / row["traced_us"] for row in rows]
        ax.bar(
            names, shares, 0.6, bottom, color=colours.get(part, GREY), label="idle or unseen" if part == IDLE else part
        )
        bottom = [low + share for low, share in zip(bottom, shares, strict=True)]
    for i, (row, n) in enumerate(zip(rows, worlds_frames, strict=True)):
        ax.text(i, 1.01, f"{row['step_us']:,.0f} us\n{1e3 * row['step_us'] / n:,.0f} ns", ha="center", fontsize=8)
    ax.set_ylim(0, 1.12)
    ax.set_ylabel("share of an env step")
    ax.set_title("Above: an env step of all worlds, and per world and physics step", fontsize=9)
    ax.tick_params(axis="x", labelsize=8)
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside right center", fontsize=8)


def kernels(figure: Figure, rows: list[Row]) -> None:
    """Groups of kernels of a physics step, for every game and batch: their time, and that of their traffic alone."""
    games, sizes = (list(dict.fromkeys(row[name] for row in rows)) for name in ("env", "worlds"))
    axes = panels(figure, len(sizes), len(games))
    for row in rows:
        ax = axes[sizes.index(row["worlds"])][games.index(row["env"])]
        names = list(row["groups_us"])[::-1]
        ax.barh(names, [row["groups_us"][name] / 1e3 for name in names], 0.7, color=COLOURS[0], label="time")
        ax.barh(
            names,
            [row["traffic_us"][name] / 1e3 for name in names],
            0.3,
            color=COLOURS[1],
            label="memory traffic alone",
        )
        ax.set_title(f"{row['env']}, {row['worlds']:,} worlds: {row['step_us'] / 1e3:.1f} ms a step", fontsize=8)
        ax.set_xlabel("ms per physics step of all worlds")
        ax.tick_params(axis="y", labelsize=7)
        ax.grid(axis="x", alpha=0.3, linewidth=0.5)
    legend(figure)


def fidelity(figure: Figure, rows: list[Row]) -> None:
    """The price of the thesis's 5 iterations: position errors against iterations, per engine."""
    rows = sorted(rows, key=lambda row: (row["impl"], row["iterations"]))
    spans = {"free": f"after {rows[0]['steps']} steps of its own", "single": "after one step from the same state"}
    axes = panels(figure, 2, 2)
    for line, who in zip(axes, ("agents", "objects"), strict=True):
        for ax, (run, when) in zip(line, spans.items(), strict=True):
            name = f"{run}_{who}_m"
            drawn = [{**row, "median": row[name][0]} for row in rows]
            plot(ax, curves(drawn, lambda row: row["impl"], "iterations", "median"), "solver iterations", "error (m)")
            for colour, impl in zip(COLOURS, dict.fromkeys(row["impl"] for row in rows), strict=False):
                own = [row for row in rows if row["impl"] == impl]
                x = [row["iterations"] for row in own]
                half, most, nearly_all = zip(*(row[name] for row in own), strict=True)
                ax.fill_between(x, half, most, color=colour, alpha=0.18)
                ax.plot(x, nearly_all, ":", color=colour, linewidth=1.2)
            ax.axvline(5, color="#555555", linewidth=0.8, linestyle="--")
            ax.set_xticks(sorted({row["iterations"] for row in rows}))
            ax.set_title(f"{who.capitalize()}, {when}", fontsize=10)
    axes[0][0].annotate("thesis", (5, axes[0][0].get_ylim()[1]), (3, -10), textcoords="offset points", fontsize=8)
    lines, names = axes[0][0].get_legend_handles_labels()
    figure.legend(
        lines,
        names,
        loc="outside upper center",
        ncols=len(names),
        fontsize=9,
        title_fontsize=9,
        title="Positions against converged MuJoCo, the largest error of each world: median (line), "
        "to 90 % of worlds (shade), 99 % (dots)",
    )


def memory(figure: Figure, rows: list[Row]) -> None:
    """Memory that states and steps of a batch take, and that the pool, the device or the host had to hold."""
    takes = {
        "step_bytes": "compiled step",
        "reset_bytes": "compiled reset",
        "pool_peak_bytes": "JAX's pool, peak",
        "outside_pool_bytes": "on the device outside the pool",
        "host_peak_bytes": "the process on the host, peak",
    }
    batches = list(dict.fromkeys((row["env"], row["impl"]) for row in rows))
    for (env, impl), ax in zip(batches, panels(figure, 1, len(batches))[0], strict=True):
        own = sorted(
            (row for row in rows if (row["env"], row["impl"]) == (env, impl) and row["fits"]),
            key=lambda row: row["worlds"],
        )
        lines = {"states": [(row["worlds"], row["state_bytes_per_world"] * row["worlds"] / MB) for row in own]}
        for name, label in takes.items():
            lines[label] = [(row["worlds"], row[name] / MB) for row in own if row[name] is not None]
        plot(ax, {label: points or [(float("nan"),) * 2] for label, points in lines.items()}, "worlds", "MB")
        ax.set_xscale("log", base=2)
        for limit in {row["pool_limit_bytes"] for row in own if row["pool_limit_bytes"]}:
            ax.axhline(limit / MB, color="#555555", linewidth=0.8, linestyle="--")
        biggest = [f"{row['worlds']:,} worlds fit" for row in own if row["asked"] == "largest"]
        each = f"{own[-1]['state_bytes_per_world'] / 1e3:.1f} kB a world's state" if own else "nothing fitted"
        ax.set_title("\n".join([f"{env}, {impl}: {each}", *biggest]), fontsize=9)
    legend(figure, 3)


FIGURES: dict[str, Fill] = {"breakdown": breakdown, "kernels": kernels, "fidelity": fidelity, "memory": memory}
"""Kinds of pictures by benchmark."""
