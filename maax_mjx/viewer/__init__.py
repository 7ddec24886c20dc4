"""Pictures of worlds: still, moving, and as a web page."""

from __future__ import annotations

from typing import Any

from maax_mjx.viewer.marks import marks_of
from maax_mjx.viewer.record import record
from maax_mjx.viewer.render import render, video
from maax_mjx.viewer.replay import Replay, replay

PLAN = ("contact_sheet", "draw_plan")

__all__ = ["Replay", "contact_sheet", "draw_plan", "marks_of", "record", "render", "replay", "video"]


def __getattr__(name: str) -> Any:
    # matplotlib takes long to import, and only plans need it.
    if name in PLAN:
        from maax_mjx.viewer import plan

        return getattr(plan, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
