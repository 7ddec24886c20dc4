"""The scene of a web page of viser's: the frames of worlds as nodes that are made once and moved."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from maax_mjx.common.colours import Colour
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.viewer.camera import FOVY, Camera
from maax_mjx.viewer.palette import DARK, GRID, as_bytes
from maax_mjx.viewer.scene import Frame, Label, Line, Part, Shape, grid_lines, outline
from maax_mjx.viewer.stage import Stage

HERE = "127.0.0.1"
STILL = 1e-4
"""Metres, and parts of a quaternion, by which something has to move to be written down."""


def open_server(what: str, host: str = HERE, port: int = 0) -> Any:
    """Starts a server of viser's, silently.

    Args:
        what: the function that needs it, for messages.
        host: the address it listens at; the default is for this machine alone.
        port: 0 takes a free one.

    Raises:
        MissingLibraryError: viser is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingLibraryError(
            f"{what}: needs viser, which is not installed ({error}); {brought_by('viewer')}"
        ) from error
    with _silent():
        return viser.ViserServer(host=host, port=port, verbose=False)


def stop_server(server: Any) -> None:
    """Stops a server, silently."""
    with _silent():
        server.stop()


@contextmanager
def own_server(what: str) -> Iterator[Any]:
    """A server for this machine alone, at a free port, stopped in the end: without one, viser makes no scenes."""
    server = open_server(what)
    try:
        yield server
    finally:
        stop_server(server)


@contextmanager
def _silent() -> Iterator[None]:
    """Keeps viser from printing."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


class Nodes:
    """Writes frames into a viser scene: what moved is moved, what is gone is hidden.

    Args:
        server: of viser.
        stage: whose frames.
        camera: where the page's camera begins.
        shadows: whether things cast shadows.
    """

    def __init__(self, server: Any, stage: Stage, camera: Camera, shadows: bool):
        self._scene, self._stage = server.scene, stage
        self._nodes: dict[Any, Any] = {}
        self._used: set[Any] = set()
        self._filling = False
        start = server.initial_camera
        start.position, start.look_at, start.fov = tuple(camera.position), tuple(camera.lookat), np.radians(FOVY)
        start.up = (0.0, 0.0, 1.0)
        self._scene.configure_default_lights(enabled=True, cast_shadow=shadows)

    def next(self) -> None:
        """Ends a frame: hides what was not in it."""
        for key, node in self._nodes.items():
            node.visible = key in self._used
        self._used = set()

    def clear(self) -> None:
        """Takes everything away, for another world."""
        for node in self._nodes.values():
            node.remove()
        self._nodes, self._used = {}, set()

    def fill(self, moments: list[list[Frame]], places: np.ndarray) -> None:
        """Adds all that any frame shows, hidden: a browser takes long over what comes while it plays."""
        self._filling = True
        for frames in moments:
            for w, frame in enumerate(frames):
                self.show(w, frame, places[w])
        self._filling, self._used = False, set()
        self.next()

    def show(self, w: int, frame: Frame, offset: np.ndarray) -> None:
        """Adds a world to a frame."""
        world = f"/world{w}"
        self._show_floor(world, frame.floor_size, frame.floor, offset)
        for part in frame.parts:
            self._show_part(world, part, offset)
        for line in frame.lines:
            if line.role != "heading":
                self._show_line(world, line, offset)
        for label in frame.labels:
            self._show_label(world, label, offset, 0.17, "center-center")
        above = np.array([0.0, frame.floor_size, 0.55])
        words = Label("words", "label", "\n".join(frame.text), above, DARK)
        self._show_label(world, words, offset, 0.036 * frame.floor_size, "bottom-left")

    def _show_floor(self, world: str, edge: float, colour: Colour, offset: np.ndarray) -> None:
        half, depth = edge / 2, 0.05
        self._place(
            (world, "floor", edge),
            lambda name: self._scene.add_box(
                name, color=as_bytes(colour), dimensions=(edge, edge, depth), cast_shadow=False
            ),
            np.array([half, half, -depth / 2]) + offset,
        )
        ends = grid_lines(edge)
        if len(ends):
            points = np.concatenate([ends, np.full((len(ends), 2, 1), 0.003)], axis=2).astype(np.float32)
            self._place(
                (world, "grid", edge),
                lambda name: self._scene.add_line_segments(name, points, as_bytes(GRID), thickness=0.02),
                offset,
            )

    def _show_part(self, world: str, part: Part, offset: np.ndarray) -> None:
        key = (world, part.name, part.shape)
        turn = _quaternion(part.rotation)
        self._place(key, lambda name: self._solid(name, part.shape, part.role), part.position + offset, turn)

    def _show_line(self, world: str, line: Line, offset: np.ndarray) -> None:
        key = (world, line.name, line.rgba)
        points = (line.points + offset).round(4).astype(np.float32)
        node = self._nodes.get(key)
        if node is None:
            self._nodes[key] = self._scene.add_line_segments(
                self._name(key), points, as_bytes(line.rgba), thickness=line.width
            )
        elif self._filling:
            return
        elif points.shape != node.points.shape or np.abs(points - node.points).max() > STILL:
            node.points = points
        self._used.add(key)

    def _show_label(self, world: str, label: Label, offset: np.ndarray, height: float, anchor: str) -> None:
        key = (world, label.name)
        self._place(
            key,
            lambda name: self._scene.add_label(
                name, label.text, font_size_mode="scene", font_scene_height=height, anchor=anchor, depth_test=False
            ),
            label.position + offset,
        )
        if not self._filling and self._nodes[key].text != label.text:
            self._nodes[key].text = label.text

    def _place(self, key: Any, add: Any, position: np.ndarray, turn: np.ndarray | None = None) -> None:
        """Puts a solid or a label where it is, made if it is new."""
        turn = np.array([1.0, 0.0, 0.0, 0.0]) if turn is None else turn
        node = self._nodes.get(key)
        if node is None:
            node = self._nodes[key] = add(self._name(key))
            node.position, node.wxyz = position, turn
        elif self._filling:
            return
        if np.abs(node.position - position).max() > STILL:
            node.position = position.round(4)
        # A quaternion and its opposite are the same turn.
        if min(np.abs(node.wxyz - turn).max(), np.abs(node.wxyz + turn).max()) > STILL:
            node.wxyz = turn.round(4) / np.linalg.norm(turn.round(4))
        self._used.add(key)

    def _name(self, key: Any) -> str:
        """The place in the tree of scenes: the same thing in another shape is another node."""
        world, name = key[:2]
        same = sum(other[:2] == (world, name) for other in self._nodes if other != key)
        return f"{world}/{name.replace(':', '_')}" + (f".{same}" if same else "")

    def _solid(self, name: str, shape: Shape, role: str) -> Any:
        import trimesh

        add, size = self._scene, shape.size
        opacity = shape.rgba[3] if shape.rgba[3] < 1 else None
        style = dict(color=as_bytes(shape.rgba), opacity=opacity, cast_shadow=role not in ("door", "cone"))
        if shape.kind == "box":
            return add.add_box(name, dimensions=tuple(2 * s for s in size), **style)
        if shape.kind == "sphere":
            return add.add_icosphere(name, radius=size[0], subdivisions=3 if size[0] > 0.1 else 2, **style)
        if shape.kind == "cylinder":
            return add.add_cylinder(name, radius=size[0], height=2 * size[1], **style)
        if shape.kind == "ellipsoid":
            ball = trimesh.creation.icosphere(subdivisions=3)
            return add.add_mesh_simple(name, ball.vertices * size, ball.faces, **style)
        if shape.kind == "capsule":
            mesh = trimesh.creation.capsule(2 * size[1], size[0])
            mesh.apply_translation([0, 0, -mesh.bounds.mean(axis=0)[2]])
            return add.add_mesh_simple(name, mesh.vertices, mesh.faces, **style)
        if shape.kind == "mesh":
            vertices, faces = self._stage.meshes[shape.mesh]
            return add.add_mesh_simple(name, vertices, faces, flat_shading=True, **style)
        fan = outline(shape)
        faces = np.array([[0, i, i + 1] for i in range(1, len(fan) - 1)])
        return add.add_mesh_simple(name, fan, faces, side="double", receive_shadow=False, **style)


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """(4,) w first, of a rotation matrix (3, 3)."""
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, np.ascontiguousarray(rotation, float).ravel())
    return turn
