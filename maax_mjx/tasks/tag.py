"""Tag."""

from __future__ import annotations

from dataclasses import dataclass

from maax_mjx.core.env import Environment
from maax_mjx.tasks.observe import observed_by_agents
from maax_mjx.tasks.standard import CountRange, GameConfig, Placement, standard
from maax_mjx.wrappers import AgentAgentContactMask2D, Tag, TeamMembership


@dataclass(frozen=True)
class TagConfig(GameConfig):
    """Four players in a room with boxes and a ramp; one of them is it. The players are the slots of `n_hiders`.

    Attributes:
        immunity: see `Tag`.
    """

    scenario: str = "empty"
    n_hiders: CountRange = 4
    n_seekers: CountRange = 0
    n_boxes: CountRange = (1, 3)
    hider_placement: Placement = "uniform"
    immunity: int = 50


def tag(config: TagConfig) -> Environment:
    """Builds the game of a config.

    Raises:
        ValueError: what the world and the wrappers refuse.
    """
    env: Environment = AgentAgentContactMask2D(TeamMembership(standard(config)))
    env = Tag(env, config.immunity, config.reward_scale)
    return observed_by_agents(env, config.observations, config.observe, ["is_it"])
