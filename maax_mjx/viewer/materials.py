"""Colours and textures of geoms and sites, as MuJoCo shows them."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np

from maax_mjx.common.colours import Colour

UNSET = (0.5, 0.5, 0.5, 1.0)
"""The colour of what was given none, for which its material's stands."""
RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


class Paint(NamedTuple):
    """What a geom or site is painted with.

    Attributes:
        rgba: its colour; of a textured one the mean, which views without textures show.
        material: number in the model of its textured material; -1 without a texture.
    """

    rgba: Colour
    material: int = -1


class Materials:
    """Looks up the paint of a model's geoms and sites.

    Args:
        model: the compiled model.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model = model

    def of_geom(self, geom: int) -> Paint:
        """Paint of a geom."""
        return self._paint(self._model.geom_rgba[geom], int(self._model.geom_matid[geom]))

    def of_site(self, site: int) -> Paint:
        """Paint of a site."""
        return self._paint(self._model.site_rgba[site], int(self._model.site_matid[site]))

    def tint(self, paint: Paint) -> Colour:
        """The colour by which the texture of a paint is multiplied to look like its `rgba` in the mean."""
        mean = np.maximum(self.means[paint.material], 1e-3)
        red, green, blue = np.minimum(np.array(paint.rgba[:3]) / mean, 1.0).tolist()
        return red, green, blue, paint.rgba[3]

    @cached_property
    def means(self) -> dict[int, np.ndarray]:
        """Mean colour (3,) in [0, 1] of every textured material's texture."""
        textures = {int(m): int(ids[RGB]) for m, ids in enumerate(self._model.mat_texid) if ids[RGB] >= 0}
        return {material: self._mean(texture) for material, texture in textures.items()}

    def _mean(self, texture: int) -> np.ndarray:
        model = self._model
        channels = int(model.tex_nchannel[texture])
        n = int(model.tex_height[texture]) * int(model.tex_width[texture]) * channels
        start = int(model.tex_adr[texture])
        pixels = model.tex_data[start : start + n].reshape(-1, channels)
        # A texture of one channel is grey.
        return np.broadcast_to(pixels.mean(axis=0)[:3] / 255, 3)

    def _paint(self, own: np.ndarray, material: int) -> Paint:
        rgba = own if material < 0 or not np.allclose(own, UNSET) else self._model.mat_rgba[material]
        textured = material in self.means
        shown = rgba[:3] * self.means[material] if textured else rgba[:3]
        red, green, blue = shown.tolist()
        return Paint((red, green, blue, float(rgba[3])), material if textured else -1)
