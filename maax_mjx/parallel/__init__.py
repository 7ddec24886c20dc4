"""Many worlds at once."""

from maax_mjx.parallel.worlds import Worlds, WorldsState

__all__ = ["Worlds", "WorldsState"]
