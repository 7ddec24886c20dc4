"""Wrappers: the rules of games, observations, actions and rewards."""

from maax_mjx.wrappers.actions import DiscretizeActions
from maax_mjx.wrappers.blueprint import BlueprintReward, BoxCorners
from maax_mjx.wrappers.capture_the_flag import CaptureTheFlag
from maax_mjx.wrappers.contact import AgentAgentContactMask2D
from maax_mjx.wrappers.counting import ObjectCounting
from maax_mjx.wrappers.critic import CriticObservations
from maax_mjx.wrappers.ego import EgocentricObservations
from maax_mjx.wrappers.extend import extended
from maax_mjx.wrappers.flatten import FlattenObservations, MaskObservations
from maax_mjx.wrappers.food import AlwaysEat, EatFood
from maax_mjx.wrappers.grabs import GrabObjects
from maax_mjx.wrappers.lock_tasks import LockInOrder, LockTask, LockTogether
from maax_mjx.wrappers.locks import LockObjects
from maax_mjx.wrappers.masks import MaskActions, MaskPreparationAction, MaskUnseenAction
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.rewards import HideAndSeekReward, RestrictAgentsRect
from maax_mjx.wrappers.select import AddConstantObservations, ConcatenateObservations, SelectObservations, SpoofEntities
from maax_mjx.wrappers.senses import Lidar, LineOfSight
from maax_mjx.wrappers.shelter import ShelterReward
from maax_mjx.wrappers.split import SplitObservations
from maax_mjx.wrappers.stats import TrackStats
from maax_mjx.wrappers.tag import Tag
from maax_mjx.wrappers.teams import TeamMembership
from maax_mjx.wrappers.tools import TrackTools
from maax_mjx.wrappers.wrapper import (
    ActionWrapper,
    ObservationWrapper,
    RewardWrapper,
    StateWrapper,
    Wrapper,
    find,
    find_all,
)

__all__ = [
    "ActionWrapper",
    "AddConstantObservations",
    "AgentAgentContactMask2D",
    "AlwaysEat",
    "BlueprintReward",
    "BoxCorners",
    "CaptureTheFlag",
    "ConcatenateObservations",
    "CriticObservations",
    "DiscretizeActions",
    "EatFood",
    "EgocentricObservations",
    "FlattenObservations",
    "GrabObjects",
    "HideAndSeekReward",
    "Lidar",
    "LineOfSight",
    "LockInOrder",
    "LockObjects",
    "LockTask",
    "LockTogether",
    "MaskActions",
    "MaskObservations",
    "MaskPreparationAction",
    "MaskUnseenAction",
    "ObjectCounting",
    "ObservationWrapper",
    "PreparationPhase",
    "RestrictAgentsRect",
    "RewardWrapper",
    "SelectObservations",
    "ShelterReward",
    "SplitObservations",
    "SpoofEntities",
    "StateWrapper",
    "Tag",
    "TeamMembership",
    "TrackStats",
    "TrackTools",
    "Wrapper",
    "extended",
    "find",
    "find_all",
]
