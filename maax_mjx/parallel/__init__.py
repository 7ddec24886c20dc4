"""Batches of worlds, on one device or many."""

from maax_mjx.parallel.checkpoint import Checkpoints
from maax_mjx.parallel.episodes import WorldsState
from maax_mjx.parallel.worlds import Worlds

__all__ = ["Checkpoints", "Worlds", "WorldsState"]
