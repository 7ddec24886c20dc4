"""A recording as one web page: viser's scenes, which play without a server."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from maax_mjx.common.checks import check_bool, check_count, check_path, check_positive
from maax_mjx.common.colours import Colour
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.core.env import Environment
from maax_mjx.viewer.between import smooth
from maax_mjx.viewer.camera import FOVY, Camera, place_camera
from maax_mjx.viewer.film import Picked, film, paced
from maax_mjx.viewer.palette import DARK, GRID, as_bytes
from maax_mjx.viewer.scene import Frame, Label, Line, Part, Shape, grid_lines, offsets, outline
from maax_mjx.viewer.stage import Stage

ENDINGS = (".html", ".htm")
FPS = 30
HEIGHT = 500
SHAPE_OF_PAGE = (16, 10)
WORDS = 0.2
"""Height of the words above a world, as a share of its edge."""
STILL = 1e-4
"""Metres, and parts of a quaternion, by which something has to move to be written down."""


class Replay:
    """A recording as a web page, which a notebook shows in its cell.

    Attributes:
        html: the page, whole: it fetches nothing.
        n_frames: how many frames it has.
        seconds: how long it plays.
    """

    def __init__(self, page: str, n_frames: int, seconds: float):
        self.html, self.n_frames, self.seconds = page, n_frames, seconds

    def save(self, path: str | Path) -> Path:
        """Writes the page into a file that ends in .html."""
        path = check_path("path", path, ENDINGS)
        path.write_text(self.html, encoding="utf-8")
        return path

    def _repr_html_(self) -> str:
        # A frame of its own keeps the page's styles and keys apart from the notebook's.
        return (
            f'<iframe srcdoc="{html.escape(self.html, quote=True)}" width="100%" height="{HEIGHT}" '
            'style="border: 1px solid #ddd" allowfullscreen></iframe>'
        )

    def __repr__(self) -> str:
        size = len(self.html) / 1e6
        return f"Replay({self.n_frames} frames, {self.seconds:.1f} s, {size:.1f} MB; .save('replay.html') writes it)"


def replay(
    env: Environment,
    states: Any,
    path: str | Path | None = None,
    *,
    worlds: Picked = None,
    speed: float = 1.0,
    fps: int = FPS,
    vision: bool = False,
    lidar: bool = False,
    camera: str | Mapping[str, Any] = "default",
    shadows: bool = True,
) -> Replay:
    """Makes a web page that plays worlds: with play, pause, a time line, speeds, and a camera to turn by mouse.

    One file that opens offline: 0.8 MB for what plays it, and 0.03 to 0.05 MB for every 10 s of a world. Of states up
    to 0.2 s apart, as in games of long steps, it also shows moments in between, on straight ways.

    Args:
        env: the environment.
        states: a `Recording`; a list of states of single worlds or of batches; or one state with the leading axis
            (n_frames,) or axes (n_frames, n_worlds), as `jax.lax.scan` stacks them.
        path: where to write the page, a file that ends in .html; None writes none.
        worlds: which of a batch, an index or several, side by side; None is the first one, or all of a recording.
        speed: of the page's 1x; 1 is real time.
        fps: frames per second of the page, at most; states in between are left out.
        vision: whether to show who sees where and whom; needs `LineOfSight`.
        lidar: whether to show the rays of `Lidar`, which it needs.
        camera: where it begins: "default", "top", or a dict with any of azimuth and elevation in degrees, distance in
            metres and lookat (3,).
        shadows: whether things cast shadows, which take a browser without a GPU most of its time.

    Returns:
        The page. At the end of a notebook's cell it shows itself.

    Raises:
        ValueError: an argument out of its range, states of another environment, a sense that it does not have.
        MissingLibraryError: viser is not installed.
    """
    shadows = check_bool("shadows", shadows)
    speed, fps = check_positive("speed", speed), check_count("fps", fps, minimum=1)
    if path is not None:
        path = check_path("path", path, ENDINGS)
    stage = Stage(env, vision=vision, lidar=lidar)
    shown = smooth(film(env, states, worlds), fps / speed)
    shown = shown.at(paced(shown.times / speed, fps))
    n_worlds = len(shown.states[0])
    edge = shown.edge
    places = offsets(n_worlds, edge)
    extent = places.max(axis=0)[:2] + edge
    with _server() as server:
        page = _Page(server, stage, place_camera(camera, extent, SHAPE_OF_PAGE, WORDS * edge), shadows)
        moments = [
            [stage.frame(state, row) for state, row in zip(states_now, returns, strict=True)]
            for states_now, returns in zip(shown.states, shown.returns, strict=True)
        ]
        page.fill(moments, places)
        last = 0.0
        for frames, time in zip(moments, shown.times / speed, strict=True):
            page.wait(float(time) - last)
            last = float(time)
            for w, frame in enumerate(frames):
                page.show(w, frame, places[w])
            page.next()
        # The last frame stays as long as the others before the page begins again.
        page.wait(last / max(len(shown.times) - 1, 1))
        made = Replay(page.html(), len(shown.times), last)
    if path is not None:
        made.save(path)
    return made


@contextmanager
def _server() -> Iterator[Any]:
    """The server of viser, without which it makes no scenes: for this machine alone, at a free port, silent."""
    try:
        import rich
        import viser
    except ImportError as error:
        raise MissingLibraryError(
            f"replay: needs viser, which is not installed ({error}); {brought_by('viewer')}"
        ) from error
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = before


class _Page:
    """Writes frames into a viser scene: what moved is moved, what is gone is hidden."""

    def __init__(self, server: Any, stage: Stage, camera: Camera, shadows: bool):
        self._scene, self._stage = server.scene, stage
        self._nodes: dict[Any, Any] = {}
        self._used: set[Any] = set()
        self._filling = False
        start = server.initial_camera
        start.position, start.look_at, start.fov = tuple(camera.position), tuple(camera.lookat), np.radians(FOVY)
        start.up = (0.0, 0.0, 1.0)
        self._scene.configure_default_lights(enabled=True, cast_shadow=shadows)
        self._serializer = server.get_scene_serializer()

    def wait(self, seconds: float) -> None:
        """Lets time pass."""
        self._serializer.insert_sleep(max(seconds, 0.0))

    def html(self) -> str:
        """The page."""
        return self._serializer.as_html()

    def next(self) -> None:
        """Ends a frame: hides what was not in it."""
        for key, node in self._nodes.items():
            node.visible = key in self._used
        self._used = set()

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
