"""What is in a world. Each module owns one kind of thing, from the object tree to its observations."""

from maax_mjx.modules.agents import Agents
from maax_mjx.modules.entities import Entities
from maax_mjx.modules.module import Module
from maax_mjx.modules.objects import Boxes, Ramps
from maax_mjx.modules.walls import RandomWalls, WallScenarios

__all__ = ["Agents", "Boxes", "Entities", "Module", "Ramps", "RandomWalls", "WallScenarios"]
