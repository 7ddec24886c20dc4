"""What a layout becomes: in what one world differs from the compiled model."""

from __future__ import annotations

import jax
from flax import struct

from maax_mjx.layout.plan import RoomPlan


class World(struct.PyTreeNode):
    """What is particular to one world of a batch. Everything else is shared by the compiled model.

    Attributes:
        fields: by MuJoCo's name, the rows of model fields in which worlds differ: `geom_pos` (n_walls, 3), ... Which
            rows they are is the environment's `overlay`.
        active: by entity kind ("agent", "box", ...), (n_max,) bool: which of the entities are in play.
        extents: by kind, (n_max, 3) metres along the objects' own axes, of kinds whose sizes worlds differ in.
        sites: by kind ("food", ...), (n_max, 3) the centres of marks that nothing collides with, in metres.
        plan: the walls and doors.
        valid: () bool; False where the layout could not hold all that was drawn. What found no place is not in play.
    """

    fields: dict[str, jax.Array]
    active: dict[str, jax.Array]
    extents: dict[str, jax.Array]
    sites: dict[str, jax.Array]
    plan: RoomPlan
    valid: jax.Array
