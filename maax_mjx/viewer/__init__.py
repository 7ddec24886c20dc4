"""Pictures of worlds."""

from maax_mjx.viewer.plan import contact_sheet, draw_plan, gif

__all__ = ["contact_sheet", "draw_plan", "gif"]
