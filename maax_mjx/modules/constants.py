"""Modules of whole worlds: the floor's friction, gravity."""

from __future__ import annotations

import jax
import mujoco
import numpy as np

from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout
from maax_mjx.modules.from_model import from_model
from maax_mjx.modules.module import Module
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Overlay
from maax_mjx.worldgen.checks import check_rgba


class FloorAttributes(Module):
    """Attributes of the floor.

    Args:
        friction: sliding friction, or a range drawn per world. MuJoCo uses the larger one of two geoms in contact.
        rgba: the floor's colour; None keeps the default.

    Raises:
        ValueError: a negative friction, or a colour that is not four numbers in [0, 1].
    """

    name = "floor"

    def __init__(self, friction: float | tuple[float, float] = 1.0, rgba: tuple[float, ...] | None = None):
        self.friction = Ranged("floor_friction", friction, argument="friction")
        self.rgba = None if rgba is None else check_rgba("rgba", rgba)

    @property
    def parameters(self) -> list[Parameter]:
        return self.friction.parameters

    @property
    def overlay(self) -> Overlay:
        return {"geom_friction": self._geom_id} if self.friction.varies else {}

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        floor = spec.geom("floor")
        floor.friction[0] = self.friction.high
        if self.rgba is not None:
            floor.rgba = self.rgba

    @from_model
    def _geom_id(self) -> np.ndarray:
        return np.array([self.model.geom("floor").id])

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        if not self.friction.varies:
            return layout
        friction = layout.fields["geom_friction"].at[self._geom_id, 0].set(self.friction.draw(key, params, 1))
        return layout.replace(fields=layout.fields | {"geom_friction": friction})


class WorldConstants(Module):
    """Physical constants of a world.

    Args:
        gravity: along z in m/s^2 (negative is down), or a range drawn per world. OpenAI's games use -50.

    Raises:
        ValueError: a gravity that is not finite.
    """

    name = "world_constants"

    def __init__(self, gravity: float | tuple[float, float]):
        self.gravity = Ranged("gravity", gravity, -np.inf)

    @property
    def parameters(self) -> list[Parameter]:
        return self.gravity.parameters

    @property
    def overlay(self) -> Overlay:
        return {"opt.gravity": np.array([2])} if self.gravity.varies else {}

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        spec.option.gravity[2] = self.gravity.low

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        if not self.gravity.varies:
            return layout
        gravity = layout.fields["opt.gravity"].at[2].set(self.gravity.draw(key, params, 1)[0])
        return layout.replace(fields=layout.fields | {"opt.gravity": gravity})
