"""Worlds in three dimensions, drawn by MuJoCo's renderer."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from maax_mjx.common.colours import Colour
from maax_mjx.viewer.camera import FOVY, place_camera
from maax_mjx.viewer.gallery import Box, arrange, initials, lift
from maax_mjx.viewer.gl import open_context
from maax_mjx.viewer.materials import RGB, Paint
from maax_mjx.viewer.palette import DARK, EYE, GRID, SKY, as_bytes, blend
from maax_mjx.viewer.scene import UPRIGHT, Frame, Part, Shape, along, grid_lines, outline, up
from maax_mjx.viewer.stage import Stage

GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}
SECTOR_STEPS = 16
SAMPLES, SHADOW = 8, 4096
FLOOR_DEPTH, GRID_WIDTH, GRID_HEIGHT = 0.05, 0.01, 0.0015
LIGHTS = ((0.36, 0.24), (0.0, 0.5))
"""Ambient and diffuse share of the light at the eye, and of the sun."""
N_LINES = 3
"""Lines of words above each world of a gallery: the time, and what two teams get."""
FROM_ABOVE = -72.0
"""Elevation of the camera in galleries, in degrees: nearer to that of a plan, since what stands up is small there."""
NAMES = 0.026
"""Height of agents' names, as a share of a tile's width."""
CAPTION, BACKED = (12, 8), 0.75
"""Pixels from a picture's upper left to its words, and the share of white in what is behind them."""
SUN = np.array([0.55, -0.15, -1.0])


class Solid:
    """Draws frames of one environment, all of one size and number of worlds. To be closed, or used with `with`.

    Args:
        stage: whose frames.
        n: how many worlds are side by side.
        edge: of the largest floor in metres.
        size: width and height in pixels.
        camera: see `place_camera`.

    Raises:
        MissingLibraryError: there is no OpenGL.
        ValueError: see `place_camera`.
    """

    def __init__(
        self, stage: Stage, n: int, edge: float, size: tuple[int, int], camera: str | Mapping[str, Any] = "default"
    ):
        self._size, self._edge = size, edge
        self._materials = stage.subject.materials
        self._n = n
        self._gallery = arrange(n, size, N_LINES)
        extent = np.array([edge, edge])
        aimed = {"elevation": FROM_ABOVE} if n > 1 and camera == "default" else camera
        self._camera = place_camera(aimed, extent, self._gallery.tile, centred=n > 1)
        # Shadows are sized by the model's extent, and the parked entities of the compiled one are far away.
        self._model = copy.copy(stage.model)
        self._model.stat.extent = float(np.linalg.norm(extent)) / 1.4
        self._model.stat.center[:] = [*extent / 2, 0.0]
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = size
        self._model.vis.quality.offsamples, self._model.vis.quality.shadowsize = SAMPLES, SHADOW
        self._depths = (0.2 * self._camera.distance, 2.5 * self._camera.distance + 2 * self._model.stat.extent)
        self._context = open_context(*size)
        self._gl = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)
        self._scene = mujoco.MjvScene(self._model, maxgeom=4000)

    def __enter__(self) -> Solid:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Gives the OpenGL context back."""
        self._gl.free()
        self._context.free()

    def draw(self, frames: Sequence[Frame]) -> np.ndarray:
        """(height, width, 3) uint8 of worlds side by side, with their words."""
        self._context.make_current()
        width, height = self._size
        tile = self._gallery.tile
        image = np.full((height, width, 3), as_bytes(SKY), np.uint8)
        for i, frame in enumerate(frames):
            self._scene.ngeom = 0
            self._aim()
            ground = self._add(mujoco.mjtGeom.mjGEOM_PLANE, (0, 0, 1), up(-2 * FLOOR_DEPTH), UPRIGHT, SKY)
            ground.emission = 1.0
            self._add_world(frame)
            x, y = self._gallery.corner(i)
            y += self._gallery.strip
            image[y : y + tile[1], x : x + tile[0]] = self._seen(*tile)
        return self._written(image, frames)

    def _seen(self, width: int, height: int) -> np.ndarray:
        """(height, width, 3) of the scene."""
        image, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        rect = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rect, self._scene, self._gl)
        mujoco.mjr_readPixels(image, depth, rect, self._gl)
        # Above the horizon, where MuJoCo leaves it black.
        image[depth >= 1.0] = as_bytes(SKY)
        return np.flipud(image)

    def _aim(self) -> None:
        camera = self._camera
        for eye in self._scene.camera:
            eye.pos, eye.forward, eye.up = camera.position, camera.forward, camera.up
            near, far = self._depths
            half = near * np.tan(np.radians(FOVY) / 2)
            eye.frustum_near, eye.frustum_far = near, far
            eye.frustum_bottom, eye.frustum_top, eye.frustum_center, eye.frustum_width = -half, half, 0.0, 0.0
        # What lies in the shadow of one light is lit by the others, of which the first is at the eye, as MuJoCo has it.
        for i, (ambient, diffuse) in enumerate(LIGHTS):
            light = self._scene.lights[i]
            light.type, light.headlight, light.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, i == 0, i > 0
            light.ambient, light.diffuse, light.specular = [ambient] * 3, [diffuse] * 3, [0.05 * i] * 3
            light.dir = camera.forward if i == 0 else SUN / np.linalg.norm(SUN)
            # Shadows are cut off at the same depths as the picture, counted from the light.
            light.pos = camera.position if i == 0 else self._model.stat.center - np.mean(self._depths) * light.dir
        self._scene.nlight = len(LIGHTS)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 1
        for off in (mujoco.mjtRndFlag.mjRND_SKYBOX, mujoco.mjtRndFlag.mjRND_HAZE, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[off] = 0

    def _add_world(self, frame: Frame) -> None:
        edge = frame.floor_size / 2
        floor = Shape("box", (edge, edge, FLOOR_DEPTH / 2), frame.floor)
        self._add_part(Part("floor", "floor", floor, np.array([edge, edge, -FLOOR_DEPTH / 2]), UPRIGHT))
        for (x0, y0), (x1, y1) in grid_lines(frame.floor_size):
            half = ((x1 - x0) / 2 + GRID_WIDTH, (y1 - y0) / 2 + GRID_WIDTH, GRID_HEIGHT / 2)
            middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2, GRID_HEIGHT / 2])
            self._add_part(Part("grid", "floor", Shape("box", half, GRID), middle, UPRIGHT))
        for part in frame.parts:
            self._add_part(part)
        for line in frame.lines:
            if line.role != "heading":
                for ends in line.points:
                    self._add_bar(ends, line.width / 2, line.rgba)

    def _add_part(self, part: Part) -> None:
        shape, position = part.shape, part.position
        if shape.kind == "sector":
            corners = outline(shape, SECTOR_STEPS) @ part.rotation.T + position
            for i in range(1, len(corners) - 1):
                self._add_triangle(corners[0], corners[i], corners[i + 1], shape.rgba)
            return
        geom = self._add(GEOMS[shape.kind], shape.size or (1.0,) * 3, position, part.rotation, shape.rgba)
        # Of every mesh the context has two: the mesh and its convex hull.
        geom.dataid = 2 * shape.mesh if shape.kind == "mesh" else -1
        # What lies on the ground would only cast specks on itself.
        geom.castshadow = part.role not in ("floor", "door", "cone")
        if shape.material >= 0:
            self._texture(geom, shape)

    def _texture(self, geom: Any, shape: Shape) -> None:
        model, material = self._model, shape.material
        geom.matid, geom.texid = material, model.mat_texid[material, RGB]
        geom.texrepeat, geom.texuniform = model.mat_texrepeat[material], model.mat_texuniform[material]
        geom.rgba = self._materials.tint(Paint(shape.rgba, material))

    def _add_bar(self, ends: np.ndarray, radius: float, rgba: Colour) -> None:
        way = ends[1] - ends[0]
        # A bar that ran down to nothing has no direction.
        if not way.any():
            return
        size = (radius, float(np.linalg.norm(way)) / 2)
        line = self._add(mujoco.mjtGeom.mjGEOM_CAPSULE, size, ends.mean(axis=0), along(way), rgba)
        line.castshadow = 0

    def _add_triangle(self, a: np.ndarray, b: np.ndarray, c: np.ndarray, rgba: Colour) -> None:
        # MuJoCo draws the triangle of the ends of the first two axes of its frame, and of its origin.
        sides = [b - a, c - a]
        lengths = [float(np.linalg.norm(side)) for side in sides]
        rotation = np.stack([sides[0] / lengths[0], sides[1] / lengths[1], [0.0, 0.0, 1.0]], axis=1)
        self._add(mujoco.mjtGeom.mjGEOM_TRIANGLE, (lengths[0], lengths[1], 0.0), a, rotation, rgba)

    def _add(self, kind: int, size: Sequence[float], at: np.ndarray, rotation: np.ndarray, rgba: Colour) -> Any:
        scene = self._scene
        if scene.ngeom >= scene.maxgeom:
            raise RuntimeError(f"render: a picture of more than {scene.maxgeom} solids; take fewer worlds")
        geom = scene.geoms[scene.ngeom]
        colour = np.asarray(rgba, np.float32)
        sizes = np.zeros(3)
        sizes[: len(size)] = size
        mujoco.mjv_initGeom(geom, kind, sizes, np.asarray(at, float), rotation.ravel(), colour)
        geom.category, geom.specular, geom.shininess = mujoco.mjtCatBit.mjCAT_DYNAMIC, 0.1, 0.2
        scene.ngeom += 1
        return geom

    def _written(self, image: np.ndarray, frames: Sequence[Frame]) -> np.ndarray:
        """The picture with the names of agents, and the words of every world."""
        picture, gallery = Image.fromarray(image), self._gallery
        pen = ImageDraw.Draw(picture)
        small = ImageFont.load_default(max(9, round(gallery.tile[0] * NAMES)))
        large = ImageFont.load_default(gallery.letters if gallery.strip else max(9, round(gallery.tile[0] * 0.03)))
        edged: dict[str, Any] = {"stroke_width": 2, "stroke_fill": "white"}
        for i, frame in enumerate(frames):
            x, y = gallery.corner(i)
            taken: list[Box] = []
            for label in frame.labels if gallery.has_names else ():
                at = self._camera.project(label.position[None], gallery.tile)[0] + (x, y + gallery.strip)
                is_short = label.role == "name" and gallery.is_narrow
                text, anchor = (initials(label.text), "mb") if is_short else (label.text, "mm")
                colour = as_bytes(blend(label.rgba, EYE, 0.25))
                box = pen.textbbox(tuple(at), text, font=small, anchor=anchor)
                up = lift(box, taken)
                taken.append((box[0], box[1] - up, box[2], box[3] - up))
                at = at - (0, up)
                pen.text(tuple(at), text, fill=colour, font=small, anchor=anchor, **edged)
            if not gallery.strip:
                caption(picture, frame.text, large)
                continue
            # A picture of its own, over whose edge no word goes.
            strip = Image.new("RGB", (gallery.tile[0], gallery.strip), as_bytes(SKY))
            lines = [_cut(line, large, gallery.tile[0] - 6) for line in gallery.fitting(frame.text)]
            ImageDraw.Draw(strip).multiline_text((4, 1), "\n".join(lines), fill=as_bytes(DARK), font=large, spacing=2)
            picture.paste(strip, (x, y))
        return np.asarray(picture).copy()


def caption(picture: Image.Image, lines: Sequence[str], font: Any) -> None:
    """Writes the words of a single world into its picture, on a pale box: walls and names may be behind them.

    Args:
        picture: written into.
        lines: of the words.
        font: of them.
    """
    pen, words = ImageDraw.Draw(picture), "\n".join(lines)
    x0, y0, x1, y1 = pen.multiline_textbbox(CAPTION, words, font=font, spacing=1)
    box = max(0, int(x0) - 6), max(0, int(y0) - 5), min(picture.width, int(x1) + 7), min(picture.height, int(y1) + 6)
    behind = picture.crop(box)
    picture.paste(Image.blend(behind, Image.new("RGB", behind.size, "white"), BACKED), box[:2])
    pen.multiline_text(CAPTION, words, fill=as_bytes(DARK), font=font, spacing=1)


def _cut(line: str, font: Any, width: int) -> str:
    """The phrases of a line, which are some blanks apart, that fit into a width in pixels, the first one at least."""
    phrases = re.split(r"\s{2,}", line)
    while len(phrases) > 1 and font.getlength("   ".join(phrases)) > width:
        phrases.pop()
    return "   ".join(phrases)
