"""Capture the flag."""

from __future__ import annotations

from dataclasses import dataclass

from maax_mjx.core.env import Environment
from maax_mjx.modules import Flags
from maax_mjx.tasks.observe import observed_by_agents
from maax_mjx.tasks.standard import CountRange, GameConfig, Placement, standard
from maax_mjx.wrappers import AgentAgentContactMask2D, CaptureTheFlag, TeamMembership


@dataclass(frozen=True)
class CaptureTheFlagConfig(GameConfig):
    """Two against two, each in a room of its own with a base and a door between; a few boxes to hide behind.

    The teams are the slots of `n_hiders` and of `n_seekers`. The rules are those of `CaptureTheFlag`.

    Attributes:
        reach, wins_at: see `CaptureTheFlag`.
    """

    scenario: str = "half"
    n_boxes: CountRange = (1, 3)
    n_ramps: CountRange = 0
    hider_placement: Placement = "room0"
    seeker_placement: Placement = "room1"
    door_size: int = 6
    reach: float = 0.4
    wins_at: int = 3


def capture_the_flag(config: CaptureTheFlagConfig) -> Environment:
    """Builds the game of a config.

    Raises:
        ValueError: what the world and the wrappers refuse.
    """
    base = standard(config)
    base.add_module(Flags())
    env: Environment = AgentAgentContactMask2D(TeamMembership(base))
    env = CaptureTheFlag(env, config.reach, config.wins_at, config.reward_scale)
    return observed_by_agents(env, config.observations, config.observe, ["carries", "is_out"])
