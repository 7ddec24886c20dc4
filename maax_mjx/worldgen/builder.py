"""From the object tree to a `mujoco.MjSpec`."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from maax_mjx.worldgen.obj import Obj


@dataclass(frozen=True)
class WorldParams:
    """Physics options of a world.

    Attributes:
        timestep: physics step in seconds.
        gravity: along z, in m/s^2.
        iterations: Newton iterations per step. Ten eject agents that push into a corner; twenty hold them.
        ls_iterations: line-search iterations per Newton iteration.
    """

    timestep: float = 0.005
    gravity: float = -9.81
    iterations: int = 20
    ls_iterations: int = 20

    def __post_init__(self) -> None:
        if not _is_number(self.timestep) or not self.timestep > 0:
            raise ValueError(f"timestep: got {self.timestep!r}; takes a positive number of seconds")
        if not _is_number(self.gravity):
            raise ValueError(f"gravity: got {self.gravity!r}; takes a number, in m/s^2 along z")
        for name in ("iterations", "ls_iterations"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name}: got {value!r}; takes a whole number of at least 1")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


class WorldBuilder(Obj):
    """The tree's owner: append a `Floor`, build upwards from it, then ask for the spec.

    Args:
        params: physics options.
        seed: of the sizes and positions that the tree leaves open. The same seed gives the same MJCF.
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

    def to_spec(self) -> mujoco.MjSpec:
        """Runs the five phases and returns an uncompiled spec.

        Raises:
            WorldFullError: an object does not fit.
        """
        if not self.children:
            raise ValueError("WorldBuilder: got no floor; append a Floor first")
        root = self.children[0].obj
        root.assign_names(root.given_names())
        root.generate(np.random.default_rng(self.seed))
        root.locate(np.zeros(3))
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.timestep = self.params.timestep
        spec.option.gravity = [0.0, 0.0, self.params.gravity]
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        spec.option.iterations = self.params.iterations
        spec.option.ls_iterations = self.params.ls_iterations
        root.add_to_spec(spec, spec.worldbody)
        return spec

    def to_mjcf(self) -> str:
        """The world as an MJCF string."""
        spec = self.to_spec()
        spec.compile()
        return spec.to_xml()
