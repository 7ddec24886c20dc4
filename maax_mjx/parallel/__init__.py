"""Batches of worlds, on one device or many."""

from maax_mjx.parallel.checkpoint import Checkpoints
from maax_mjx.parallel.episodes import Visited, WorldsState
from maax_mjx.parallel.faults import Fault, load_fault
from maax_mjx.parallel.recording import Recording
from maax_mjx.parallel.worlds import Worlds

__all__ = ["Checkpoints", "Fault", "Recording", "Visited", "Worlds", "WorldsState", "load_fault"]
