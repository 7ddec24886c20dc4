"""Hide-and-seek: the thesis's game, and the two that Baker et al. published."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated, Any

from maax_mjx.common.annotated import (
    Fraction,
    FractionRange,
    NonNegativeRange,
    OneOf,
    Positive,
    PositiveCount,
    PositiveCountRange,
    PositiveRange,
)
from maax_mjx.common.checks import pair_of
from maax_mjx.core.env import Environment
from maax_mjx.modules import Food
from maax_mjx.tasks.config import Config
from maax_mjx.tasks.food import FoodConfig, food_of, with_food
from maax_mjx.tasks.observe import OBSERVATIONS, observed_by_agents
from maax_mjx.tasks.published import as_published
from maax_mjx.tasks.standard import GameConfig, HidersAndSeekers, Number, Placement, ScenarioNames, world
from maax_mjx.worldgen import WorldParams
from maax_mjx.wrappers import (
    AgentAgentContactMask2D,
    DiscretizeActions,
    GrabObjects,
    HideAndSeekReward,
    Lidar,
    LineOfSight,
    LockObjects,
    PreparationPhase,
    RestrictAgentsRect,
    TeamMembership,
    TrackStats,
    TrackTools,
)
from maax_mjx.wrappers.actions import Bins
from maax_mjx.wrappers.locks.rules import LOCK_TYPES
from maax_mjx.wrappers.locks.slots import METHODS
from maax_mjx.wrappers.rewards import CATCHES, REW_TYPES
from maax_mjx.wrappers.senses import BETWEEN, CONE, FRAMES, Cone, RayCount


@dataclass(frozen=True)
class LockConfig(Config):
    """Arguments of `LockObjects`.

    Attributes:
        objects: kinds of objects that can be locked.
        lock_type: who may unlock: see `LockObjects`.
        radius: metres from an agent to the object's box within which it locks.
        method: "equality" or "joint_range", by which the model holds it.
        per_object: whether agents choose each object, or all in reach at once.
        in_vision_only: whether they have to see it.
        soft: whether it is held with MuJoCo's default softness instead of stiffly.
    """

    objects: tuple[str, ...] = ("box", "ramp")
    lock_type: Annotated[str, OneOf(LOCK_TYPES)] = "team"
    radius: Positive = 0.25
    method: Annotated[str, OneOf(METHODS)] = "equality"
    per_object: bool = True
    in_vision_only: bool = False
    soft: bool = False


@dataclass(frozen=True)
class GrabConfig(Config):
    """Arguments of `GrabObjects`.

    Attributes:
        objects: kinds of objects that can be held.
        radius: metres from an agent to the object's box within which it takes hold.
        exclusive: whether only one agent, the nearest, can hold an object.
        selective: whether agents choose which object, instead of the nearest.
        in_vision_only: whether they have to see it.
        soft: whether it is held with MuJoCo's default softness instead of stiffly.
    """

    objects: tuple[str, ...] = ("box", "ramp")
    radius: Positive = 0.25
    exclusive: bool = False
    selective: bool = False
    in_vision_only: bool = False
    soft: bool = False


@dataclass(frozen=True)
class LidarConfig(Config):
    """Arguments of `Lidar`.

    Attributes:
        n_rays: rays of every agent, evenly around it.
        range: metres; what is further away, and nothing at all, reads this.
        frame: "world" or "agent", as for `Lidar`; None is the agent's for observations="ego", else the world's.
        compress: a scale in metres, or None: gives distances as `scale * tanh(distance / scale)`.
        capped: whether hits beyond the range read the range, instead of how far they are.
    """

    n_rays: RayCount = 30
    range: Positive = 6.0
    frame: Annotated[str, OneOf(FRAMES)] | None = None
    compress: Positive | None = None
    capped: bool = True


@dataclass(frozen=True)
class RectConfig(Config):
    """Arguments of `RestrictAgentsRect`.

    Attributes:
        rect: x0, y0, x1, y1 in metres.
        penalty: that an agent pays in every step outside.
        penalize_objects_out: whether every agent pays while a box or a ramp is outside, too.
    """

    rect: tuple[float, float, float, float] = (0.1, 0.1, 5.9, 5.9)
    penalty: Positive = 10.0
    penalize_objects_out: bool = True


@dataclass(frozen=True)
class HideAndSeekConfig(HidersAndSeekers, GameConfig):
    """The thesis's game (section 5.2.1): M, catching by touch, locking, rewards at every step after preparation.

    Attributes:
        prep_fraction: see `PreparationPhase`.
        blind: see `PreparationPhase`.
        by: see `HideAndSeekReward`.
        rew_type: see `HideAndSeekReward`.
        cone: full angle of `LineOfSight` in radians; None leaves vision out.
        cone_between: what cones are measured between, "centres" or "corners"; see `LineOfSight`.
        lock: arguments of `LockObjects`; None leaves it out.
        grab: those of `GrabObjects`, likewise.
        lidar: those of `Lidar`, likewise.
        rect: those of `RestrictAgentsRect`, likewise.
        food: food and who may eat it; needs `cone`. None leaves it out.
        n_bins: bins of the movement, see `DiscretizeActions`; None takes forces.
        stats: whether `metrics` have the statistics of `TrackStats`.
        tools: whether they have those of `TrackTools`, for evaluation.
    """

    prep_fraction: Fraction = 0.4
    blind: bool = False
    by: Annotated[str, OneOf(CATCHES)] = "contact"
    rew_type: Annotated[str, OneOf(REW_TYPES)] = "selfish"
    cone: Cone | None = None
    cone_between: Annotated[str, OneOf(BETWEEN)] = "centres"
    lock: LockConfig | None = LockConfig()
    grab: GrabConfig | None = None
    lidar: LidarConfig | None = None
    rect: RectConfig | None = None
    food: FoodConfig | None = None
    n_bins: Bins | None = None
    stats: bool = True
    tools: bool = False


@dataclass(frozen=True)
class QuadrantConfig(HideAndSeekConfig):
    """`quadrant.jsonnet` of Baker et al.'s published code, number for number.

    2 hiders anywhere and 2 seekers outside the quadrant, 2 boxes in it, a ramp anywhere that cannot be locked; half of
    the worlds have one door, half two. 80 steps of 15 physics steps, the first 32 of them preparation; gravity -50;
    friction 0.2 for boxes and floor, 0.01 for everything else; forces up to 90 N and torques up to 90 Nm in 11 bins.
    Seekers catch by sight, in a cone of 135 degrees; a team wins or loses together; agents outside [0.1, 5.9] lose 10,
    and all do while an object is outside. Agents lock and grab what they see within 0.25 m, with one choice each for
    everything in reach.

    The code differs from the published one in details: where things start to the cell and in doorways; cones of sight
    measured between centres; rays that end at the lidar's range; hands that do not collide; stiffer holds and locks;
    the box by which ramps are reached, and to whose middle the ray of sight goes; an end to episodes in which
    something leaves a closed arena; 20 iterations of Newton's method; the same counts where a world that does not fit
    is drawn anew. `published=True` takes all of these as they are there. Either way agents also observe doors, touches,
    which agents are in play, and holds; teams and the rest of the preparation are separate arrays, not columns of the
    arrays about others.

    Attributes:
        published: whether details are as in the published code, where their fields are as by default; docs/games.md.
    """

    published: bool = False

    n_boxes: Number = 2
    hider_placement: Placement = "uniform"
    box_placement: Placement = "quad"
    p_door_dropout: FractionRange = 0.5
    agent_friction: NonNegativeRange | None = 0.01
    box_friction: NonNegativeRange | None = 0.2
    ramp_friction: NonNegativeRange | None = 0.01
    wall_friction: NonNegativeRange | None = 0.01
    floor_friction: NonNegativeRange | None = 0.2
    gear: PositiveRange = 90.0
    n_frames: PositiveCount = 15
    horizon: PositiveCount | None = 80
    world_params: WorldParams = field(default_factory=lambda: WorldParams(gravity=-50.0))
    by: Annotated[str, OneOf(CATCHES)] = "vision"
    rew_type: Annotated[str, OneOf(REW_TYPES)] = "team_zero_sum"
    cone: Cone | None = CONE
    lock: LockConfig | None = LockConfig(objects=("box",), per_object=False, in_vision_only=True)
    grab: GrabConfig | None = GrabConfig(in_vision_only=True)
    lidar: LidarConfig | None = LidarConfig()
    rect: RectConfig | None = RectConfig()
    n_bins: Bins | None = 11
    observations: Annotated[str, OneOf(OBSERVATIONS)] = "split"


@dataclass(frozen=True)
class FullConfig(QuadrantConfig):
    """`hide_and_seek_full.jsonnet` of Baker et al.'s published code, number for number.

    1 to 4 random rooms, outer walls in half of the worlds; 3 to 9 boxes, 3 to 9 of them elongated, and 2 ramps, all
    lockable; every team starts within 0.5 m of its first member. 240 steps, the first 96 of them preparation; the
    penalty is for leaving a square of 18 m around the floor, and not for objects; walls have MuJoCo's friction, 1.
    Everything else is as in `QuadrantConfig`.
    The paper draws 1 to 3 agents for each team: `n_hiders=(1, 3), n_seekers=(1, 3)`; the published code has 2 and 2.
    """

    scenario: ScenarioNames = "random"
    n_boxes: Number = (3, 9)
    n_elongated_boxes: Number = (3, 9)
    n_ramps: Number = 2
    hider_placement: Placement = "team"
    seeker_placement: Placement = "team"
    box_placement: Placement = "uniform"
    p_door_dropout: FractionRange = 0.0
    n_rooms: PositiveCountRange = (1, 4)
    prob_outside_walls: FractionRange = 0.5
    wall_friction: NonNegativeRange | None = None
    horizon: PositiveCount | None = 240
    lock: LockConfig | None = LockConfig(per_object=False, in_vision_only=True)
    rect: RectConfig | None = RectConfig((-6.0, -6.0, 12.0, 12.0), penalize_objects_out=False)


@dataclass(frozen=True)
class FoodGameConfig(FullConfig):
    """Hide and seek with food: `hide_and_seek_full` with the food that its published config describes.

    Hiders also get the mean of what they eat: a unit of a piece at every step in which they see it, are nearer than
    0.5 m, and no seeker sees a hider, after preparation. A piece has 40 units and comes back 5 steps after the last.
    The published config has all these numbers and no food, n_food 0; four pieces are ours.
    """

    food: FoodConfig | None = field(default_factory=FoodConfig)


def hide_and_seek(config: HideAndSeekConfig) -> Environment:
    """Builds the game of a config.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    config = as_published(config)
    base = world(config, config.sides)
    if config.food is not None:
        if config.cone is None:
            raise ValueError("cone: got None in a game with food; takes an angle, as hiders eat what they see")
        if not pair_of(config.n_hiders)[1]:
            raise ValueError(f"n_hiders: got {config.n_hiders} in a game with food; takes hiders, who eat it")
        base.add_module(food_of(config.food, base.floor_range.high / config.grid_size))
    env: Environment = AgentAgentContactMask2D(TeamMembership(base))
    if config.cone is not None:
        seen = ("box", "ramp") if config.food is None else ("box", "ramp", Food.kind)
        env = LineOfSight(env, config.cone, seen, config.cone_between)
    env = with_lidar(env, config.lidar, config.observations)
    if config.lock is not None:
        env = LockObjects(env, **arguments(config.lock))
    if config.grab is not None:
        env = GrabObjects(env, **arguments(config.grab))
    env = HideAndSeekReward(env, config.rew_type, config.by, config.reward_scale)
    if config.rect is not None:
        env = RestrictAgentsRect(env, **arguments(config.rect))
    env = PreparationPhase(env, config.prep_fraction, config.blind)
    if config.food is not None:
        env = with_food(env, config.food)
    if config.stats:
        env = TrackStats(env)
    if config.tools:
        env = TrackTools(env)
    if config.n_bins is not None:
        env = DiscretizeActions(env, config.n_bins)
    return observed_by_agents(env, config.observations, config.observe)


def with_lidar(env: Environment, config: LidarConfig | None, observations: str) -> Environment:
    """Adds the rays of a config, if there is one, in the frame that the way of observing suggests."""
    if config is None:
        return env
    frame = "agent" if observations == "ego" else "world"
    return Lidar(env, **arguments(config) | {"frame": frame if config.frame is None else config.frame})


def arguments(group: Config) -> dict[str, Any]:
    """Returns the arguments of a wrapper that a group of fields has."""
    return {f.name: getattr(group, f.name) for f in fields(group)}
