"""Objects from MJCF files."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from maax_mjx.worldgen.joints import refer_slides
from maax_mjx.worldgen.obj import Obj

ASSETS = Path(__file__).parent / "assets"
OUTER_BOUND = "annotation:outer_bound"
MAIN = "main"


class ObjFromXML(Obj):
    """An object read from an MJCF file.

    The file holds one body named "main", without rotation, and a body "annotation:outer_bound" whose box geom
    gives the object's extents (it is left out of the model). In the model, "main" takes the object's name, and every
    other name gets it as a prefix: `agent0`, `agent0:x`, `agent0:hand_left`.

    Args:
        path: the file; a bare name is looked up among the package's assets.
        name: the object's name.
        rgba: colour for all its geoms; None keeps the file's.

    Raises:
        ValueError: no such file, or a body is missing from it.
    """

    def __init__(self, path: str | Path, name: str | None = None, *, rgba: tuple[float, ...] | None = None):
        super().__init__(name)
        file = next((p for p in (Path(path), ASSETS / f"{path}.xml") if p.is_file()), None)
        if file is None:
            assets = sorted(p.stem for p in ASSETS.glob("*.xml"))
            raise ValueError(f"path: got {str(path)!r}; takes an MJCF file or one of the assets {assets}")
        self.kind = file.stem
        self.rgba = rgba
        self._source = mujoco.MjSpec.from_file(str(file))
        for body in (OUTER_BOUND, MAIN):
            if self._source.body(body) is None:
                raise ValueError(f"path: {file} has no body {body!r}")

    def _draw_size(self, rng: np.random.Generator) -> None:
        self.size = 2 * np.array(self._source.body(OUTER_BOUND).geoms[0].size)
        self.placements = {}

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> mujoco.MjsBody:
        source = self._source.copy()
        source.delete(source.body(OUTER_BOUND))
        if self.static:
            for element in [*source.actuators, *source.joints]:
                source.delete(element)
        spec.attach(source, prefix=f"{self.name}:", frame=parent.add_frame())
        body = spec.body(f"{self.name}:{MAIN}")
        body.pos = self.centre - parent.pos
        refer_slides(body, self.centre)
        for element in [body, *body.geoms]:
            if element.name == f"{self.name}:{MAIN}":
                element.name = self.name
        if self.rgba is not None:
            for geom in body.geoms:
                geom.rgba = self.rgba
        return body
