"""maax_mjx: multi-agent reinforcement learning in procedurally generated worlds, on MuJoCo MJX."""

from maax_mjx.runtime import guard_small_hosts, import_mjx

guard_small_hosts()
import_mjx()

from maax_mjx import testing  # noqa: E402
from maax_mjx.base import Base  # noqa: E402
from maax_mjx.curriculum import Curriculum  # noqa: E402
from maax_mjx.env import Environment  # noqa: E402
from maax_mjx.export import to_mjcf  # noqa: E402
from maax_mjx.layout import (  # noqa: E402
    all_of,
    any_of,
    centre_placement,
    middle_placement,
    outside_quad_placement,
    poisson_disc,
    proximity_placement,
    quad_placement,
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
    WallScenarios,
    WorldConstants,
)
from maax_mjx.parallel import Worlds, WorldsState  # noqa: E402
from maax_mjx.params import DomainParams  # noqa: E402
from maax_mjx.physics import MissingLibraryError, NotDifferentiableError  # noqa: E402
from maax_mjx.state import State  # noqa: E402
from maax_mjx.tasks import config_of, jitted, make, register, tasks  # noqa: E402
from maax_mjx.worldgen import WorldParams  # noqa: E402
from maax_mjx.wrappers import (  # noqa: E402
    ActionWrapper,
    AgentAgentContactMask2D,
    CaptureTheFlag,
    ConcatenateObservations,
    DiscretizeActions,
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
    Wrapper,
)

__version__ = "0.1.0"

__all__ = [
    "ActionWrapper",
    "AgentAgentContactMask2D",
    "Agents",
    "Base",
    "Boxes",
    "CaptureTheFlag",
    "ConcatenateObservations",
    "ConstructionSites",
    "Curriculum",
    "Cylinders",
    "DiscretizeActions",
    "DomainParams",
    "Entities",
    "Environment",
    "Flags",
    "FlattenObservations",
    "FloorAttributes",
    "Food",
    "GrabObjects",
    "HideAndSeekReward",
    "Lidar",
    "LineOfSight",
    "LockObjects",
    "MaskActions",
    "MaskObservations",
    "MaskUnseenAction",
    "MissingLibraryError",
    "Module",
    "NotDifferentiableError",
    "ObservationWrapper",
    "PreparationPhase",
    "Ramps",
    "RandomWalls",
    "RestrictAgentsRect",
    "RewardWrapper",
    "SelectObservations",
    "SplitObservations",
    "SpoofEntities",
    "State",
    "StateWrapper",
    "Tag",
    "TeamMembership",
    "TrackStats",
    "WallScenarios",
    "WorldConstants",
    "WorldParams",
    "Worlds",
    "WorldsState",
    "Wrapper",
    "all_of",
    "any_of",
    "centre_placement",
    "config_of",
    "jitted",
    "make",
    "middle_placement",
    "outside_quad_placement",
    "poisson_disc",
    "proximity_placement",
    "quad_placement",
    "register",
    "room_placement",
    "separation_placement",
    "tasks",
    "testing",
    "to_mjcf",
    "uniform_placement",
]
