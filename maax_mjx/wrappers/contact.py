"""Touches between agents."""

from __future__ import annotations

import jax.numpy as jnp

from maax_mjx.common.checks import check_positive
from maax_mjx.common.observed import AGENT, Observed
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules.agents import DIAMETER
from maax_mjx.wrappers.wrapper import StateWrapper

TOUCH = DIAMETER + 1e-3
"""Metres between the centres of two discs that touch: two radii, and a millimetre of softness."""


class AgentAgentContactMask2D(StateWrapper):
    """Adds `contact_mask` (n_agents, n_agents) bool: which agents touch, seen from above (thesis 5.2.1).

    The mask is symmetric and false on the diagonal; absent agents touch nobody.

    Args:
        env: environment to wrap.
        distance: metres between centres up to which agents touch; None for touching discs.

    Raises:
        ValueError: a distance that is not positive.
    """

    name = "contact"

    def __init__(self, env: Environment, distance: float | None = None):
        super().__init__(env)
        self.distance = TOUCH if distance is None else check_positive("distance", distance)

    def observe(self, state: State) -> State:
        agents = self.base.agents
        xy = state.data.qpos[agents.qpos_ids[:, :2]]
        dx, dy = (along[:, None] - along for along in xy.T)
        near = dx * dx + dy * dy <= self.distance**2
        active = state.world.active[agents.kind]
        mask = near & active & active[:, None] & ~jnp.eye(len(xy), dtype=bool)
        return self.remember(state, mask).replace(obs=state.obs | {"contact_mask": mask})

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | {"contact_mask": Observed((AGENT, AGENT))}
