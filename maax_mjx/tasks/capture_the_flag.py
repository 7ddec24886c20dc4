"""Capture the flag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from maax_mjx.common.annotated import Count, Positive, PositiveCount
from maax_mjx.core.env import Environment
from maax_mjx.modules import Flags
from maax_mjx.tasks.observe import observed_by_agents
from maax_mjx.tasks.standard import GameConfig, Number, ScenarioNames, TeamPlacements, sides_of, world
from maax_mjx.wrappers import AgentAgentContactMask2D, CaptureTheFlag, TeamMembership


@dataclass(frozen=True)
class CaptureTheFlagConfig(GameConfig):
    """Two against two, each team in its own room with a base and a door between; a few boxes to hide behind.

    The rules are those of `CaptureTheFlag`.

    Attributes:
        teams: agents per world by team, or (low, high); two teams.
        agent_placement: where agents start; one for all, or one by team.
        reach: see `CaptureTheFlag`.
        wins_at: see `CaptureTheFlag`.
    """

    scenario: ScenarioNames = "half"
    n_boxes: Number = (1, 3)
    n_ramps: Number = 0
    teams: Mapping[str, Number] = field(default_factory=lambda: {"blues": 2, "reds": 2})
    agent_placement: TeamPlacements = ("room0", "room1")
    door_size: Count = 6
    reach: Positive = 0.4
    wins_at: PositiveCount = 3


def capture_the_flag(config: CaptureTheFlagConfig) -> Environment:
    """Builds the game of a config.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    base = world(config, sides_of(config.teams, config.agent_placement))
    base.add_module(Flags())
    env: Environment = AgentAgentContactMask2D(TeamMembership(base))
    env = CaptureTheFlag(env, config.reach, config.wins_at, config.reward_scale)
    return observed_by_agents(env, config.observations, config.observe)
