"""maax_mjx: multi-agent reinforcement learning in procedurally generated worlds, on MuJoCo MJX."""

from typing import Any

from maax_mjx.common.runtime import guard_small_hosts, keep_compiled_programs

guard_small_hosts()
keep_compiled_programs()

from maax_mjx import testing  # noqa: E402
from maax_mjx.common.observed import Column, Observed  # noqa: E402
from maax_mjx.common.params import DomainParams  # noqa: E402
from maax_mjx.common.version import VERSION  # noqa: E402
from maax_mjx.core.diagnosis import diagnose  # noqa: E402
from maax_mjx.core.env import Base, Environment  # noqa: E402
from maax_mjx.core.export import to_mjcf, world_of  # noqa: E402
from maax_mjx.core.state import State  # noqa: E402
from maax_mjx.core.teams import Team  # noqa: E402
from maax_mjx.layout import (  # noqa: E402
    all_of,
    any_of,
    at_placement,
    centre_placement,
    middle_placement,
    outside_quad_placement,
    poisson_disc,
    proximity_placement,
    quad_placement,
    register_placement,
    register_scenario,
    room_placement,
    separation_placement,
    uniform_placement,
)
from maax_mjx.modules import (  # noqa: E402
    Agents,
    Boxes,
    ConstructionSites,
    Cylinders,
    Entities,
    Flags,
    FloorAttributes,
    Food,
    Module,
    Ramps,
    RandomWalls,
    StaticCylinders,
    WallScenarios,
    WorldConstants,
)
from maax_mjx.parallel import Checkpoints, Recording, Worlds, WorldsState, load_fault  # noqa: E402
from maax_mjx.parallel.curriculum import Curriculum  # noqa: E402
from maax_mjx.physics import MissingLibraryError, NotDifferentiableError, register_engine  # noqa: E402
from maax_mjx.tasks import (  # noqa: E402
    CaptureTheFlagConfig,
    FullConfig,
    GameConfig,
    GrabConfig,
    HideAndSeekConfig,
    LidarConfig,
    LockConfig,
    QuadrantConfig,
    RectConfig,
    StandardConfig,
    TagConfig,
    WorldConfig,
    config_of,
    jitted,
    make,
    register,
    tasks,
)
from maax_mjx.viewer import Replay, marks_of, record, render, replay, video  # noqa: E402
from maax_mjx.worldgen import WorldParams  # noqa: E402
from maax_mjx.wrappers import (  # noqa: E402
    ActionWrapper,
    AgentAgentContactMask2D,
    CaptureTheFlag,
    ConcatenateObservations,
    CriticObservations,
    DiscretizeActions,
    EgocentricObservations,
    FlattenObservations,
    GrabObjects,
    HideAndSeekReward,
    Lidar,
    LineOfSight,
    LockObjects,
    MaskActions,
    MaskObservations,
    MaskUnseenAction,
    ObservationWrapper,
    PreparationPhase,
    RestrictAgentsRect,
    RewardWrapper,
    SelectObservations,
    SplitObservations,
    SpoofEntities,
    StateWrapper,
    Tag,
    TeamMembership,
    TrackStats,
    TrackTools,
    Wrapper,
    extended,
)

__version__ = VERSION

__all__ = [
    "ActionWrapper",
    "AgentAgentContactMask2D",
    "Agents",
    "Base",
    "Boxes",
    "CaptureTheFlag",
    "CaptureTheFlagConfig",
    "Checkpoints",
    "Column",
    "ConcatenateObservations",
    "ConstructionSites",
    "CriticObservations",
    "Curriculum",
    "Cylinders",
    "DiscretizeActions",
    "DomainParams",
    "EgocentricObservations",
    "Entities",
    "Environment",
    "Flags",
    "FlattenObservations",
    "FloorAttributes",
    "Food",
    "FullConfig",
    "GameConfig",
    "GrabConfig",
    "GrabObjects",
    "HideAndSeekConfig",
    "HideAndSeekReward",
    "Lidar",
    "LidarConfig",
    "LineOfSight",
    "Live",
    "LockConfig",
    "LockObjects",
    "MaskActions",
    "MaskObservations",
    "MaskUnseenAction",
    "MissingLibraryError",
    "Module",
    "NotDifferentiableError",
    "ObservationWrapper",
    "Observed",
    "PreparationPhase",
    "QuadrantConfig",
    "Ramps",
    "RandomWalls",
    "Recording",
    "RectConfig",
    "Replay",
    "RestrictAgentsRect",
    "RewardWrapper",
    "SelectObservations",
    "SplitObservations",
    "SpoofEntities",
    "StandardConfig",
    "State",
    "StateWrapper",
    "StaticCylinders",
    "Tag",
    "TagConfig",
    "Team",
    "TeamMembership",
    "TrackStats",
    "TrackTools",
    "WallScenarios",
    "WorldConfig",
    "WorldConstants",
    "WorldParams",
    "Worlds",
    "WorldsState",
    "Wrapper",
    "all_of",
    "any_of",
    "at_placement",
    "centre_placement",
    "config_of",
    "diagnose",
    "extended",
    "jitted",
    "load_fault",
    "make",
    "marks_of",
    "middle_placement",
    "outside_quad_placement",
    "play",
    "poisson_disc",
    "proximity_placement",
    "quad_placement",
    "record",
    "register",
    "register_engine",
    "register_placement",
    "register_scenario",
    "render",
    "replay",
    "room_placement",
    "separation_placement",
    "tasks",
    "testing",
    "to_mjcf",
    "uniform_placement",
    "video",
    "world_of",
]


def __getattr__(name: str) -> Any:
    # Networks take as long to import as all the rest, and nothing else here needs them.
    if name in ("Live", "play"):
        from maax_mjx.viewer import live

        return getattr(live, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
