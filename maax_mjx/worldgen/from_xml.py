"""Objects from MJCF files and texts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path

import mujoco
import numpy as np

from maax_mjx.worldgen.annotations import MAIN, PREFIX, read_annotations
from maax_mjx.worldgen.checks import check_rgba
from maax_mjx.worldgen.default_pose import check_default_qpos
from maax_mjx.worldgen.joints import refer_slides
from maax_mjx.worldgen.obj import Obj
from maax_mjx.worldgen.written import Written, body_position

ASSETS = Path(__file__).parent / "assets"


class ObjFromXML(Obj):
    """An object read from an MJCF file, or from its text.

    It holds one body named "main", without rotation, and a body "annotation:outer_bound" whose box geom is the
    object's bounding box. Every other body "annotation:<name>" with a box geom is a placement <name> for children,
    which stand on the box's lower face and must fit into it ("annotation:top", "annotation:inside"; OpenAI's
    worldgen). "main" may hold other bodies, on joints or fixed. The model leaves out annotations and keyframes. In it,
    "main" gets the object's name, and every other name gets that as a prefix: `agent0`, `agent0:x`,
    `agent0:hand_left`. What has no name is numbered: `table0:geom0`.

    Args:
        source: the file, a bare name among the package's assets, or MJCF as text, which begins with "<".
        name: the object's name.
        rgba: colour for all its geoms; None keeps its own.
        default_qpos: the pose in which it begins, by the joints' names in the file ("hinge"): radians of hinges, metres
            of slides, a quaternion (4,), w first, of ball joints. Where "main" is, its placement says, so that its
            slides and its free joint have none. Joints that are not named begin as the file has them.

    Raises:
        ValueError: no such file, MJCF that MuJoCo refuses, a missing body, another body or geom next to "main", a body
            that is turned or lacks its box, `rgba` is no colour, or a default pose of a joint that the file lacks or
            that does not take it.
    """

    def __init__(
        self,
        source: str | Path,
        name: str | None = None,
        *,
        rgba: tuple[float, ...] | None = None,
        default_qpos: Mapping[str, float | Sequence[float]] | None = None,
    ):
        super().__init__(name)
        if rgba is not None:
            check_rgba("rgba", rgba)
        self.rgba = rgba
        text = str(source).lstrip()
        if text.startswith("<"):
            where, read = "the text", mujoco.MjSpec.from_string
        else:
            file = _found(source)
            text = where = str(file)
            self.kind, read = file.stem, mujoco.MjSpec.from_file
        try:
            self._source = read(text)
        except ValueError as error:
            raise ValueError(f"source: {where} is not MJCF that MuJoCo takes: {error}") from error
        self._annotations = read_annotations(self._source, where)
        self._default_qpos = check_default_qpos(default_qpos, self._source)

    @property
    def default_qpos(self) -> dict[str, np.ndarray]:
        return {f"{self.name}:{joint}": qpos for joint, qpos in self._default_qpos.items()}

    def _draw_size(self, rng: np.random.Generator, room: np.ndarray) -> None:
        self.size, self.placements = self._annotations.size, self._annotations.placements

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> Written:
        source = self._source.copy()
        for name in [body.name for body in source.bodies if body.name.startswith(PREFIX)]:
            source.delete(source.body(name))
        # They are of the file's own qpos, not of the world's.
        for key in list(source.keys):
            source.delete(key)
        _name_all(source)
        if self.static:
            if self._default_qpos:
                got = ", ".join(self._default_qpos)
                raise ValueError(
                    f"default_qpos: got {got} of {self.name}, which is static; takes None for what has no joints"
                )
            for element in [*source.actuators, *source.joints]:
                source.delete(element)
        spec.attach(source, prefix=f"{self.name}:", frame=parent.add_frame())
        body = spec.body(f"{self.name}:{MAIN}")
        position = self.centre + self._annotations.main
        body.pos = position - body_position(parent)
        refer_slides(body, position)
        main = f"{self.name}:{MAIN}"
        for element in [body, *body.geoms]:
            if element.name == main:
                element.name = self.name
        # These name the body and the geom, and do not follow.
        for elements, names in ((spec.excludes, ("bodyname1", "bodyname2")), (spec.pairs, ("geomname1", "geomname2"))):
            for element in elements:
                for name in names:
                    if getattr(element, name) == main:
                        setattr(element, name, self.name)
        written = Written.below(spec, body)
        if self.rgba is not None:
            for geom in written.geoms:
                geom.rgba = self.rgba
        return written


def _name_all(source: mujoco.MjSpec) -> None:
    """Names the bodies, geoms, joints and sites that have no name."""
    for kind, elements in (
        ("body", source.bodies[1:]), ("geom", source.geoms), ("joint", source.joints), ("site", source.sites),
    ):  # fmt: skip
        taken = {element.name for element in elements}
        names = (name for name in map(f"{kind}{{}}".format, count()) if name not in taken)
        for element in elements:
            element.name = element.name or next(names)


def _found(source: str | Path) -> Path:
    """The file of this path, or the asset of this name."""
    file = next((path for path in (Path(source), ASSETS / f"{source}.xml") if path.is_file()), None)
    if file is None:
        assets = sorted(path.stem for path in ASSETS.glob("*.xml"))
        raise ValueError(f"source: got {str(source)!r}; takes an MJCF file, an asset of {assets}, or MJCF as text")
    return file
