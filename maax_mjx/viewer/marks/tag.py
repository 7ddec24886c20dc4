"""Mark of tag: a disc over the agent that is it."""

from __future__ import annotations

from maax_mjx.core.state import State
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.marks.registry import marks_of
from maax_mjx.viewer.palette import IT
from maax_mjx.viewer.scene import up
from maax_mjx.wrappers import Tag


@marks_of(Tag)
def draw_it(layer: Tag, state: State, canvas: Canvas) -> None:
    """A disc over the agent that is it."""
    it = int(state.mechanics[layer.name].it)
    canvas.solid("it", "cylinder", (0.1, 0.03), canvas.position(it) + up(0.2), IT, role="it")
