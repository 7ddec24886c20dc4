"""Worlds seen from above, drawn with matplotlib: no OpenGL needed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge
from matplotlib.patheffects import withStroke

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.viewer.palette import DARK
from maax_mjx.viewer.scene import Frame, Label, Line, Part, furthest, grid_of
from maax_mjx.viewer.stage import Stage

DPI = 100
AROUND = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0, 2 * np.pi, 49)[:-1]])
"""Horizontal directions, in which the furthest points of a solid are its outline from above."""
WIDTHS = {"heading": 1.2, "hold": 2.5, "ray": 0.4, "sight": 1.0, "mark": 2.5}
"""Points: the width of lines, by role."""


def draw_plan(ax: Axes, env: Environment, state: State, title: str = "") -> None:
    """Draws one world: walls (high ones dark), doors (dashed), agents with their heading, boxes, ramps (arrow uphill),
    cylinders, sites; locked objects with a lock in the colour of who locked them, and lines from agents to what they
    hold.

    Args:
        ax: where to draw; cleared first.
        env: the environment.
        state: of a single world, on the host or a device.
        title: above the picture.
    """
    stage = Stage(env)
    draw_frame(ax, stage, stage.frame(state), title)


def draw_frame(ax: Axes, stage: Stage, frame: Frame, title: str = "") -> None:
    """Draws what there is to see of one world.

    Args:
        ax: where to draw; cleared first.
        stage: whose frame it is.
        frame: what to draw.
        title: above the picture.
    """
    ax.clear()
    ax.set_aspect("equal")
    edge = frame.floor_size
    ax.set_xlim(0, edge)
    ax.set_ylim(0, edge)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.add_patch(Rectangle((0, 0), edge, edge, color=frame.floor, zorder=0))
    # Eyes and names are too small for a plan, and a lock is drawn where its label is.
    for part in frame.parts:
        if part.role not in ("eye", "lock"):
            DRAWN.get(part.role, _draw_solid)(ax, stage, part)
    for line in frame.lines:
        _draw_line(ax, line)
    for label in frame.labels:
        if label.role != "name":
            (_draw_lock if label.role == "lock" else _draw_label)(ax, label)
    if title:
        ax.set_title(title, fontsize=8)


def picture(stage: Stage, frames: Sequence[Frame], size: tuple[int, int]) -> np.ndarray:
    """(height, width, 3) uint8 of some worlds side by side, with their words."""
    width, height = size
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    columns, rows = grid_of(len(frames))
    for i, frame in enumerate(frames):
        ax = figure.add_subplot(rows, columns, i + 1)
        draw_frame(ax, stage, frame, "\n".join(frame.text))
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def contact_sheet(
    env: Environment | Sequence[Environment], states: Sequence[State], path: str | Path, titles: Sequence[str] = ()
) -> None:
    """Writes a sheet of worlds, four to a row.

    Args:
        env: the environment, or each world's.
        states: of single worlds.
        path: the image file.
        titles: one per world.
    """
    columns = min(4, len(states))
    rows = -(-len(states) // columns)
    # With inches above, or titles touch the edge.
    figure = Figure(figsize=(3 * columns, 3.15 * rows), layout=ConstrainedLayoutEngine(h_pad=0.1))
    FigureCanvasAgg(figure)
    for i, state in enumerate(states):
        ax = figure.add_subplot(rows, columns, i + 1)
        draw_plan(ax, env if isinstance(env, Environment) else env[i], state, titles[i] if titles else "")
    figure.savefig(path, dpi=110)


def _draw_wall(ax: Axes, stage: Stage, part: Part) -> None:
    (x, y, _), (dx, dy, _) = part.position, part.shape.size
    ax.add_patch(Rectangle((x - dx, y - dy), 2 * dx, 2 * dy, color=part.shape.rgba, zorder=2))


def _draw_door(ax: Axes, stage: Stage, part: Part) -> None:
    (x, y, _), (dx, dy, _) = part.position, part.shape.size
    ends = ([x - dx, x + dx], [y, y]) if dx > dy else ([x, x], [y - dy, y + dy])
    ax.plot(*ends, color=part.shape.rgba, linewidth=1.5, linestyle=(0, (2, 1.5)), zorder=1)


def _draw_site(ax: Axes, stage: Stage, part: Part) -> None:
    (x, y, _), size, rgba = part.position, part.shape.size, part.shape.rgba
    if part.shape.kind != "box":
        ax.add_patch(Circle((x, y), size[0], facecolor=rgba, edgecolor=DARK, linewidth=0.6, zorder=1.5))
        return
    corner = (x - size[0], y - size[1])
    style: dict[str, Any] = dict(fill=False, edgecolor=rgba[:3], linestyle="--", zorder=1.5)
    ax.add_patch(Rectangle(corner, 2 * size[0], 2 * size[1], **style))


def _draw_cone(ax: Axes, part: Part) -> None:
    radius, half = part.shape.size[0], float(np.degrees(part.shape.size[1]))
    ahead = float(np.degrees(np.arctan2(part.rotation[1, 0], part.rotation[0, 0])))
    at = (part.position[0], part.position[1])
    ax.add_patch(Wedge(at, radius, ahead - half, ahead + half, color=part.shape.rgba, linewidth=0, zorder=1.2))


def _draw_solid(ax: Axes, stage: Stage, part: Part) -> None:
    if part.shape.kind == "sector":
        _draw_cone(ax, part)
        return
    vertices = stage.meshes[part.shape.mesh][0] if part.shape.kind == "mesh" else None
    rim = part.position + furthest(part.shape, AROUND @ part.rotation, vertices) @ part.rotation.T
    style = dict(facecolor=part.shape.rgba, edgecolor=DARK, linewidth=0.6, zorder=3 + part.position[2])
    ax.add_patch(Polygon(rim[:, :2], **style))


def _draw_line(ax: Axes, line: Line) -> None:
    if line.role == "slope":
        foot, tip = line.points[0, :, :2]
        arrow = dict(arrowstyle="->", color=line.rgba, linewidth=0.9)
        ax.annotate("", tip, foot, arrowprops=arrow, zorder=3.1 + line.points[0, 0, 2])
        return
    style, width = ":" if line.role == "hold" else "-", WIDTHS.get(line.role, WIDTHS["mark"])
    for ends in line.points:
        zorder = 5 + ends[0, 2] if line.role == "heading" else 7
        ax.plot(*ends[:, :2].T, color=line.rgba, linewidth=width, linestyle=style, zorder=zorder)


def _draw_label(ax: Axes, label: Label) -> None:
    x, y, _ = label.position
    rim = [withStroke(linewidth=1.5, foreground="white")]
    style: dict[str, Any] = dict(color=label.rgba, fontsize=6, ha="center", va="center", clip_on=True)
    ax.text(x, y, label.text, path_effects=rim, zorder=8, **style)


def _draw_lock(ax: Axes, label: Label) -> None:
    x, y, z = label.position
    style = dict(edgecolor=label.rgba, facecolor="white", linewidth=1.6, zorder=6 + z)
    ax.add_patch(Circle((x, y + 0.07), 0.055, **style))
    ax.add_patch(Rectangle((x - 0.09, y - 0.1), 0.18, 0.15, **(style | {"facecolor": label.rgba})))
    ax.text(x, y - 0.025, label.text, color="white", fontsize=5, ha="center", va="center", zorder=6.1 + z)


DRAWN = {"wall": _draw_wall, "high_wall": _draw_wall, "door": _draw_door, "site": _draw_site}
