"""What every picture of a world shows, as plain numbers: solids, lines, labels and words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from maax_mjx.common.colours import Colour

UPRIGHT = np.eye(3)
GAPS = (0.12, 0.34, 0.0)
"""Shares of a world's edge: the gaps between worlds side by side; above each is room for its words."""


@dataclass(frozen=True)
class Shape:
    """What a solid looks like, in its own frame.

    Attributes:
        kind: "box" (size: half extents), "sphere" (radius), "cylinder" (radius, half height), "capsule" (radius, half
            length), "ellipsoid" (half axes), "mesh", or "sector" of a disc that points along x (radius, half angle in
            radians).
        size: metres, but for the angle.
        rgba: its colour.
        mesh: of a mesh, its number in the model.
        material: number in the model of its textured material, of which `rgba` is the mean; -1 without a texture.
    """

    kind: str
    size: tuple[float, ...]
    rgba: Colour
    mesh: int = -1
    material: int = -1


class Part(NamedTuple):
    """One solid.

    Attributes:
        name: unique in its frame, and the same in all frames.
        role: "wall", "high_wall", "door", "agent", "hand", "eye", "object", "site", "flag", "lock", "it", "cone", or
            "mark" for any other mark.
        shape: what it looks like.
        position: (3,) metres.
        rotation: (3, 3) from its own frame.
    """

    name: str
    role: str
    shape: Shape
    position: np.ndarray
    rotation: np.ndarray


class Line(NamedTuple):
    """Straight lines of one colour.

    Attributes:
        name: unique in its frame, and the same in all frames.
        role: "heading", "slope", "hold", "ray", "sight", or "mark" for any other mark.
        points: (n, 2, 3) ends in metres.
        rgba: their colour.
        width: metres.
    """

    name: str
    role: str
    points: np.ndarray
    rgba: Colour
    width: float


class Label(NamedTuple):
    """A short text at a place.

    Attributes:
        name: unique in its frame, and the same in all frames.
        role: "name" of an agent, which plans leave out; "lock" of who locked something, which plans draw as a padlock
            with it; or "label" for any other.
        text: what it says.
        position: (3,) metres.
        rgba: its colour.
    """

    name: str
    role: str
    text: str
    position: np.ndarray
    rgba: Colour


class Frame(NamedTuple):
    """One world at one time.

    Attributes:
        floor_size: edge of the floor in metres.
        floor: the floor's colour.
        parts: all solids but the floor.
        lines: all lines.
        labels: all texts in the world.
        text: lines of words: the time, what teams get, what mechanics add.
    """

    floor_size: float
    floor: Colour
    parts: list[Part]
    lines: list[Line]
    labels: list[Label]
    text: list[str]

    def named(self, role: str) -> list[Part]:
        """The solids of one role."""
        return [part for part in self.parts if part.role == role]


def up(height: float) -> np.ndarray:
    """(3,) so many metres above."""
    return np.array([0.0, 0.0, height])


def turned(angle: float) -> np.ndarray:
    """(3, 3) the rotation about z by an angle in radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def along(direction: np.ndarray) -> np.ndarray:
    """(3, 3) a rotation that turns z to a direction (3,)."""
    z = np.asarray(direction, float) / max(float(np.linalg.norm(direction)), 1e-9)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def furthest(shape: Shape, directions: np.ndarray, vertices: np.ndarray | None = None) -> np.ndarray:
    """(n, 3) the points of a solid that are furthest in directions (n, 3), all in its own frame.

    Args:
        shape: a solid, no sector.
        directions: unit vectors.
        vertices: (m, 3) of a mesh.
    """
    if vertices is not None:
        return vertices[np.argmax(directions @ vertices.T, axis=1)]
    size, ends = np.asarray(shape.size), np.sign(directions) * (np.abs(directions) > 1e-9)
    if shape.kind == "box":
        return ends * size
    if shape.kind == "ellipsoid":
        return directions * size**2 / np.linalg.norm(directions * size, axis=1, keepdims=True)
    if shape.kind == "sphere":
        return directions * size
    axis = ends * [0.0, 0.0, size[1]]
    if shape.kind == "capsule":
        return directions * size[0] + axis
    flat = directions * [1.0, 1.0, 0.0]
    return size[0] * flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9) + axis


def outline(shape: Shape, steps: int = 24) -> np.ndarray:
    """(steps + 2, 3) of a sector: its corner, and its arc from one end to the other."""
    radius, half = shape.size
    angles = np.linspace(-half, half, steps + 1)
    arc = radius * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    return np.concatenate([np.zeros((1, 3)), arc])


def grid_of(n: int) -> tuple[int, int]:
    """(columns, rows) of the squarest grid that n worlds fit in."""
    columns = int(np.ceil(np.sqrt(n)))
    return columns, -(-n // columns)


def offsets(n: int, edge: float) -> np.ndarray:
    """(n, 3) where the lower-left corners of n worlds go, the first one in the upper left.

    Args:
        n: how many.
        edge: of the largest floor in metres.
    """
    columns, rows = grid_of(n)
    at = [(i % columns, rows - 1 - i // columns, 0) for i in range(n)]
    return np.array(at, float) * edge * (1 + np.array(GAPS))


def grid_lines(edge: float) -> np.ndarray:
    """(n, 2, 2) ends of the lines of a floor, a metre apart."""
    at = np.arange(1.0, edge - 1e-6)
    lines = [[[value, 0.0], [value, edge]] for value in at] + [[[0.0, value], [edge, value]] for value in at]
    return np.array(lines, float).reshape(-1, 2, 2)
