"""Worlds seen from above, drawn with matplotlib: no OpenGL needed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from PIL import Image

from maax_mjx.env import Environment
from maax_mjx.modules import Entities, Placed, Sites
from maax_mjx.physics import World, overlaid_model
from maax_mjx.state import State
from maax_mjx.wrappers import GrabObjects, LockObjects, find

EDGE = "#333333"
DOOR = "#009e73"
GIF_FPS = 25


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
    base = env.base
    ax.clear()
    ax.set_aspect("equal")
    edge = float(state.world.plan.floor_size)
    ax.set_xlim(0, edge)
    ax.set_ylim(0, edge)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.add_patch(Rectangle((0, 0), edge, edge, color="#f4f3ee", zorder=0))
    _draw_walls(ax, state.world)
    model = overlaid_model(base.model, base.overlay, state.world)
    for module in base.modules.values():
        if isinstance(module, Placed):
            for slot in np.flatnonzero(np.asarray(state.world.active[module.kind])):
                if isinstance(module, Entities):
                    _draw_entity(ax, model, state, module, int(slot))
                elif isinstance(module, Sites):
                    _draw_site(ax, state.world, module, int(slot))
    _draw_locks(ax, env, state, model)
    _draw_holds(ax, env, state)
    if title:
        ax.set_title(title, fontsize=8)


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
    figure = Figure(figsize=(3 * columns, 3.15 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    for i, state in enumerate(states):
        ax = figure.add_subplot(rows, columns, i + 1)
        draw_plan(ax, env if isinstance(env, Environment) else env[i], state, titles[i] if titles else "")
    figure.savefig(path, dpi=110)


def gif(env: Environment, states: Iterable[State], path: str | Path, fps: int = GIF_FPS) -> None:
    """Writes one world's states as a moving picture.

    Args:
        env: the environment.
        states: of a single world, in order.
        path: the .gif file.
        fps: frames per second, at most 50, which is what the format can time.
    """
    figure = Figure(figsize=(4, 4.2), layout="constrained")
    canvas = FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    frames = []
    for state in states:
        draw_plan(ax, env, state, f"{float(state.data.time):5.2f} s")
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=1000 // fps, loop=0)


def _draw_walls(ax: Axes, world: World) -> None:
    plan = world.plan
    walls, heights = np.asarray(plan.walls), np.asarray(plan.wall_heights)
    for (x0, y0, x1, y1), height, present in zip(walls, heights, np.asarray(plan.wall_mask), strict=True):
        if present:
            ax.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, color="#444444" if height > 1 else "#8c8c8c", zorder=2))
    for (x, y, width), present in zip(np.asarray(plan.doors), np.asarray(plan.door_mask), strict=True):
        if present:
            along_x = any(abs((w[1] + w[3]) / 2 - y) < 1e-3 and w[2] - w[0] > w[3] - w[1] for w in walls)
            dx, dy = (width / 2, 0) if along_x else (0, width / 2)
            ax.plot([x - dx, x + dx], [y - dy, y + dy], color=DOOR, linewidth=1.5, linestyle=(0, (2, 1.5)), zorder=1)


def _draw_site(ax: Axes, world: World, module: Sites, slot: int) -> None:
    x, y, _ = np.asarray(world.sites[module.kind][slot])
    width, depth, _ = np.asarray(module.extents_of(world)[slot])
    if module.is_round:
        ax.add_patch(Circle((x, y), width / 2, facecolor=module.rgba, edgecolor=EDGE, linewidth=0.6, zorder=1.5))
        return
    corner = (x - width / 2, y - depth / 2)
    ax.add_patch(Rectangle(corner, width, depth, fill=False, edgecolor=module.rgba[:3], linestyle="--", zorder=1.5))


def _draw_entity(ax: Axes, model: mujoco.MjModel, state: State, module: Entities, slot: int) -> None:
    if module.static:
        _draw_geom(ax, model, state, int(module.geom_ids[slot]), zorder=2.5)
        return
    body = int(module.body_ids[slot])
    first = int(model.body_geomadr[body])
    height = float(state.data.xpos[body][2])
    for geom in range(first, first + int(model.body_geomnum[body])):
        _draw_geom(ax, model, state, geom, zorder=3 + height)
    if module.kind == "agent":
        centre = np.asarray(state.data.xpos[body])[:2]
        front = -np.asarray(state.data.geom_xmat[first])[:2, 1]
        tip = centre + 0.28 * front
        ax.plot([centre[0], tip[0]], [centre[1], tip[1]], color="black", linewidth=1.2, zorder=5 + height)


def _draw_locks(ax: Axes, env: Environment, state: State, model: mujoco.MjModel) -> None:
    locking = find(env, LockObjects)
    if locking is None:
        return
    bodies = np.concatenate([m.body_ids for m in locking.modules])
    locks = state.mechanics[locking.name]
    for body, owner in zip(bodies, np.asarray(locks.owner), strict=True):
        if owner >= 0:
            x, y, z = np.asarray(state.data.xpos[body])
            color = model.geom_rgba[env.base.agents.geom_ids[owner]]
            style = dict(edgecolor=color, facecolor="white", linewidth=1.6, zorder=6 + z)
            ax.add_patch(Circle((x, y + 0.07), 0.055, **style))
            ax.add_patch(Rectangle((x - 0.09, y - 0.1), 0.18, 0.15, **(style | {"facecolor": color})))


def _draw_holds(ax: Axes, env: Environment, state: State) -> None:
    grabbing = find(env, GrabObjects)
    if grabbing is None:
        return
    bodies = np.concatenate([m.body_ids for m in grabbing.modules])
    for agent, held in zip(env.base.agents.body_ids, np.asarray(state.mechanics[grabbing.name].held), strict=True):
        if held >= 0:
            ends = np.asarray(state.data.xpos)[[agent, bodies[held]], :2]
            ax.plot(*ends.T, color="black", linewidth=2.5, linestyle=":", zorder=7)


def _draw_geom(ax: Axes, model: mujoco.MjModel, state: State, geom: int, zorder: float) -> None:
    pos, mat = np.asarray(state.data.geom_xpos[geom]), np.asarray(state.data.geom_xmat[geom])
    size, kind = model.geom_size[geom], mujoco.mjtGeom(model.geom_type[geom])
    style = dict(facecolor=model.geom_rgba[geom], edgecolor=EDGE, linewidth=0.6, zorder=zorder)
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        ax.add_patch(Circle((pos[0], pos[1]), size[0], **style))
        return
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * size
        ax.add_patch(Polygon((pos + corners @ mat.T)[:, :2], **style))
        return
    # A ramp: its outline, and an arrow up its slope. The corners come from the compiled mesh, which has a frame of its
    # own.
    mesh = model.geom_dataid[geom]
    start = model.mesh_vertadr[mesh]
    corners = model.mesh_vert[start : start + model.mesh_vertnum[mesh]] @ mat.T + pos
    outline = corners[:, :2]
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    offset = outline - middle
    ax.add_patch(Polygon(outline[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))], **style))
    top = corners[corners[:, 2] > corners[:, 2].mean(), :2].mean(axis=0)
    arrow = dict(arrowstyle="->", color=EDGE, linewidth=0.9)
    ax.annotate("", top, 2 * middle - top, arrowprops=arrow, zorder=zorder + 0.1)
