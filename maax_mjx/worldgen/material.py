"""Materials of objects: colours and textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha1
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from maax_mjx.worldgen.checks import check_choice, check_rgba, check_vector
from maax_mjx.worldgen.written import Written

Rgb = Sequence[float]
PNG = b"\x89PNG\r\n\x1a\n"
"""The first bytes of every PNG file."""
PIXELS = 64
"""Edge of a texture's square faces, in pixels."""
WHITE = (1.0, 1.0, 1.0, 1.0)
LIGHT, DARK = (0.8, 0.8, 0.8), (0.5, 0.5, 0.5)
BUILTINS = {
    "checker": mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
    "gradient": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
    "flat": mujoco.mjtBuiltin.mjBUILTIN_FLAT,
}
TYPES = {"cube": mujoco.mjtTexture.mjTEXTURE_CUBE, "2d": mujoco.mjtTexture.mjTEXTURE_2D}


@dataclass(frozen=True)
class Material:
    """A colour, a texture that MuJoCo makes (MuJoCo docs, asset/texture `builtin`), or a picture from a PNG file.

    Models and MJCF strings name a picture's file by its absolute path, so that it has to stay where it is.

    The same material may be set on several objects. A random one draws the fields that are None from a hash of its
    name, so that the same name gives the same appearance in every world and on every machine (as in OpenAI's worldgen).

    Args:
        name: name in the model; None uses the name of each object that it is set on.
        rgba: colour, four numbers in [0, 1]; it tints a texture. None is white under a texture.
        texture: "checker" (two by two fields), "gradient" (from rgb1 to rgb2), "flat" (rgb1; the lower face rgb2), the
            path of a PNG file, whose opacity is left out, or None.
        rgb1: the texture's first colour, three numbers in [0, 1]; None is light grey.
        rgb2: its second colour; None is grey.
        texture_type: "cube" wraps it around the object, a whole one on each side; "2d" projects it along z, as a floor
            needs.
        repeat: repetitions of a "2d" texture along x and y of the object; None is one.
        random: whether to draw the fields that are None: the texture or a plain colour, and the colours.
        seed: seed of a random material, for another appearance under the same name.

    Raises:
        ValueError: a value outside its range; neither colour, texture nor `random`; colours or `repeat` that no texture
            uses; `random` with nothing left to draw; a seed without `random`; a PNG file that is missing or damaged, or
            on a "cube" not square.
    """

    name: str | None = None
    rgba: Sequence[float] | None = None
    texture: str | Path | None = None
    rgb1: Rgb | None = None
    rgb2: Rgb | None = None
    texture_type: str = "cube"
    repeat: tuple[float, float] | None = None
    random: bool = False
    seed: int | None = None

    def __post_init__(self) -> None:
        if self.name is not None and (not isinstance(self.name, str) or not self.name):
            raise ValueError(f"name: got {self.name!r}; takes a name or None")
        if self.rgba is not None:
            self._set("rgba", check_rgba("rgba", self.rgba))
        check_choice("texture_type", self.texture_type, list(TYPES))
        if self.texture is not None:
            object.__setattr__(self, "texture", check_texture(self.texture, self.texture_type))
        for name in ("rgb1", "rgb2"):
            value = getattr(self, name)
            if value is not None:
                self._set(name, check_vector(name, value, 3, "three numbers in [0, 1]: red, green and blue", 0.0, 1.0))
                if self.texture not in BUILTINS:
                    raise ValueError(f"{name}: got {value!r} without a texture of colours; takes None there")
        if self.repeat is not None:
            self._set("repeat", check_vector("repeat", self.repeat, 2, "two positive numbers, or None", 1e-9))
            if self.texture_type != "2d" or self.texture is None:
                raise ValueError(f"repeat: got {self.repeat!r}; takes None except with texture_type='2d' and a texture")
        if self.random and (self._is_file or None not in (self.texture, self.rgb1, self.rgb2)):
            given = "a file as texture" if self._is_file else "texture, rgb1 and rgb2 given"
            raise ValueError(f"random: got True with {given}; takes False, or one of texture, rgb1 and rgb2 None")
        if self.seed is not None and (not self.random or not isinstance(self.seed, int)):
            raise ValueError(f"seed: got {self.seed!r}; takes a whole number with random=True, else None")
        if not self.random and self.rgba is None and self.texture is None:
            raise ValueError("rgba: got None without a texture; takes a colour, a texture or random=True")

    @property
    def _is_file(self) -> bool:
        return self.texture is not None and self.texture not in BUILTINS

    def _set(self, name: str, vector: np.ndarray) -> None:
        # Tuples, whatever was given, so that equal materials compare equal.
        object.__setattr__(self, name, tuple(vector.tolist()))

    def write(self, written: Written, owner: str) -> None:
        """Sets this material on an object's geoms; `owner` is the object's name.

        Raises:
            ValueError: the spec has another material of this name.
        """
        spec, resolved = written.spec, self.resolve(owner)
        assert resolved.name is not None
        rgba = WHITE if resolved.rgba is None else resolved.rgba
        # MuJoCo shows `info` in a compiler error about an element; here it also distinguishes materials.
        there = spec.material(resolved.name)
        if there is not None and there.info != repr(resolved):
            raise ValueError(
                f"name: two different materials are named {resolved.name!r}; takes a name of its own for each"
            )
        if there is None:
            material = spec.add_material(name=resolved.name, rgba=rgba, info=repr(resolved))
            if resolved.texture is not None:
                resolved._add_texture(spec)
                material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = resolved.name
                material.texrepeat = resolved.repeat or (1.0, 1.0)
        for geom in written.geoms:
            # A geom's own colour overrides its material's.
            geom.material, geom.rgba = resolved.name, rgba

    def _add_texture(self, spec: mujoco.MjSpec) -> None:
        """Adds the texture of a resolved material to a spec."""
        texture = spec.add_texture(name=self.name, type=TYPES[self.texture_type])
        if self._is_file:
            texture.file = str(self.texture)
            return
        texture.builtin, texture.width, texture.height = BUILTINS[str(self.texture)], PIXELS, PIXELS
        texture.rgb1 = LIGHT if self.rgb1 is None else self.rgb1
        texture.rgb2 = DARK if self.rgb2 is None else self.rgb2

    def resolve(self, owner: str) -> Material:
        """Returns this material for an object named `owner`, with its name and all random fields filled in."""
        name = self.name or owner
        if not self.random:
            return replace(self, name=name)
        # Not Python's hash(), which differs from one process to the next.
        digest = sha1(f"{name}/{self.seed or 0}".encode(), usedforsecurity=False).digest()
        rng = np.random.default_rng(int.from_bytes(digest))
        plain, first, second = (tuple(rng.uniform(size=3).round(3).tolist()) for _ in range(3))
        texture = self.texture or str(rng.choice(list(BUILTINS)))
        if self.texture is None and self.rgba is None and rng.uniform() < 0.5:
            return Material(name, rgba=(*plain, 1.0))
        return Material(
            name, self.rgba, texture, self.rgb1 or first, self.rgb2 or second, self.texture_type, self.repeat
        )


def check_texture(texture: Any, texture_type: str) -> str:
    """Returns the name of a texture that MuJoCo makes, or the absolute path of a PNG file that MuJoCo reads.

    Raises:
        ValueError: another word, no such file, or a file that MuJoCo does not read as a PNG of this type of texture.
    """
    if isinstance(texture, str) and texture in BUILTINS:
        return texture
    file = Path(texture) if isinstance(texture, str | Path) else Path()
    if file.suffix.lower() != ".png":
        raise ValueError(f"texture: got {texture!r}; takes one of {list(BUILTINS)}, or the path of a PNG file")
    if not file.is_file():
        raise ValueError(f"texture: got {str(texture)!r}, which is no file; takes a PNG file")
    path = str(file.resolve())
    if file.read_bytes()[: len(PNG)] != PNG:
        raise ValueError(f"texture: got {str(texture)!r}, which holds no PNG image; takes a PNG file")
    spec = mujoco.MjSpec()
    spec.add_texture(name="texture", type=TYPES[texture_type], file=path)
    try:
        spec.compile()
    except ValueError as error:
        takes = "a whole PNG image, with texture_type='cube' a square one"
        reason = str(error).splitlines()[0]
        raise ValueError(f"texture: got {str(texture)!r}, which MuJoCo refuses ({reason}); takes {takes}") from error
    return path
