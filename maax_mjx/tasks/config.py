"""Configs of games, frozen dataclasses: what all can have, and overriding fields by name or dotted name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar, get_args

from maax_mjx.common.annotated import check_fields, check_value, field_kinds
from maax_mjx.common.checks import check_choice
from maax_mjx.common.recorded import unchanged
from maax_mjx.core.env import Environment
from maax_mjx.core.texts import plain
from maax_mjx.modules import Module
from maax_mjx.wrappers.extend import Layers, extended

C = TypeVar("C")


@dataclass(frozen=True)
class Config:
    """A config whose fields are held against their annotations as it is made.

    Raises:
        ValueError: a value that a field's annotation does not allow; the message names the field.
    """

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Extensions(Config):
    """What is put into a game besides its own parts; see `extended`.

    Attributes:
        modules: modules that are added after its own.
        inside: layers by the layer that they are put inside of.
        outside: layers by the layer that they are put around.
    """

    modules: Sequence[Module] = ()
    inside: Layers = field(default_factory=dict)
    outside: Layers = field(default_factory=dict)

    def extend(self, env: Environment) -> Environment:
        """Returns the environment with what the config puts into it.

        Raises:
            ValueError: what `extended` refuses.
        """
        if not (self.modules or self.inside or self.outside):
            return env
        return extended(env, self.modules, self.inside, self.outside)


def override(config: C, overrides: Mapping[str, Any], where: str, path: str = "") -> C:
    """Returns the config with some fields changed.

    Args:
        config: a frozen dataclass.
        overrides: values by name: "n_boxes", or "world_params.gravity" for a field of a field, "teams.players"
            for an item of a mapping.
        where: name of the config in messages.
        path: dotted name of the config within the outermost one, with a dot at its end, in messages.

    Raises:
        ValueError: an unknown name, with the nearest ones, or a value that the field's annotation does not allow.
    """
    for name, value in overrides.items():
        head, dot, rest = name.partition(".")
        inner = getattr(config, head, None)
        if head not in {f.name for f in fields(config)}:  # type: ignore[arg-type]
            check_choice(where, name, field_names(config))
        if dot and isinstance(inner, Mapping):
            check_choice(f"{where}, {head}", rest, inner)
            config = replace(config, **{head: {**inner, rest: value}})  # type: ignore[type-var]
            continue
        if dot and (not is_dataclass(inner) or isinstance(inner, type)):
            kind = inner_config(type(config), head) if inner is None else None
            first = f"; give {head} a {kind.__name__} first (--env.{path}{head} True in a shell)" if kind else ""
            raise ValueError(f"{where}: got {name!r}, but {head} is {inner!r}, which has no fields{first}")
        if dot:
            value = override(inner, {rest: value}, f"{where}, {head}", f"{path}{head}.")
        elif is_dataclass(inner) and isinstance(value, Mapping):
            names = {f"{path}{name}.{field}": x for field, x in value.items()}
            raise ValueError(f"{path}{name}: got a dict; takes a {type(inner).__name__}, or fields by name: **{names}")
        else:
            check_value(path + name, value, field_kinds(type(config))[name])
        config = replace(config, **{head: value})  # type: ignore[type-var]
    return config


def from_plain(config: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns fields of a config as it has them, of texts, numbers, lists and dicts as JSON has them.

    Args:
        config: class of the config.
        values: fields by name.
    """
    found = {}
    for name, value in values.items():
        if inner := inner_config(config, name):
            value = inner(**from_plain(inner, value)) if isinstance(value, Mapping) else value
        found[name] = with_tuples(value)
    return found


def recorded_fields(config: Any, game: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the fields of a game that a file has, as its config takes them; see `recorded_plain`."""
    return from_plain(type(config), recorded_plain(config, game))


def recorded_plain(config: Any, game: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the fields of a game that a file has, as JSON has them.

    A field that had its default has the value of then, where its default is another one today.

    Args:
        config: the game's config with the defaults of today.
        game: as `core.identity.about_game` returns it.
    """
    today = plain(unchanged(config))
    defaults = game.get("defaults", {})
    then = {name: value for name, value in defaults.items() if today.get(name, value) != value}
    then |= {name: value for name, value in defaults.items() if value is None and _is_config(config, name)}
    whole = {**then, **game["config"]}
    # Fields of a config that is None today: all that is known of it makes it again.
    for group in dict.fromkeys(name.partition(".")[0] for name in (*defaults, *game["config"]) if "." in name):
        if getattr(config, group, config) is None and inner_config(type(config), group):
            known = {**defaults, **game["config"]}
            inner = {name.partition(".")[2]: x for name, x in known.items() if name.startswith(f"{group}.")}
            whole = {name: x for name, x in whole.items() if not name.startswith(f"{group}.")} | {group: inner}
    return whole


def _is_config(config: Any, name: str) -> bool:
    return is_dataclass(getattr(config, name, None))


def inner_config(config: type, name: str) -> type | None:
    """Returns the class of a config's field that is itself a config, or may be one; None for other fields."""
    hint = field_kinds(config).get(name)
    kinds = [kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and is_dataclass(kind)]
    return kinds[0] if kinds else None


def with_tuples(value: Any) -> Any:
    """Returns lists, as JSON has them, as tuples."""
    return tuple(with_tuples(x) for x in value) if isinstance(value, list) else value


def field_names(config: Any) -> list[str]:
    """Returns the names of a config's fields, and the dotted names of fields inside them."""
    names = []
    for f in fields(config):
        inner = getattr(config, f.name)
        names.append(f.name)
        names += [f"{f.name}.{name}" for name in inner] if isinstance(inner, Mapping) else []
        if is_dataclass(inner) and not isinstance(inner, type):
            names += [f"{f.name}.{name}" for name in field_names(inner)]
    return names
