"""The object tree and its five phases (thesis 4.3.2).

1. `append` builds a tree of objects, each in a named placement of its parent.
2. `assign_names` names what has no name yet.
3. `generate` draws sizes and the children's positions inside their placements.
4. `locate` turns relative positions into absolute ones.
5. `add_to_spec` writes bodies, joints and geoms into a `mujoco.MjSpec`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import mujoco
import numpy as np

Vec3 = np.ndarray
PLACEMENT_TRIES = 100


class WorldFullError(RuntimeError):
    """No room was found for an object inside its placement."""


@dataclass(frozen=True)
class Placement:
    """An axis-aligned box, relative to its object's lower corner, that holds children.

    Attributes:
        origin: lower corner in metres, (3,).
        size: extents in metres, (3,).
        stacked: children go on top of each other along z with a gap, instead of side by side.
    """

    origin: Vec3
    size: Vec3
    stacked: bool = False


@dataclass
class Child:
    """One edge of the tree: an object, the placement that holds it and where in it."""

    obj: Obj
    placement: str
    xy: tuple[float, float] | None


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

    def append(self, obj: Obj, placement_name: str = "top", placement_xy: tuple[float, float] | None = None) -> Obj:
        """Adds a child to a placement and returns the child.

        Args:
            obj: the child.
            placement_name: which placement of this object holds it.
            placement_xy: position as a fraction in [0, 1] of the free span; None draws it.

        Raises:
            ValueError: the object already has a parent, or `placement_xy` is outside [0, 1].
        """
        if placement_xy is not None and not (len(placement_xy) == 2 and all(0.0 <= f <= 1.0 for f in placement_xy)):
            raise ValueError(f"placement_xy: got {placement_xy}; takes two fractions in [0, 1]")
        if obj._has_parent:
            raise ValueError(f"obj: {obj.name or obj.kind} already has a parent; append a new object")
        obj._has_parent = True
        self.children.append(Child(obj, placement_name, placement_xy))
        return obj

    def mark_static(self) -> Obj:
        """Fixes the object: no joints, its geoms belong to the parent's body."""
        self.static = True
        return self

    def assign_names(self, counters: Counter[str]) -> None:
        """Phase 2: names every unnamed object "<kind><index>", counted over the whole tree, past `given_names`."""
        while self.name is None:
            name = f"{self.kind}{counters[self.kind]}"
            counters[self.kind] += 1
            if not counters[name]:
                self.name = name
        for child in self.children:
            child.obj.assign_names(counters)

    def given_names(self) -> Counter[str]:
        """The names that are given in this object's tree already."""
        own = Counter([self.name]) if self.name else Counter()
        return sum((child.obj.given_names() for child in self.children), own)

    def generate(self, rng: np.random.Generator) -> None:
        """Phase 3: draws this object's size, then its children's sizes and relative positions.

        Raises:
            WorldFullError: a child does not fit into its placement.
            ValueError: a child names a placement that this object lacks.
        """
        self._draw_size(rng)
        for child in self.children:
            if child.placement not in self.placements:
                raise ValueError(
                    f"placement_name: {self.name} has no placement {child.placement!r}; "
                    f"takes one of {sorted(self.placements)}"
                )
            child.obj.generate(rng)
        self._relative = [np.zeros(3)] * len(self.children)
        for name, placement in self.placements.items():
            ids = [i for i, child in enumerate(self.children) if child.placement == name]
            self._place(ids, name, placement, rng)

    def locate(self, position: Vec3) -> None:
        """Phase 4: fixes the absolute position (m) of the lower corner of this object and of all below it."""
        self.position = position
        for child, relative in zip(self.children, self._relative, strict=True):
            child.obj.locate(position + relative)

    def add_to_spec(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> None:
        """Phase 5: writes this object and its children into the spec."""
        body = self._write(spec, parent)
        for child in self.children:
            # A child of a movable object still moves on its own: only static ones join the parent's body.
            child.obj.add_to_spec(spec, body if child.obj.static else spec.worldbody)

    @property
    def centre(self) -> Vec3:
        """Absolute centre of the object's bounding box in metres, (3,); after phase 4."""
        return self.position + self.size / 2

    def _draw_size(self, rng: np.random.Generator) -> None:
        """Sets `size` and `placements`."""
        raise NotImplementedError

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> mujoco.MjsBody:
        """Writes this object alone and returns the body that holds its geoms."""
        raise NotImplementedError

    def _place(self, ids: list[int], name: str, placement: Placement, rng: np.random.Generator) -> None:
        done: list[tuple[Vec3, Vec3]] = []
        height = 0.0
        # Given places first, so that drawn ones keep clear of them.
        for i in sorted(ids, key=lambda i: self.children[i].xy is None):
            child = self.children[i]
            span = placement.size[:2] - child.obj.size[:2]
            if (span < 0).any():
                raise WorldFullError(f"{child.obj.name} of size {child.obj.size} is larger than {self.name}'s {name!r}")
            if placement.stacked:
                xy = span * (child.xy or (0.5, 0.5))
                self._relative[i] = placement.origin + np.array([*xy, height])
                height += 2 * max(child.obj.size[2], 1.0)
                continue
            xy = self._free_corner(child, span, done, rng, name)
            done.append((xy, child.obj.size[:2]))
            self._relative[i] = placement.origin + np.array([*xy, 0.0])

    def _free_corner(
        self, child: Child, span: Vec3, done: list[tuple[Vec3, Vec3]], rng: np.random.Generator, name: str
    ) -> Vec3:
        if child.xy is not None:
            return span * child.xy
        for _ in range(PLACEMENT_TRIES):
            xy = span * rng.uniform(size=2)
            size = child.obj.size[:2]
            if all(((xy >= p + s) | (p >= xy + size)).any() for p, s in done):
                return xy
        raise WorldFullError(f"no room for {child.obj.name} in {self.name}'s {name!r} after {PLACEMENT_TRIES} tries")
