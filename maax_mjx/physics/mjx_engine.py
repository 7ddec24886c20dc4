"""Base of the engines that step with MJX."""

from __future__ import annotations

from abc import abstractmethod

from mujoco import mjx

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.fields import Fields


class MjxEngine(Engine):
    """An engine whose step is `mjx.step`, or does what it does."""

    def mjx_step(self, model: mjx.Model, data: mjx.Data) -> mjx.Data:
        """A physics step of one world, without what an environment needs of it."""
        return mjx.step(model, data)

    @abstractmethod
    def mjx_model(self, fields: Fields) -> mjx.Model:
        """The mjx.Model of one world."""

    @abstractmethod
    def mjx_data(self, data: Data, n_worlds: int) -> mjx.Data:
        """The mjx.Data of one world, in a batch of `n_worlds` on its device."""
