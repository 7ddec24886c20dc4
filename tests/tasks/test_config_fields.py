"""Every field of every game's config refuses what it cannot be, in words; games and fields added later are covered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from types import NoneType
from typing import Annotated, Any, get_args

import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.common.annotated import Bounds, OneOf, check_value, field_kinds
from maax_mjx.tasks.config import override
from maax_mjx.tasks.registry import _TASKS

NEVER = (object(), 1j, np.complex64(1), b"ice", {1, 2}, float("nan"), 2**200, -(10**400), [[]])
"""No field takes these."""


def dotted_fields(config, prefix=""):
    """Dotted names of all fields, with an example value, those inside configs that are None by default too."""
    for f in fields(config):
        value = getattr(config, f.name)
        inner = [k for k in get_args(field_kinds(type(config))[f.name]) if isinstance(k, type) and is_dataclass(k)]
        yield f"{prefix}{f.name}", value
        if is_dataclass(value):
            yield from dotted_fields(value, f"{prefix}{f.name}.")
        elif inner:
            yield from dotted_fields(inner[0](), f"{prefix}{f.name}.")


def changed(game, name, value):
    """The game's config with one field changed; a config that holds it begins with its defaults."""
    head, dot, _ = name.partition(".")
    config = maax.config_of(game)
    if dot and getattr(config, head) is None:
        kinds = get_args(field_kinds(type(config))[head])
        config = replace(config, **{head: next(k for k in kinds if k is not NoneType)()})
    return override(config, {name: value}, game)


def refused(game, name, value):
    with pytest.raises(ValueError) as caught:  # noqa: PT011, its words are held below
        changed(game, name, value)
    told = str(caught.value)
    assert told.startswith(f"{name}: got "), told
    assert "takes " in told


FIELDS = [(game, name, value) for game in maax.tasks() for name, value in dotted_fields(maax.config_of(game))]


def test_all_games_have_fields():
    assert {"hide_and_seek", "tag", "capture_the_flag"} <= {game for game, *_ in FIELDS} <= set(maax.tasks())
    assert {"horizon", "world_params.iterations", "lock.radius", "grab.radius"} <= {name for _, name, _ in FIELDS}


@pytest.mark.parametrize("game", maax.tasks())
def test_no_field_takes_nonsense(game):
    for name in (name for g, name, _ in FIELDS if g == game):
        for value in NEVER:
            refused(game, name, value)


@pytest.mark.parametrize("game", maax.tasks())
def test_fields_hold_to_the_type_of_their_defaults(game):
    """Wrong values by the default alone, whatever the annotation says."""
    for name, example in ((name, value) for g, name, value in FIELDS if g == game):
        if isinstance(example, bool):
            wrong = ["no", "True", 0, 1, 1.0, (True, False)]
        elif isinstance(example, int | float):
            wrong = [True, "3", [3], (1, 2, 3), {"a": 1}, np.ones(2), 2**31 if isinstance(example, int) else 1e39]
        elif isinstance(example, str):
            wrong = [3, True, None, (3, 4)]
        else:
            wrong = []
        for value in wrong:
            refused(game, name, value)


@pytest.mark.parametrize("n", range(3))
def test_what_a_world_s_config_takes_can_be_built_or_is_refused(n):
    """Numbers of all magnitudes: the world is built, or a sentence names what is wrong."""
    rng = seeds.rng(n)
    numbers = [(name, value) for game, name, value in FIELDS if game == "standard" and type(value) in (int, float)]
    built = 0
    for name, example in numbers:
        for _ in range(6):
            value = float(rng.choice([-1, 1, 1]) * 10 ** rng.uniform(-3, 12))
            value = round(value) if isinstance(example, int) else value
            try:
                maax.make("standard", impl="c", **{name: value})
                built += 1
            except ValueError as error:
                assert ": " in str(error)  # noqa: PT017
                assert "takes" in str(error) or "needs" in str(error)  # noqa: PT017
    assert built > len(numbers), "a third of them, about, are within the bounds"


@dataclass(frozen=True)
class Plain:
    """A user's config, without our base class."""

    speed: Annotated[float, Bounds(0, 2)] = 1.0
    colour: Annotated[str, OneOf(("red", "blue"))] = "red"


def test_a_users_own_config_is_held_to_its_annotations():
    maax.register("plain", lambda config: maax.make("standard", impl="c"), Plain)
    try:
        assert maax.make("plain", speed=2).n_agents == 4
        for call in (lambda: maax.make("plain", speed=3), lambda: maax.make("plain", Plain(speed=3))):
            with pytest.raises(ValueError, match=r"speed: got 3; takes a number in \[0, 2\]"):
                call()
        with pytest.raises(ValueError, match=r"colour: got 'bleu'; did you mean 'blue'\? It takes one of"):
            maax.make("plain", colour="bleu")
    finally:
        del _TASKS["plain"]


@pytest.mark.parametrize(
    ("kind", "taken", "refused"),
    [
        (int, [0, -5, np.int64(3), 2**31 - 1], [2**31, 1.0, True, "1", None, np.float32(1)]),
        (float, [0, 1.5, np.float32(2), 3e38], [4e38, float("inf"), float("nan"), 1j, True]),
        (Annotated[float, Bounds(0, 1, above=True)], [1e-9, 1], [0, 1.0001, -1]),
        (Annotated[int | tuple[int, int], Bounds(0, 9)], [3, (0, 9), [2, 2]], [(3, 1), (0, 10), (1,), (1, 2.0), 10]),
        (tuple[float, float] | None, [None, (3, 1)], [(1,), 3, "ab"]),
        (tuple[str, ...], [(), ("a", "b"), ["a"]], ["a", (1,)]),
        (Any, [1, "a", None], []),
        (int | Callable[[int], int], [3, len], ["len"]),
        (dict[str, int], [{}, {"a": 1}], [{1: 1}, {"a": 1.5}, [("a", 1)]]),
    ],
)
def test_types_and_their_values(kind, taken, refused):
    for value in taken:
        assert check_value("x", value, kind) is value
    for value in refused:
        with pytest.raises(ValueError, match="x: got "):
            check_value("x", value, kind)
