"""The game of tag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from maax_mjx.common.annotated import Count
from maax_mjx.core.env import Environment
from maax_mjx.tasks.observe import observed_by_agents
from maax_mjx.tasks.standard import GameConfig, Number, ScenarioNames, TeamPlacements, sides_of, world
from maax_mjx.wrappers import AgentAgentContactMask2D, Tag, TeamMembership


@dataclass(frozen=True)
class TagConfig(GameConfig):
    """Players in a room with boxes and a ramp; one of them is it.

    Attributes:
        teams: agents per world by team, or (low, high); with one team, everybody plays against the agent that is it.
        agent_placement: where agents start; one for all, or one by team.
        immunity: see `Tag`.
    """

    scenario: ScenarioNames = "empty"
    teams: Mapping[str, Number] = field(default_factory=lambda: {"players": 4})
    agent_placement: TeamPlacements = "uniform"
    n_boxes: Number = (1, 3)
    immunity: Count = 50


def tag(config: TagConfig) -> Environment:
    """Builds the game of a config.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    base = world(config, sides_of(config.teams, config.agent_placement))
    env: Environment = AgentAgentContactMask2D(TeamMembership(base))
    env = Tag(env, config.immunity, config.reward_scale)
    return observed_by_agents(env, config.observations, config.observe)
