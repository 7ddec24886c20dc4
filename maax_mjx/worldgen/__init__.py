"""The object tree, and its translation to a MuJoCo model (thesis 4.3.2). Host code: mujoco and numpy, never jax."""

from maax_mjx.worldgen import transforms
from maax_mjx.worldgen.builder import WorldBuilder, WorldParams
from maax_mjx.worldgen.floor import Floor
from maax_mjx.worldgen.from_stl import ObjFromSTL
from maax_mjx.worldgen.from_xml import ObjFromXML
from maax_mjx.worldgen.geom import Geom, Wedge
from maax_mjx.worldgen.joints import Hinge, Slide
from maax_mjx.worldgen.material import Material
from maax_mjx.worldgen.obj import Obj
from maax_mjx.worldgen.placement import Placement, WorldFullError
from maax_mjx.worldgen.transforms import remove_joints, set_geom_attr, set_joint_damping
from maax_mjx.worldgen.written import Transform, Written

__all__ = [
    "Floor",
    "Geom",
    "Hinge",
    "Material",
    "Obj",
    "ObjFromSTL",
    "ObjFromXML",
    "Placement",
    "Slide",
    "Transform",
    "Wedge",
    "WorldBuilder",
    "WorldFullError",
    "WorldParams",
    "Written",
    "remove_joints",
    "set_geom_attr",
    "set_joint_damping",
    "transforms",
]
