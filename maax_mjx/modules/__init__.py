"""Modules: the contents of a world. Each module owns one kind of thing, from the object tree to its observations."""

from maax_mjx.modules.agents import Agents
from maax_mjx.modules.constants import FloorAttributes, WorldConstants
from maax_mjx.modules.cylinders import Cylinders, StaticCylinders
from maax_mjx.modules.entities import Entities
from maax_mjx.modules.module import Module
from maax_mjx.modules.objects import Boxes, Ramps
from maax_mjx.modules.placed import Placed
from maax_mjx.modules.sites import ConstructionSites, Flags, Food, Sites
from maax_mjx.modules.walls import RandomWalls, WallScenarios

__all__ = [
    "Agents",
    "Boxes",
    "ConstructionSites",
    "Cylinders",
    "Entities",
    "Flags",
    "FloorAttributes",
    "Food",
    "Module",
    "Placed",
    "Ramps",
    "RandomWalls",
    "Sites",
    "StaticCylinders",
    "WallScenarios",
    "WorldConstants",
]
