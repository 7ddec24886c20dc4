"""The camera: from where pictures are taken."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

FOVY = 40.0
ANGLES = {"default": (90.0, -55.0), "top": (90.0, -89.9)}
TAKES = ("azimuth", "elevation", "distance", "lookat")
ROOM = 0.5
"""Metres above the floor that are to be in the picture."""
CENTRED = 3
"""Times that the camera is centred and steps back."""


class Camera(NamedTuple):
    """A camera with a vertical field of view of 40 degrees.

    Attributes:
        position: (3,) metres.
        forward: (3,) unit vector.
        up: (3,) unit vector.
        lookat: (3,) metres, what is in the middle of the picture.
    """

    position: np.ndarray
    forward: np.ndarray
    up: np.ndarray
    lookat: np.ndarray

    @property
    def distance(self) -> float:
        """Metres to what is in the middle."""
        return float(np.linalg.norm(self.lookat - self.position))

    def project(self, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """(n, 2) pixels from the upper left of points (n, 3) in front of the camera."""
        width, height = size
        away = np.asarray(points, float) - self.position
        right = np.cross(self.forward, self.up)
        depth = np.maximum(away @ self.forward, 1e-6)
        scale = height / 2 / np.tan(np.radians(FOVY) / 2) / depth
        return np.stack([width / 2 + away @ right * scale, height / 2 - away @ self.up * scale], axis=1)


def place_camera(
    camera: str | Mapping[str, Any],
    extent: np.ndarray,
    size: tuple[int, int],
    words: float = 0.0,
    centred: bool = False,
) -> Camera:
    """A camera that has all worlds in its picture.

    Args:
        camera: "default" (from the south, above), "top", or any of azimuth and elevation in degrees as MuJoCo counts
            them (azimuth 90 looks along y, elevation -90 down), distance in metres and lookat (3,).
        extent: (2,) metres along x and y from the origin that the worlds cover.
        size: width and height in pixels.
        words: metres of words above the far edge, which are to be in the picture too.
        centred: whether what is seen has as much room above as below, instead of more above, for words.

    Raises:
        ValueError: an unknown camera, or numbers out of range.
    """
    given: dict[str, Any] = {}
    if isinstance(camera, str) and camera in ANGLES:
        azimuth, elevation = ANGLES[camera]
    elif isinstance(camera, Mapping) and set(camera) <= set(TAKES):
        given = dict(camera)
        azimuth, elevation = (given.get(name, ANGLES["default"][i]) for i, name in enumerate(TAKES[:2]))
    else:
        raise ValueError(f"camera: got {camera!r}; takes one of {sorted(ANGLES)}, or a dict with any of {list(TAKES)}")
    try:
        lookat = np.asarray(given.get("lookat", [*extent / 2, 0.1]), float)
        azimuth, elevation, distance = (float(value) for value in (azimuth, elevation, given.get("distance", 1.0)))
        whole = lookat.shape == (3,) and np.isfinite([*lookat, azimuth, elevation]).all() and 0 < distance < np.inf
    except (TypeError, ValueError):
        whole = False
    if not whole:
        raise ValueError(f"camera: got {camera!r}; takes finite numbers, a distance above 0, and a lookat of three")
    looking = _looking(azimuth, elevation, distance, lookat)
    if "distance" in given:
        return looking
    corners = _corners(extent, words)
    looking = _step_back(looking, corners, size)
    # What is far away is small: the middle of the floor is not that of the picture.
    for _ in range(CENTRED if centred and "lookat" not in given else 0):
        looking = _step_back(_centred(looking, corners, size), corners, size)
    return looking


def _looking(azimuth: float, elevation: float, distance: float, lookat: np.ndarray) -> Camera:
    a, e = np.radians(azimuth), np.radians(elevation)
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])
    return Camera(lookat - distance * forward, forward, up, lookat)


def _corners(extent: np.ndarray, words: float) -> np.ndarray:
    """(8, 3) metres, the corners of what is to be seen."""
    x, y = extent
    return np.array([[i * x, j * y, z] for i in (0, 1) for j in (0, 1) for z in (0.0, ROOM + j * words)])


def _centred(camera: Camera, corners: np.ndarray, size: tuple[int, int]) -> Camera:
    """The camera moved upwards or downwards, so that the corners are as far from the upper as from the lower edge."""
    height = camera.project(corners, size)[:, 1]
    off = size[1] / 2 - (height.min() + height.max()) / 2
    metres = off / (size[1] / 2) * np.tan(np.radians(FOVY) / 2) * camera.distance
    return camera._replace(position=camera.position + metres * camera.up, lookat=camera.lookat + metres * camera.up)


def _step_back(camera: Camera, corners: np.ndarray, size: tuple[int, int]) -> Camera:
    """The camera as far away as it takes to see all corners, with a margin."""
    away = corners - camera.lookat
    tangent = np.tan(np.radians(FOVY) / 2) * 0.95
    right = np.cross(camera.forward, camera.up)
    sideways = np.maximum(np.abs(away @ right) * size[1] / size[0], np.abs(away @ camera.up))
    distance = float(np.max(sideways / tangent - away @ camera.forward))
    return camera._replace(position=camera.lookat - distance * camera.forward)
