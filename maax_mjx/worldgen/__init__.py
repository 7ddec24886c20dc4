"""The object tree, and how it becomes a MuJoCo model (thesis 4.3.2). Host code: mujoco and numpy, never jax."""

from maax_mjx.worldgen.builder import WorldBuilder, WorldParams
from maax_mjx.worldgen.floor import Floor
from maax_mjx.worldgen.from_xml import ObjFromXML
from maax_mjx.worldgen.geom import Geom, Wedge
from maax_mjx.worldgen.obj import Obj, Placement, WorldFullError

__all__ = ["Floor", "Geom", "Obj", "ObjFromXML", "Placement", "Wedge", "WorldBuilder", "WorldFullError", "WorldParams"]
