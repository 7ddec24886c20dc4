"""What the transfer tasks share: one agent with the body, the senses and the hands of hide-and-seek."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from maax_mjx.common.annotated import NonNegativeRange, OneOf, PositiveCount, PositiveRange
from maax_mjx.core.env import Environment
from maax_mjx.modules import Module
from maax_mjx.tasks.hide_and_seek import GrabConfig, LidarConfig, LockConfig, arguments, with_lidar
from maax_mjx.tasks.observe import OBSERVATIONS, observed_by_agents
from maax_mjx.tasks.published import as_published
from maax_mjx.tasks.standard import GameConfig, Number, Placement, ScenarioNames, Side, world
from maax_mjx.tasks.transfer.made_up import with_made_up
from maax_mjx.worldgen import WorldParams
from maax_mjx.wrappers import (
    AgentAgentContactMask2D,
    DiscretizeActions,
    GrabObjects,
    LineOfSight,
    LockObjects,
    LockTogether,
    PreparationPhase,
    TeamMembership,
)
from maax_mjx.wrappers.actions import Bins
from maax_mjx.wrappers.senses import BETWEEN, CONE, Cone
from maax_mjx.wrappers.teams import HIDERS


@dataclass(frozen=True)
class TransferConfig(GameConfig):
    """One agent, a hider, as in the published games; see `QuadrantConfig`.

    Attributes:
        agent_placement: where the agent starts.
        published: whether the details of the published code come with it, each unless its field is set otherwise; see
            `maax_mjx.tasks.published`.
        cone: full angle of `LineOfSight` in radians.
        cone_between: what cones are measured between, "centres" or "corners"; see `LineOfSight`.
        lock, grab, lidar: arguments of the wrappers; locks have a choice for every object, which `LockTogether` joins.
        n_bins: bins of the movement, see `DiscretizeActions`; None takes forces.
        made_up: whether split observations have the agents, the ramp and the constants that the published tasks make
            up, see `with_made_up`: the policies that were published for these tasks read them.
    """

    agent_placement: Placement = "uniform"
    agent_friction: NonNegativeRange | None = 0.01
    box_friction: NonNegativeRange | None = 0.2
    ramp_friction: NonNegativeRange | None = 0.01
    floor_friction: NonNegativeRange | None = 0.2
    gear: PositiveRange = 90.0
    n_frames: PositiveCount = 15
    world_params: WorldParams = field(default_factory=lambda: WorldParams(gravity=-50.0))
    scenario: ScenarioNames = "empty"
    boxsize_obs: bool | None = True
    published: bool = False
    cone: Cone = CONE
    cone_between: Annotated[str, OneOf(BETWEEN)] = "centres"
    lock: LockConfig = field(default_factory=lambda: LockConfig(in_vision_only=True))
    grab: GrabConfig | None = field(default_factory=lambda: GrabConfig(in_vision_only=True))
    lidar: LidarConfig | None = field(default_factory=LidarConfig)
    n_bins: Bins | None = 11
    observations: Annotated[str, OneOf(OBSERVATIONS)] = "split"
    made_up: bool = False


@dataclass(frozen=True)
class BoxesConfig(TransferConfig):
    """A task with boxes and without ramps; see `TransferConfig`."""

    n_ramps: Number = 0
    lock: LockConfig = field(default_factory=lambda: LockConfig(objects=("box",), in_vision_only=True))
    grab: GrabConfig | None = field(default_factory=lambda: GrabConfig(objects=("box",), in_vision_only=True))


def one_agent(config: TransferConfig, *modules: Module, first: Sequence[Module] = ()) -> Environment:
    """Builds the world of a config with an agent that sees, locks and grabs, and further modules.

    Those in `first` take their places before the agent and the objects, the others after them.
    """
    config = as_published(config)
    base = world(config, (Side(HIDERS, 1, config.agent_placement, "agent_placement"),), first)
    for module in modules:
        base.add_module(module)
    env: Environment = AgentAgentContactMask2D(TeamMembership(base))
    env = LineOfSight(env, config.cone, between=config.cone_between)
    env = with_lidar(env, config.lidar, config.observations)
    env = LockObjects(env, **arguments(config.lock))
    return env if config.grab is None else GrabObjects(env, **arguments(config.grab))


def as_in_hide_and_seek(
    env: Environment, config: TransferConfig, n_others: int = 1, *, hider: bool = True
) -> Environment:
    """Gives a task the actions and observations of the published games: no preparation, bins, one choice to lock.

    Args:
        env: the task.
        config: its config.
        n_others, hider: what it makes up, if it does; see `with_made_up`.

    Raises:
        ValueError: made-up observations of a mode that has none.
    """
    if config.made_up and (config.observations != "split" or config.observe != "self"):
        got = f"observations={config.observations!r} and observe={config.observe!r}"
        raise ValueError(f"made_up: got True with {got}; takes it with 'split' and 'self'")
    env = LockTogether(PreparationPhase(env, 0.0))
    if config.n_bins is not None:
        env = DiscretizeActions(env, config.n_bins)
    env = observed_by_agents(env, config.observations, config.observe)
    return with_made_up(env, n_others, hider=hider) if config.made_up else env
