"""Materials: how an object looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha1

import mujoco
import numpy as np

from maax_mjx.worldgen.checks import check_choice, check_rgba, check_vector
from maax_mjx.worldgen.written import Written

Rgb = Sequence[float]
PIXELS = 64
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
    """A colour, or a texture that MuJoCo makes (MuJoCo docs, asset/texture `builtin`): no files.

    The same material may be set on several objects. A random one draws what is left None from a hash of its name, so
    that the same name gives the same look in every world and on every machine (as in OpenAI's worldgen).

    Args:
        name: in the model; None takes the name of each object that it is set on.
        rgba: colour, four numbers in [0, 1]; it tints a texture. None is white under a texture.
        texture: "checker" (two by two fields), "gradient" (from rgb1 to rgb2), "flat" (rgb1; the lower face rgb2), or
            None.
        rgb1: the texture's first colour, three numbers in [0, 1]; None is light grey.
        rgb2: its second colour; None is grey.
        texture_type: "cube" wraps it around the object, a whole one on each side; "2d" projects it along z, which is
            what a floor takes.
        repeat: how often a "2d" texture repeats along x and y of the object; None is once.
        random: whether to draw what is left None: the texture or a plain colour, and the colours.
        seed: of a random one: another look under the same name.

    Raises:
        ValueError: a value outside its range; nothing that gives a look; colours or `repeat` that no texture would
            use; `random` with nothing left to draw; a seed without `random`.
    """

    name: str | None = None
    rgba: Sequence[float] | None = None
    texture: str | None = None
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
        if self.texture is not None:
            check_choice("texture", self.texture, list(BUILTINS))
        for name in ("rgb1", "rgb2"):
            value = getattr(self, name)
            if value is not None:
                self._set(name, check_vector(name, value, 3, "three numbers in [0, 1]: red, green and blue", 0.0, 1.0))
                if self.texture is None:
                    raise ValueError(f"{name}: got {value!r} without a texture; takes one beside it")
        check_choice("texture_type", self.texture_type, list(TYPES))
        if self.repeat is not None:
            self._set("repeat", check_vector("repeat", self.repeat, 2, "two positive numbers, or None", 1e-9))
            if self.texture_type != "2d" or self.texture is None:
                raise ValueError(f"repeat: got {self.repeat!r}; takes None but for a texture of texture_type='2d'")
        if self.random and None not in (self.texture, self.rgb1, self.rgb2):
            raise ValueError("random: got True with texture, rgb1 and rgb2 given; takes False, or one of them None")
        if self.seed is not None and (not self.random or not isinstance(self.seed, int)):
            raise ValueError(f"seed: got {self.seed!r}; takes a whole number with random=True, else None")
        if not self.random and self.rgba is None and self.texture is None:
            raise ValueError("rgba: got None without a texture; takes a colour, a texture or random=True")

    def _set(self, name: str, vector: np.ndarray) -> None:
        # Tuples, whatever came in, so that equal looks compare equal.
        object.__setattr__(self, name, tuple(vector.tolist()))

    def write(self, written: Written, owner: str) -> None:
        """Gives what an object wrote this look; `owner` is the object's name.

        Raises:
            ValueError: the spec has another material of this name.
        """
        spec, look = written.spec, self.look(owner)
        assert look.name is not None
        rgba = WHITE if look.rgba is None else look.rgba
        # `info` is MuJoCo's place for what a compiler error should say of an element; here it also tells looks apart.
        there = spec.material(look.name)
        if there is not None and there.info != repr(look):
            raise ValueError(f"name: two different materials are named {look.name!r}; takes a name of its own for each")
        if there is None:
            material = spec.add_material(name=look.name, rgba=rgba, info=repr(look))
            if look.texture is not None:
                spec.add_texture(
                    name=look.name, type=TYPES[look.texture_type], builtin=BUILTINS[look.texture],
                    rgb1=LIGHT if look.rgb1 is None else look.rgb1, rgb2=DARK if look.rgb2 is None else look.rgb2,
                    width=PIXELS, height=PIXELS,
                )  # fmt: skip
                material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = look.name
                material.texrepeat = look.repeat or (1.0, 1.0)
        for geom in written.geoms:
            # A geom's own colour goes before its material's.
            geom.material, geom.rgba = look.name, rgba

    def look(self, owner: str) -> Material:
        """This material with its name, and what `random` leaves open, filled in for an object named `owner`."""
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
