"""Holding objects."""

from maax_mjx.wrappers.grabs.wrapper import GrabObjects, Grabs

__all__ = ["GrabObjects", "Grabs"]
