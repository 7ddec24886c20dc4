"""Conversion of the object tree to a `mujoco.MjSpec`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NoReturn

import mujoco
import numpy as np

from maax_mjx.common.annotated import Bounds, NonNegative, PositiveCount, check_fields
from maax_mjx.worldgen.default_pose import KEYFRAME, with_default_poses
from maax_mjx.worldgen.mark import CENTRE
from maax_mjx.worldgen.material import Material
from maax_mjx.worldgen.obj import Obj
from maax_mjx.worldgen.written import Written


@dataclass(frozen=True)
class WorldParams:
    """Options of a world: its physics, and how a `WorldBuilder` places objects.

    Attributes:
        timestep: physics step in seconds, up to 0.1.
        gravity: along z, in m/s^2, in [-1000, 1000].
        iterations: Newton iterations per step. With ten, agents that push into a corner are ejected; with twenty they
            stay.
        ls_iterations: line-search iterations per Newton iteration.
        placement_margin: metres that drawn places keep from other objects and from the edges of the placement, such as
            those of the floor, along x or y. Given places (`placement_xy`) stay where they are. For what a
            `WorldBuilder` places; a `maax.Base`, whose layouts are drawn on the device, takes 0.
    """

    timestep: Annotated[float, Bounds(0, 0.1, above=True, takes="a positive number of seconds, up to 0.1")] = 0.005
    gravity: Annotated[float, Bounds(-1000.0, 1000.0)] = -9.81
    iterations: PositiveCount = 20
    ls_iterations: PositiveCount = 20
    placement_margin: NonNegative = 0.0

    def __post_init__(self) -> None:
        check_fields(self)


class WorldBuilder(Obj):
    """The tree's owner: append a `Floor`, build upwards from it, then ask for the spec.

    Args:
        params: physics options.
        seed: seed of the sizes and positions that the tree leaves open. The same seed gives the same MJCF.
    """

    kind = "world"

    def __init__(self, params: WorldParams | None = None, seed: int = 0):
        super().__init__("world")
        self.params = params or WorldParams()
        self.seed = seed

    def append(self, obj: Obj, placement_name: str = "root", placement_xy: tuple[float, float] | None = None) -> Obj:
        """Sets the root of the tree; see `Obj.append`."""
        if self.children:
            raise ValueError("obj: a WorldBuilder takes one root, its floor; append to that instead")
        return super().append(obj, placement_name, placement_xy)

    def mark_static(self) -> NoReturn:
        """Refuses: only objects of the world can be static."""
        raise ValueError("mark_static: a WorldBuilder is no object of its world; mark its objects")

    def mark(
        self,
        name: str,
        relative_xyz: Sequence[float] = CENTRE,
        absolute_xyz: Sequence[float] | None = None,
        rgba: Sequence[float] = (0.0, 0.0, 1.0, 1.0),
        geom_type: str = "sphere",
        size: float = 0.1,
    ) -> NoReturn:
        """Refuses: the world's extents are its floor's, and so are its marks."""
        raise ValueError("mark: a WorldBuilder has no extents; mark its floor")

    def set_material(self, material: Material) -> NoReturn:
        """Refuses: only objects have a material."""
        raise ValueError("set_material: a WorldBuilder has no geoms; set the material of its floor or objects")

    def to_spec(self) -> mujoco.MjSpec:
        """Runs the five phases and returns an uncompiled spec, equal at every call.

        Where objects have default poses, the spec has a keyframe "start" with them: `mujoco.mj_resetDataKeyframe(model,
        data, 0)` begins there.

        Raises:
            WorldFullError: an object does not fit.
            ValueError: there is no floor, an object names a placement that its parent lacks, two marks or two different
                materials share a name, or a default pose is of a joint that is not there or outside its range.
        """
        if not self.children:
            raise ValueError("WorldBuilder: got no floor; takes one before the spec, append(Floor())")
        root = self.children[0].obj
        root.assign_names(root.given_names())
        root.generate(np.random.default_rng(self.seed), margin=self.params.placement_margin)
        root.locate(np.zeros(3))
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.timestep = self.params.timestep
        spec.option.gravity = [0.0, 0.0, self.params.gravity]
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        spec.option.iterations = self.params.iterations
        spec.option.ls_iterations = self.params.ls_iterations
        root.add_to_spec(spec, spec.worldbody)
        for transform in self._transforms:
            transform(Written.below(spec, spec.worldbody))
        if poses := root.default_poses():
            spec.add_key(name=KEYFRAME, qpos=with_default_poses(spec.copy().compile(), poses))
        return spec

    def to_mjcf(self) -> str:
        """Returns the world as an MJCF string."""
        spec = self.to_spec()
        spec.compile()
        return spec.to_xml()

    def to_xinit(self) -> dict[str, float | np.ndarray]:
        """Returns the initial qpos of every joint of the world that `to_spec` builds, by the joint's name.

        It is the default pose of an object where that has one, else qpos0.

        Metres for slides, radians for hinges; (7,) for free joints: position in metres and unit quaternion, w first;
        (4,) for ball joints.

        Raises:
            ValueError: a joint has no name.
        """
        model = self.to_spec().compile()
        start = model.key_qpos[0] if model.nkey else model.qpos0
        xinit: dict[str, float | np.ndarray] = {}
        for joint in map(model.joint, range(model.njnt)):
            if not joint.name:
                body = model.body(model.jnt_bodyid[joint.id]).name
                raise ValueError(f"to_xinit: got a joint without a name in body {body!r}; takes names for all")
            qpos = start[joint.qposadr[0] :][: len(joint.qpos0)]
            xinit[joint.name] = qpos.copy() if len(qpos) > 1 else float(qpos[0])
        return xinit
