"""Complete environments by name."""

from maax_mjx.tasks.registry import make, tasks
from maax_mjx.tasks.standard import standard

__all__ = ["make", "standard", "tasks"]
