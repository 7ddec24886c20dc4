"""Complete environments by name."""

from maax_mjx.tasks.registry import jitted, make, tasks
from maax_mjx.tasks.standard import standard

__all__ = ["jitted", "make", "standard", "tasks"]
