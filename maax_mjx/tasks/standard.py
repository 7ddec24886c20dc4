"""The standard environment M of the thesis (section 6.3, formula 6.1), with bodies of our own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, NamedTuple

from maax_mjx.common.annotated import (
    Bounds,
    Count,
    FractionRange,
    NonNegative,
    NonNegativeRange,
    OneOf,
    Positive,
    PositiveCount,
    PositiveCountRange,
    PositiveRange,
)
from maax_mjx.common.checks import check_count_range, pair_of
from maax_mjx.common.colours import Colour, team_colour
from maax_mjx.core.composition import Contacts, FloorSize, GridSize
from maax_mjx.core.env import Base
from maax_mjx.layout import (
    PlacementFn,
    placement_by_name,
    proximity_placement,
    published_proximity_placement,
    published_uniform_placement,
    scenario_names,
    uniform_placement,
)
from maax_mjx.modules import Agents, Boxes, FloorAttributes, Module, Ramps, WallScenarios
from maax_mjx.modules.agents import DAMPING
from maax_mjx.modules.placed import MOST
from maax_mjx.modules.walls import OUTER, OUTER_HEIGHT
from maax_mjx.physics import impls
from maax_mjx.tasks.config import Config, Extensions
from maax_mjx.tasks.observe import OBSERVATIONS, OBSERVE
from maax_mjx.worldgen import WorldParams

NEAR = 0.5
"""Metres from the first agent of the team, for placement "team"."""
TEAM, PUBLISHED_TEAM = "team", "published_team"

Number = Annotated[int | tuple[int, int], Bounds(0, MOST)]
"""Objects or agents per world, or (low, high)."""
ScenarioNames = Annotated[str | Sequence[str], OneOf(scenario_names)]
Placement = str | PlacementFn
Placements = Placement | tuple[Placement, ...] | list[Placement]
"""One for all objects of a kind, or one for each of them."""
TeamPlacements = Mapping[str, Placement] | tuple[Placement, ...] | list[Placement] | Placement


@dataclass(frozen=True)
class WorldConfig(Extensions):
    """A room with boxes and ramps, for any teams.

    A placement is a name that `placement_by_name` takes, such as "uniform", "quad", "room0", or your own; "team" for
    the agents of a team (within 0.5 m of the first of them, who starts anywhere), or "published_team" (in the ranges of
    cells of OpenAI's code); or a placement function.

    Attributes:
        scenario: the room scenario, or several, one of which each world draws; see `WallScenarios`.
        n_boxes: number per world, or (low, high).
        n_ramps: number per world, or (low, high).
        n_elongated_boxes: number of elongated boxes; see `Boxes`.
        box_placement: where boxes start; one for all, or a list of one for each.
        ramp_placement: where ramps start, likewise.
        door_size: in cells.
        outer: how the arena is closed; see `WallScenarios`.
        probabilities: probabilities of several scenarios.
        p_door_dropout: see `WallScenarios`.
        n_rooms: see `WallScenarios`.
        min_room_size: see `WallScenarios`.
        prob_outside_walls: see `WallScenarios`.
        agent_friction: sliding friction, or a range; None keeps MuJoCo's default of 1. MuJoCo uses the larger one of
            two geoms in contact.
        box_friction: likewise.
        ramp_friction: likewise.
        wall_friction: likewise.
        floor_friction: likewise.
        gear: gear of the agents' motors, in N and Nm; see `Agents`.
        random_yaw: whether agents, boxes and ramps start at random yaws.
        boxsize_obs: whether boxes are observed with their extents; None does so if worlds differ in them.
        free: whether boxes and ramps have free joints; see `Boxes`.
        agent_damping: see `Agents`, `Boxes` and `Ramps`.
        box_damping: see `Agents`, `Boxes` and `Ramps`.
        ramp_damping: see `Agents`, `Boxes` and `Ramps`.
        outer_height: height of the outer walls in metres.
        arms: whether agents have the published arms; see `Agents`.
        inertial_reach: how agents reach for ramps; see `Ramps`.
        in_doorways: whether things may start in doorways; see `WallScenarios`.
        n_frames: see `Base`.
        grid_size: see `Base`.
        floor_size: see `Base`.
        horizon: see `Base`.
        impl: see `Base`.
        world_params: see `Base`.
        contacts_per_world: see `Base`.
        may_leave: see `Base`.
        placement_tries: see `Base`.
    """

    scenario: ScenarioNames = "quad"
    n_boxes: Number = 1
    n_ramps: Number = 1
    n_elongated_boxes: Number = 0
    box_placement: Placements = "uniform"
    ramp_placement: Placements = "uniform"
    door_size: Count = 2
    p_door_dropout: FractionRange = 0.0
    n_rooms: PositiveCountRange = 4
    min_room_size: PositiveCount = 6
    prob_outside_walls: FractionRange = 1.0
    outer: Annotated[str, OneOf(OUTER)] = "walls"
    probabilities: Sequence[float] | None = None
    agent_friction: NonNegativeRange | None = None
    box_friction: NonNegativeRange | None = None
    ramp_friction: NonNegativeRange | None = None
    wall_friction: NonNegativeRange | None = None
    floor_friction: NonNegativeRange | None = None
    gear: PositiveRange = 100.0
    random_yaw: bool = False
    boxsize_obs: bool | None = None
    free: bool = False
    agent_damping: NonNegativeRange = DAMPING
    box_damping: NonNegative = 0.01
    ramp_damping: NonNegative = 0.1
    outer_height: Positive = OUTER_HEIGHT
    arms: bool = False
    inertial_reach: bool = False
    in_doorways: bool = False
    n_frames: PositiveCount = 1
    grid_size: GridSize = 30
    floor_size: FloorSize = 6.0
    horizon: PositiveCount | None = 1000
    impl: Annotated[str, OneOf(impls)] = "auto"
    world_params: WorldParams = field(default_factory=WorldParams)
    contacts_per_world: Contacts | None = None
    may_leave: bool = False
    placement_tries: PositiveCount | None = None


@dataclass(frozen=True)
class HidersAndSeekers(Config):
    """Two teams, hiders and seekers; hiders come first among the agents.

    Attributes:
        n_hiders: hiders per world, or (low, high).
        n_seekers: seekers per world, likewise.
        hider_placement: where hiders start.
        seeker_placement: where seekers start.
    """

    n_hiders: Number = 2
    n_seekers: Number = 2
    hider_placement: Placement = "quad"
    seeker_placement: Placement = "outside_quad"

    @property
    def sides(self) -> tuple[Side, ...]:
        """Returns the teams that have agents.

        Raises:
            ValueError: no agents at all.
        """
        hiders = Side("hiders", self.n_hiders, self.hider_placement, "hider_placement", team_colour(0))
        seekers = Side("seekers", self.n_seekers, self.seeker_placement, "seeker_placement", team_colour(1))
        sides = tuple(side for side in (hiders, seekers) if pair_of(side.size)[1])
        if not sides:
            raise ValueError(
                f"n_hiders, n_seekers: got {self.n_hiders} and {self.n_seekers}; takes at least one agent in all"
            )
        return sides


OURS, MAAX = "ours", "maax"
AS_IN_MAAX: dict[str, Any] = {
    "free": True,
    "agent_damping": 0.01,
    "agent_friction": 0.01,
    "box_damping": 0.01,
    "box_friction": 0.2,
    "ramp_damping": 0.001,
    "ramp_friction": 0.01,
    "wall_friction": 0.01,
    "outer_height": 3.0,
}
"""Fields of the world that MAax's own files describe, `simple.xml` and `batch.ipynb`."""


@dataclass(frozen=True)
class StandardConfig(HidersAndSeekers, WorldConfig):
    """M = [(2, 2), quad, 1, 1]: 2 hiders, 2 seekers, quadrant walls with doors, outer walls, 1 box, 1 ramp.

    Attributes:
        preset: "ours", or "maax" for the bodies as MAax, the thesis's code, has them: boxes and ramps with free joints,
            hardly any damping and friction, outer walls of 3 m. Fields that are not at their defaults stay. There,
            agents do not move along z at all; here they rest on the floor.
    """

    preset: Annotated[str, OneOf((OURS, MAAX))] = OURS


@dataclass(frozen=True)
class GameConfig(WorldConfig):
    """A world in which a game is played.

    Attributes:
        reward_scale: factor of the game's reward.
        observations: "raw", "split" (arrays for every agent), "flat" (one vector for every agent) or "ego" (arrays in
            every agent's own frame); see `observed_by_agents`.
        observe: what a critic sees: "self" (what its agent sees), "team" or "all".
    """

    reward_scale: Positive = 1.0
    observations: Annotated[str, OneOf(OBSERVATIONS)] = "flat"
    observe: Annotated[str, OneOf(OBSERVE)] = "self"


class Side(NamedTuple):
    """A team as a config describes it.

    Attributes:
        name: the team's name.
        size: agents per world, or (low, high).
        placement: where its agents start.
        argument: the config's field of the placement, for messages.
        colour: RGBA in pictures; None is by the team's number.
    """

    name: str
    size: Number
    placement: Placement
    argument: str
    colour: Colour | None = None


def sides_of(teams: Mapping[str, Number], placements: TeamPlacements) -> tuple[Side, ...]:
    """Returns the teams of a config's fields `teams` and `agent_placement`.

    Args:
        teams: agents per world by team, or (low, high).
        placements: one for all teams, one by team, or a list of one per team in their order.

    Raises:
        ValueError: no teams, a team without agents, or placements for other teams.
    """
    if not isinstance(teams, Mapping) or not teams:
        raise ValueError(f"teams: got {teams!r}; takes the number of agents by team, such as {{'players': 4}}")
    if isinstance(placements, list | tuple):
        if len(placements) != len(teams):
            raise ValueError(
                f"agent_placement: got {len(placements)}; takes {len(teams)}, one for each of {list(teams)}"
            )
        placements = dict(zip(teams, placements, strict=True))
    if isinstance(placements, Mapping) and set(placements) != set(teams):
        raise ValueError(f"agent_placement: got {sorted(placements)}; takes one for each of {sorted(teams)}")
    for name, count in teams.items():
        if not check_count_range(f"teams[{name!r}]", count)[1]:
            raise ValueError(f"teams: got no agents in {name!r}; takes at least one, or leave the team out")
    by_team = placements if isinstance(placements, Mapping) else dict.fromkeys(teams, placements)
    return tuple(Side(name, count, by_team[name], "agent_placement") for name, count in teams.items())


def standard(config: StandardConfig) -> Base:
    """Builds M, or another world of hiders and seekers.

    Raises:
        ValueError: no agents at all, an unknown placement, or arguments that the modules refuse.
    """
    if config.preset == MAAX:
        defaults = type(config)()
        changed = {name for name in AS_IN_MAAX if getattr(config, name) == getattr(defaults, name)}
        config = replace(config, **{name: AS_IN_MAAX[name] for name in changed})
    return world(config, config.sides)


def world(config: WorldConfig, sides: Sequence[Side], first: Sequence[Module] = ()) -> Base:
    """Builds the world of a config, with some teams in it.

    Args:
        config: the config.
        sides: the teams.
        first: modules whose objects take their places before agents, boxes and ramps do.

    Raises:
        ValueError: an unknown placement, or arguments that the modules refuse.
    """
    most = [check_count_range(f"n_{side.name}", side.size)[1] for side in sides]
    env = Base(
        sum(most),
        config.n_frames,
        config.grid_size,
        config.floor_size,
        config.horizon,
        config.impl,
        config.world_params,
        config.contacts_per_world,
        config.may_leave,
        config.placement_tries,
    )
    walls = WallScenarios(
        config.scenario,
        config.door_size,
        config.p_door_dropout,
        config.probabilities,
        config.n_rooms,
        config.min_room_size,
        config.prob_outside_walls,
        friction=config.wall_friction,
        outer=config.outer,
        in_doorways=config.in_doorways,
        outer_height=config.outer_height,
    )
    env.add_module(walls)
    if config.floor_friction is not None:
        env.add_module(FloorAttributes(config.floor_friction))
    for module in first:
        env.add_module(module)
    n_before, placements = 0, []
    for side, n in zip(sides, most, strict=True):
        placements += _placement(side.argument, side.placement, f"agent{n_before}", n)
        n_before += n
    env.add_module(
        Agents(
            {side.name: side.size for side in sides},
            placements,
            {side.name: side.colour or team_colour(i) for i, side in enumerate(sides)},
            config.random_yaw,
            friction=config.agent_friction,
            gear=config.gear,
            damping=config.agent_damping,
            arms=config.arms,
        )
    )
    env.add_module(
        Boxes(
            config.n_boxes,
            _placements("box_placement", config.box_placement),
            box_friction=config.box_friction,
            n_elongated_boxes=config.n_elongated_boxes,
            random_yaw=config.random_yaw,
            boxsize_obs=config.boxsize_obs,
            free=config.free,
            damping=config.box_damping,
        )
    )
    env.add_module(
        Ramps(
            config.n_ramps,
            _placements("ramp_placement", config.ramp_placement),
            config.ramp_friction,
            random_yaw=config.random_yaw,
            inertial_reach=config.inertial_reach,
            free=config.free,
            damping=config.ramp_damping,
        )
    )
    return env


def _placements(argument: str, given: Placements) -> PlacementFn | list[PlacementFn]:
    """Returns the placement function of all objects of a kind, or that of each of them."""
    if isinstance(given, list | tuple):
        return [placement_of(argument, one) for one in given]
    return placement_of(argument, given)


def placement_of(argument: str, placement: Placement) -> PlacementFn:
    """Returns the placement function that a config's field has, or names.

    Raises:
        ValueError: an unknown name.
    """
    return _placement(argument, placement)[0]


def _placement(argument: str, placement: Placement, first: str = "", n: int = 1) -> list[PlacementFn]:
    """Returns the placement functions of `n` things; "team" is allowed for a team's agents, the first named `first`."""
    if callable(placement):
        return [placement] * n
    if first and placement == TEAM:
        return ([uniform_placement] + [proximity_placement(NEAR, first)] * (n - 1))[:n]
    if first and placement == PUBLISHED_TEAM:
        return ([published_uniform_placement] + [published_proximity_placement(NEAR, first)] * (n - 1))[:n]
    return [placement_by_name(placement, argument, also=(TEAM, PUBLISHED_TEAM) if first else ())] * n
