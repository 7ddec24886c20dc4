"""Registry of what draws the mechanics."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import Any, NamedTuple, TypeVar

from maax_mjx.common.checks import check_choice, described
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.wrappers.wrapper import Wrapper

D = TypeVar("D", bound=Callable[..., Any])

SENSES = ("vision", "lidar")
"""Arguments of `render`, `video` and `replay` that ask for marks."""


class Mark(NamedTuple):
    """The marks of one layer of an environment.

    Attributes:
        layer: a name that no other layer of the environment has.
        draw: adds them to the picture of a state.
    """

    layer: str
    draw: Callable[[State, Canvas], None]


class _Registered(NamedTuple):
    draw: Callable[..., Any]
    sense: str | None


_REGISTERED: dict[type[Wrapper], _Registered] = {}


def marks_of(mechanic: type[Wrapper], *, sense: str | None = None) -> Callable[[D], D]:
    """Registers what draws a mechanic: in `render`, `video` and `replay`, for every layer of its class.

    Decorate a function `(layer, state, canvas)`. It is called for every picture and every layer of the class, with the
    wrapper, the state of a single world on the host, and a `Canvas` that takes solids, lines, labels, words and tints.
    Or decorate a class, for what is prepared once: it is made with `(layer)`, and called with `(state, canvas)`.

    A layer of a subclass without marks of its own is drawn as its nearest base class is. Read the layer's memory by
    `layer.name`, since an environment may have several layers of one class.

    Example:
        A battery that runs down as agents push, and a bar and a number over each of them:

        ```python
        class Battery(maax.Wrapper):
            name = "battery"

            def begin(self, key, params):
                return self.remember(self.env.begin(key, params), jnp.ones(self.base.n_agents))

            def transition(self, state, action):
                left = state.mechanics[self.name] - 0.01 * jnp.abs(action["move"]).mean(axis=1)
                return self.remember(self.env.advance(state, action), jnp.maximum(left, 0.0))

        @maax.marks_of(Battery)
        def draw_battery(layer, state, canvas):
            for agent in canvas.playing:
                left = state.mechanics[layer.name][agent]
                start = canvas.position(agent) + [-0.2, 0.0, 0.4]
                canvas.line(f"bar{agent}", [start, start + [0.4 * left, 0.0, 0.0]], canvas.colours[agent], width=0.05)
                canvas.label(f"charge{agent}", f"{left:.0%}", start + [0.2, 0.0, 0.1])
        ```

    Args:
        mechanic: a wrapper class.
        sense: "vision" or "lidar": the argument of `render`, `video` and `replay` that asks for these marks; None draws
            them always.

    Returns:
        The decorator, which gives back what it decorates.

    Raises:
        ValueError: not a wrapper class, a class that has marks already, an unknown sense, or something that cannot be
            called.
    """
    if not isinstance(mechanic, type) or not issubclass(mechanic, Wrapper):
        raise ValueError(f"mechanic: got {_name(mechanic)}; takes a subclass of Wrapper")
    if mechanic in _REGISTERED:
        drawn_by = _name(_REGISTERED[mechanic].draw)
        raise ValueError(
            f"mechanic: got {_name(mechanic)}, which {drawn_by} draws already; takes a class without marks, such as a "
            "subclass of it"
        )
    if sense is not None:
        check_choice("sense", sense, SENSES)

    def register(draw: D) -> D:
        if not callable(draw):
            raise ValueError(f"marks_of: got {described(draw)}; takes a function (layer, state, canvas), or a class")
        _REGISTERED[mechanic] = _Registered(draw, sense)
        return draw

    return register


def marks_for(env: Environment, senses: Collection[str] = ()) -> list[Mark]:
    """The marks of all layers of an environment, the innermost first.

    Args:
        env: the environment.
        senses: those whose marks are asked for.

    Raises:
        ValueError: a sense that no layer has.
    """
    marks, missing = [], set(senses)
    for i, layer in enumerate(reversed(env.layers)):
        registered = next((_REGISTERED[kind] for kind in type(layer).__mro__ if kind in _REGISTERED), None)
        if registered is None or not (registered.sense is None or registered.sense in senses):
            continue
        missing.discard(registered.sense or "")
        draw, name = registered.draw, layer.name or f"layer{i}"
        marks.append(Mark(name, draw(layer) if isinstance(draw, type) else partial(draw, layer)))
    for sense in sorted(missing):
        needs = " or ".join(_name(kind) for kind, registered in _REGISTERED.items() if registered.sense == sense)
        raise ValueError(f"{sense}: got True, and env has no {needs}; takes True where env has one, else False")
    return marks


def _name(thing: Any) -> str:
    """The name of a class or function, or a short text for anything else."""
    return getattr(thing, "__name__", described(thing))
