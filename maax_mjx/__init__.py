"""maax_mjx: multi-agent reinforcement learning in procedurally generated worlds, on MuJoCo MJX."""

from maax_mjx.runtime import guard_small_hosts

guard_small_hosts()

from maax_mjx.base import Base  # noqa: E402
from maax_mjx.tasks import make  # noqa: E402

__all__ = ["Base", "make"]
