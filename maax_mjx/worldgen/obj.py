"""The object tree and its five phases (thesis 4.3.2).

1. `append` builds a tree of objects, each in a named placement of its parent.
2. `assign_names` names what has no name yet.
3. `generate` draws sizes and the children's positions inside their placements.
4. `locate` turns relative positions into absolute ones.
5. `add_to_spec` writes bodies, joints, geoms and sites into a `mujoco.MjSpec`, and runs the transforms.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from maax_mjx.worldgen.mark import CENTRE, Mark
from maax_mjx.worldgen.material import Material
from maax_mjx.worldgen.placement import Placement, WorldFullError, choose_placement
from maax_mjx.worldgen.written import Transform, Written

Vec3 = np.ndarray
PLACEMENT_TRIES = 100
"""Random positions tried for a child."""
TOLERANCE = 1e-6
"""Metres by which a child may be too large, since sizes read from files are float32."""
ANYTHING = np.full(2, np.inf)


@dataclass
class Child:
    """One edge of the tree: an object, the placement that holds it and where in it."""

    obj: Obj
    placement: str
    xy: tuple[float, float] | None

    def keeps(self, margin: float, placement: Placement) -> float:
        """Metres that the child keeps from the edges of its placement: none where its position is given."""
        return margin if self.xy is None and not placement.stacked else 0.0


class Obj:
    """A node of the object tree.

    Args:
        name: the body's name in the model; None numbers it after its kind ("box0", "box1").
    """

    kind = "obj"
    size: Vec3
    placements: dict[str, Placement]
    position: Vec3

    def __init__(self, name: str | None = None):
        self.name = name
        self.static = False
        self._has_parent = False
        self.children: list[Child] = []
        self._relative: list[Vec3] = []
        self._marks: list[Mark] = []
        self._material: Material | None = None
        self._transforms: list[Transform] = []

    def append(self, obj: Obj, placement_name: str = "top", placement_xy: tuple[float, float] | None = None) -> Obj:
        """Adds a child to a placement, and returns the child.

        Args:
            obj: the child.
            placement_name: placement of this object that holds it; or a common prefix of several, one of which is drawn
                uniformly ("shelf" for "shelf0" and "shelf1").
            placement_xy: position as a fraction in [0, 1] of the free span; None draws it.

        Raises:
            ValueError: the object already has a parent, or `placement_xy` is outside [0, 1].
        """
        if placement_xy is not None and not (len(placement_xy) == 2 and all(0.0 <= f <= 1.0 for f in placement_xy)):
            raise ValueError(f"placement_xy: got {placement_xy}; takes two fractions in [0, 1]")
        if obj._has_parent:
            raise ValueError(f"obj: got {obj.name or obj.kind}, which has a parent already; takes a new object")
        obj._has_parent = True
        self.children.append(Child(obj, placement_name, placement_xy))
        return obj

    def mark_static(self) -> Obj:
        """Fixes the object: no joints, its geoms belong to the parent's body."""
        self.static = True
        return self

    def mark(
        self,
        name: str,
        relative_xyz: Sequence[float] = CENTRE,
        absolute_xyz: Sequence[float] | None = None,
        rgba: Sequence[float] = (0.0, 0.0, 1.0, 1.0),
        geom_type: str = "sphere",
        size: float = 0.1,
    ) -> Obj:
        """Puts a named site on this object, which moves with it.

        Args:
            name: the site's name in the model, unique in the world.
            relative_xyz: (3,) position from the object's lower corner, as fractions of its extents.
            absolute_xyz: (3,) position from its lower corner in metres, instead of `relative_xyz`.
            rgba: colour, four numbers in [0, 1].
            geom_type: "sphere", "box", "cylinder", "capsule" or "ellipsoid".
            size: radius, or half the extent, in metres.

        Returns:
            This object.

        Raises:
            ValueError: a value outside its range, both positions, or a second mark of that name.
        """
        if any(mark.name == name for mark in self._marks):
            raise ValueError(f"name: {self.name or self.kind} has a mark {name!r} already; takes a new name")
        self._marks.append(Mark(name, relative_xyz, absolute_xyz, rgba, geom_type, size))
        return self

    def set_material(self, material: Material) -> Obj:
        """Sets the material of this object's geoms, in place of their colours, once, and returns this object.

        Raises:
            ValueError: no `Material`, or the object already has one.
        """
        if not isinstance(material, Material):
            raise ValueError(f"material: got {material!r}; takes a Material")
        if self._material is not None:
            raise ValueError(f"material: {self.name or self.kind} has {self._material} already; takes one per object")
        self._material = material
        return self

    def add_transform(self, fn: Transform) -> Obj:
        """Adds a function that changes this object's part of the spec, before its children are written.

        Transforms run in phase 5, in the order in which they were added, after the marks and the material. Those of the
        `WorldBuilder` run last and get the whole world.

        Args:
            fn: takes a `Written`; its result is ignored. `maax_mjx.worldgen.transforms` has some.

        Returns:
            This object.

        Raises:
            ValueError: `fn` cannot be called.
        """
        if not callable(fn):
            raise ValueError(f"fn: got {fn!r}; takes a function of a Written")
        self._transforms.append(fn)
        return self

    def assign_names(self, counters: Counter[str]) -> None:
        """Runs phase 2: names every unnamed object "<kind><index>", counted over the whole tree, past `given_names`."""
        while self.name is None:
            name = f"{self.kind}{counters[self.kind]}"
            counters[self.kind] += 1
            if not counters[name]:
                self.name = name
        for child in self.children:
            child.obj.assign_names(counters)

    def given_names(self) -> Counter[str]:
        """Returns the names already given in this object's tree."""
        own = Counter([self.name]) if self.name else Counter()
        return sum((child.obj.given_names() for child in self.children), own)

    def generate(self, rng: np.random.Generator, room: np.ndarray = ANYTHING, margin: float = 0.0) -> None:
        """Runs phase 3: draws this object's size, then its children's placements, sizes and relative positions.

        Args:
            rng: generator of all draws.
            room: (2,) metres, extents along x and y that the placement has for this object.
            margin: metres that drawn positions keep from other children and from the edges of their placement.

        Raises:
            WorldFullError: a child does not fit into its placement.
            ValueError: a child names a placement that this object lacks.
        """
        self._draw_size(rng, room)
        held_by = []
        for child in self.children:
            held_by.append(choose_placement(child.placement, self.placements, str(self.name), rng))
            placement = self.placements[held_by[-1]]
            child.obj.generate(rng, placement.size[:2] - 2 * child.keeps(margin, placement), margin)
        self._relative = [np.zeros(3)] * len(self.children)
        for name, placement in self.placements.items():
            self._place([i for i, held in enumerate(held_by) if held == name], name, placement, rng, margin)

    def locate(self, position: Vec3) -> None:
        """Runs phase 4: fixes the absolute position (m) of the lower corners of this object and all its descendants."""
        self.position = position
        for child, relative in zip(self.children, self._relative, strict=True):
            child.obj.locate(position + relative)

    def add_to_spec(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> None:
        """Runs phase 5: writes this object and its children into the spec."""
        written = self._write(spec, parent)
        for mark in self._marks:
            mark.write(written, self.position, self.size)
        if self._material is not None:
            self._material.write(written, str(self.name))
        for transform in self._transforms:
            transform(written)
        for child in self.children:
            # A child of a movable object moves on its own: only static ones join the parent's body.
            child.obj.add_to_spec(spec, written.body if child.obj.static else spec.worldbody)

    @property
    def default_qpos(self) -> dict[str, np.ndarray]:
        """The values of joints in which the object itself begins, by the joints' names in the world; after phase 2."""
        return {}

    def default_poses(self) -> dict[str, np.ndarray]:
        """Returns `default_qpos` of this object and all its descendants."""
        below = (child.obj.default_poses() for child in self.children)
        return {name: qpos for poses in (self.default_qpos, *below) for name, qpos in poses.items()}

    @property
    def centre(self) -> Vec3:
        """Absolute centre of the object's bounding box in metres, (3,); after phase 4."""
        return self.position + self.size / 2

    def _draw_size(self, rng: np.random.Generator, room: np.ndarray) -> None:
        """Sets `size` and `placements`; `room` (2,) is the placement's extents along x and y in metres."""
        raise NotImplementedError

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> Written:
        """Writes this object without its children, and returns what was written."""
        raise NotImplementedError

    def _place(self, ids: list[int], name: str, placement: Placement, rng: np.random.Generator, margin: float) -> None:
        done: list[tuple[Vec3, Vec3]] = []
        height = 0.0
        # Given positions first, so that drawn ones avoid them.
        for i in sorted(ids, key=lambda i: self.children[i].xy is None):
            child = self.children[i]
            edge = child.keeps(margin, placement)
            free = placement.size - child.obj.size - [2 * edge, 2 * edge, 0.0]
            if (free < -TOLERANCE).any():
                within = f" with a margin of {edge:g} m" if edge else ""
                raise WorldFullError(
                    f"{child.obj.name} of size {child.obj.size} m is larger than {self.name}'s {name!r} of size "
                    f"{placement.size} m{within}"
                )
            span = np.maximum(free[:2], 0.0)
            if placement.stacked:
                xy = span * (child.xy or (0.5, 0.5))
                self._relative[i] = placement.origin + np.array([*xy, height])
                height += 2 * max(child.obj.size[2], 1.0)
                continue
            xy = self._free_corner(child, span, done, rng, name, margin)
            done.append((xy, child.obj.size[:2]))
            self._relative[i] = placement.origin + np.array([*xy, 0.0])

    def _free_corner(
        self,
        child: Child,
        span: Vec3,
        done: list[tuple[Vec3, Vec3]],
        rng: np.random.Generator,
        name: str,
        margin: float,
    ) -> Vec3:
        if child.xy is not None:
            return span * child.xy
        for _ in range(PLACEMENT_TRIES):
            xy = margin + span * rng.uniform(size=2)
            size = child.obj.size[:2]
            if all(((xy >= p + s + margin) | (p >= xy + size + margin)).any() for p, s in done):
                return xy
        kept = f" with a margin of {margin:g} m" if margin else ""
        raise WorldFullError(
            f"no room for {child.obj.name} in {self.name}'s {name!r}{kept} after {PLACEMENT_TRIES} tries"
        )
