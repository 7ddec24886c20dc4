"""What tells environments apart, as files have it: their game with its fields, and the layers around it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import takewhile
from typing import Any

from maax_mjx.common.recorded import ENGINE, differing, flat, unchanged
from maax_mjx.core.env import Environment, Made
from maax_mjx.core.texts import constructed, plain, whole_text

DEFAULT = "its default"
OWN = "one's own"


def about_game(made: Made) -> dict[str, Any]:
    """Returns a game as files have it.

    Returns:
        A dict with the name of the "game", the fields of its "config" that differ from their defaults, and the
        "defaults" of the others, as they were when it was made: those that JSON has as they are, without the engine's.
    """
    defaults = {name: value for name, value in unchanged(made.config).items() if name != ENGINE and _is_plain(value)}
    return {
        "game": made.name,
        "config": plain(differing(made.config)),
        "defaults": plain(defaults),
    }


def about_environment(env: Environment) -> dict[str, Any]:
    """Returns an environment as files have it.

    Returns:
        What `about_game` has of the game in it, if `maax.make` made one, and texts of the "layers" around that, or of
        all of it, the innermost first.
    """
    made = env.made_from
    around = list(takewhile(lambda layer: layer.made is None, (*env.layers, env.base)))
    return {**(about_game(made) if made else {}), "layers": [_text(layer) for layer in reversed(around)]}


def told_apart(was: Mapping[str, Any], now: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the fields by which two games of one name, as files have them, are told apart.

    These are the fields that one of them changed, and those whose defaults were others, but not the engine.

    Args:
        was, now: as `about_game` returns them; what was written before there were "defaults" lacks these.
    """
    before, after = (flat({**about.get("defaults", {}), **about["config"]}) for about in (was, now))
    names = {*flat(was["config"]), *flat(now["config"])}
    names |= {name for name in before.keys() & after.keys() if before[name] != after[name]}
    names |= _groups_of_one(before, after) | _groups_of_one(after, before)
    told = sorted(names - {ENGINE})
    return {x: before.get(x, DEFAULT) for x in told}, {x: after.get(x, DEFAULT) for x in told}


def _groups_of_one(fields: Mapping[str, Any], others: Mapping[str, Any]) -> set[str]:
    """The fields that are one value here, such as None, and a config with fields of its own there."""
    return {name for name in fields if any(other.startswith(f"{name}.") for other in others)}


def difference(was: Mapping[str, Any], now: Mapping[str, Any], wrappers: bool = True) -> str:
    """Says how two environments differ, as far as both files know.

    Args:
        was, now: as `about_environment` returns them.
        wrappers: whether wrappers around a game, or a base, count.

    Returns:
        A text such as "env.horizon=60, not 20"; empty if they are the same.
    """
    if was.get("game") != now.get("game"):
        return f"game={was.get('game', OWN)}, not {now.get('game', OWN)}"
    if "game" in was and (text := differences(*told_apart(was, now), "env.")):
        return text
    before, after = was.get("layers"), now.get("layers")
    if before is None or after is None:
        return ""
    if not wrappers:
        before, after = ([] if "game" in was else layers[:1] for layers in (before, after))
    if before == after:
        return ""
    return f"{_first_other(before, after)}, not {_first_other(after, before)}"


def differences(was: Mapping[str, Any], now: Mapping[str, Any], prefix: str) -> str:
    """Says which fields differ, such as "net.core=gru, not lstm"; one that is not there has its default."""
    names = [name for name in dict.fromkeys((*was, *now)) if was.get(name, DEFAULT) != now.get(name, DEFAULT)]
    return "; ".join(f"{prefix}{name}={was.get(name, DEFAULT)}, not {now.get(name, DEFAULT)}" for name in names)


def _first_other(layers: list[str], others: list[str]) -> str:
    """The first layer that the other environment does not have in its place."""
    return next((layer for i, layer in enumerate(layers) if others[i : i + 1] != [layer]), "no further layer")


def _text(layer: Environment) -> str:
    """A wrapper, or a base and its modules, with the arguments of its construction."""
    modules = [whole_text(module) for module in layer.base.modules.values()] if layer is layer.base else []
    return " ".join([constructed(layer), *modules])


def _is_plain(value: Any) -> bool:
    """Whether JSON has a value as it is."""
    try:
        json.dumps(value)
    except (TypeError, ValueError):
        return False
    return True
