"""Marks of mechanics in pictures: the package's own and a user's are in one registry."""

from maax_mjx.viewer.marks import flags, food, grabs, locks, preparation, senses, tag  # noqa: F401  (these register)
from maax_mjx.viewer.marks.agents import draw_agents
from maax_mjx.viewer.marks.ramps import draw_slopes
from maax_mjx.viewer.marks.registry import Mark, marks_for, marks_of

__all__ = ["Mark", "draw_agents", "draw_slopes", "marks_for", "marks_of"]
