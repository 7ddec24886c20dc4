"""The canvas on which mechanics draw what they add to a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from maax_mjx.common.checks import check_choice, check_positive
from maax_mjx.common.colours import Colour
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.viewer.palette import DARK, blend
from maax_mjx.viewer.scene import UPRIGHT, Label, Line, Part, Shape, up
from maax_mjx.viewer.subject import Subject

N_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3, "sector": 2}
"""How many numbers are the size of every kind of solid."""
DIMMED = 0.55
"""Share of dark in agents that cannot take part for now: paler, they would look like boxes."""


@dataclass
class Marked:
    """Marks of all layers in one picture.

    Attributes:
        parts: solids.
        lines: straight lines.
        labels: texts in the world.
        words: lines of text below those of the teams.
        notes: texts beside the time.
        replaced: solids that stand for others, by the name of the other.
        tints: colours and their shares, by (kind, slot) of what takes them.
    """

    parts: list[Part] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    replaced: dict[str, Part] = field(default_factory=dict)
    tints: dict[tuple[str, int], list[tuple[Colour, float]]] = field(default_factory=dict)

    def tinted(self, kind: str, slot: int, rgba: Colour) -> Colour:
        """The colour of an object with its tints."""
        for colour, share in self.tints.get((kind, slot), []):
            rgba = blend(rgba, colour, share)
        return rgba


class Canvas:
    """The picture of one world at one time, to which a layer of the environment adds its marks.

    Positions are (3,) metres in the world, and colours are RGBA in [0, 1]. Names are unique among the solids, the
    lines and the labels of a layer, and the same at all times, by which a replay knows what moves.

    Args:
        subject: what the picture is of.
        state: of a single world, on the host.
        marked: where the marks go.
        layer: the name of the layer, with which all names begin; "" puts nothing before them.

    Attributes:
        subject: the model, the agents, their teams.
        colours: of the agents, by slot.
    """

    def __init__(self, subject: Subject, state: State, marked: Marked, layer: str = ""):
        self.subject, self.colours = subject, subject.colours
        self._state, self._marked, self._layer = state, marked, layer

    @property
    def playing(self) -> list[int]:
        """The slots of the agents in play."""
        return self.subject.playing(self._state).tolist()

    def position(self, agent: int) -> np.ndarray:
        """(3,) metres: the centre of an agent."""
        return self.centre(self.subject.agents, agent)

    def heading(self, agent: int) -> float:
        """Radians from the x axis to where an agent faces."""
        return float(self.subject.agents.headings(self._state.data)[agent])

    def centre(self, module: Entities, slot: int) -> np.ndarray:
        """(3,) metres: the centre of an object."""
        return np.asarray(self._state.data.xpos[module.body_ids[slot]], float)

    def top(self, module: Entities, slot: int) -> np.ndarray:
        """(3,) metres: the middle of the upper side of an object, however it is turned."""
        extents = np.asarray(module.extents_of(self._state.world), float)
        w, x, y, z = np.asarray(self._state.data.xquat[module.body_ids[slot]], float)
        top = np.abs([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        return self.centre(module, slot) + up(float(top @ extents[slot]) / 2)

    def solid(
        self, name: str, kind: str, size: Sequence[float], position: Any, colour: Sequence[float], *,
        rotation: np.ndarray = UPRIGHT, role: str = "mark",
    ) -> None:  # fmt: skip
        """Adds a solid. What changes its size all the time, as a bar does, is better a line.

        Args:
            name: see the class.
            kind: "box", "sphere", "cylinder", "capsule", "ellipsoid" or "sector".
            size: see `Shape`.
            position: of its centre.
            colour: of all of it.
            rotation: (3, 3) from its own frame.
            role: see `Part`.

        Raises:
            ValueError: an unknown kind, or numbers that are too many or too few.
        """
        self._marked.parts.append(_part(self._named(name), kind, size, position, colour, rotation, role))

    def line(self, name: str, ends: Any, colour: Sequence[float], *, width: float = 0.03, role: str = "mark") -> None:
        """Adds straight lines.

        Args:
            name: see the class.
            ends: (2, 3) of one line, or (n, 2, 3) of several.
            colour: of all of them.
            width: metres.
            role: see `Line`.

        Raises:
            ValueError: other ends, or a width that is not positive.
        """
        points = np.asarray(ends, float)
        if points.shape[-2:] != (2, 3) or points.ndim not in (2, 3):
            raise ValueError(f"ends: got the shape {points.shape}; takes (2, 3) metres, or (n, 2, 3) of several lines")
        width = check_positive("width", width)
        self._marked.lines.append(Line(self._named(name), role, points.reshape(-1, 2, 3), _rgba(colour), width))

    def label(
        self, name: str, text: str, position: Any, colour: Sequence[float] = DARK, *, role: str = "label"
    ) -> None:
        """Adds a short text at a place.

        Args:
            name: see the class.
            text: what it says.
            position: of its middle.
            colour: of the letters.
            role: see `Label`.

        Raises:
            ValueError: numbers that are too many or too few.
        """
        at, rgba = _numbers("position", position, 3), _rgba(colour)
        self._marked.labels.append(Label(self._named(name), role, str(text), at, rgba))

    def write(self, text: str) -> None:
        """Adds a line of words below those of the teams."""
        self._marked.words.append(str(text))

    def note(self, text: str) -> None:
        """Adds words beside the time."""
        self._marked.notes.append(str(text))

    def tint(self, kind: str, slot: int, colour: Sequence[float], share: float) -> None:
        """Gives an object some of another colour.

        Args:
            kind: of the object, such as "box" or "agent".
            slot: which of its kind.
            colour: the other colour.
            share: of it, in [0, 1].

        Raises:
            ValueError: a kind that the environment does not have, or a share out of its range.
        """
        check_choice("kind", kind, self.subject.kinds)
        if not 0 <= share <= 1:
            raise ValueError(f"share: got {share!r}; takes a number in [0, 1]")
        self._marked.tints.setdefault((kind, int(slot)), []).append((_rgba(colour), float(share)))

    def dim(self, agent: int) -> None:
        """Darkens an agent, which cannot take part for now."""
        self.tint(self.subject.agents.kind, agent, DARK, DIMMED)

    def replace(
        self, part: str, kind: str, size: Sequence[float], position: Any, colour: Sequence[float], *,
        rotation: np.ndarray = UPRIGHT,
    ) -> None:  # fmt: skip
        """Draws something else instead of a geom, where that is in the picture.

        Args:
            part: the geom's name, such as "agent0:hand_left".
            kind, size, position, colour, rotation: see `solid`.

        Raises:
            ValueError: as `solid`.
        """
        self._marked.replaced[part] = _part(part, kind, size, position, colour, rotation, "")

    def _named(self, name: str) -> str:
        return f"{self._layer}:{name}" if self._layer else name


def _part(
    name: str, kind: str, size: Sequence[float], position: Any, colour: Sequence[float], rotation: Any, role: str
) -> Part:
    sizes = _numbers("size", size, N_SIZES[check_choice("kind", kind, N_SIZES)])
    shape = Shape(kind, tuple(sizes.tolist()), _rgba(colour))
    turn = _numbers("rotation", np.ravel(rotation), 9).reshape(3, 3)
    return Part(name, role, shape, _numbers("position", position, 3), turn)


def _rgba(colour: Sequence[float]) -> Colour:
    red, green, blue, opacity = _numbers("colour", colour, 4).tolist()
    return red, green, blue, opacity


def _numbers(name: str, value: Any, n: int) -> np.ndarray:
    """(n,) of a user's mark."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (n,) or not np.isfinite(numbers).all():
        raise ValueError(f"{name}: got {value!r}; takes {n} finite numbers")
    return numbers
