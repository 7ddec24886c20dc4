"""The published games as their code has them, where ours differ by default."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from typing import Any, TypeVar

from maax_mjx.tasks.config import Config

C = TypeVar("C", bound=Config)

ITERATIONS = 100
"""Iterations of the solver, MuJoCo's default."""
TRIES = 10
"""Places that are tried for an object."""
WORLD: dict[str, Any] = {
    "arms": True,
    "inertial_reach": True,
    "in_doorways": True,
    "may_leave": True,
    "placement_tries": TRIES,
    "cone_between": "corners",
}
PARTS: dict[str, dict[str, Any]] = {
    "lidar": {"capped": False},
    "food": {"between": "corners"},
    "lock": {"method": "joint_range", "soft": True},
    "grab": {"soft": True},
    "world_params": {"iterations": ITERATIONS},
}
"""Fields of a config, and of configs in it, and what they are in the published code."""
PLACEMENTS = ("uniform", "quad", "outside_quad", "team", "rooms_in_turn", "room[0-9]+")
"""Patterns of the names of placements that the published code has, in ranges of its own."""


def as_published(config: C) -> C:
    """Returns a config with `published=True` spelled out: what has a published form is in it. Others stay as they are.

    Args:
        config: of a game. Fields that are set otherwise than by default stay, and so do parts that are None and
            placements that the published code does not have.
    """
    if not getattr(config, "published", False):
        return config
    default = type(config)()
    parts = {
        name: _where_default(part, getattr(default, name) or type(part)(), changed)
        for name, changed in PARTS.items()
        if (part := getattr(config, name, None))
    }
    placements = {}
    for f in fields(config):
        value = getattr(config, f.name)
        if f.name.endswith("_placement"):
            placements[f.name] = _published_name(value)
    return replace(_where_default(config, default, WORLD), **parts, **placements)


def _published_name(placement: Any) -> Any:
    """Returns what a placement is called as published, or several; others, and functions, are returned as they are."""
    if isinstance(placement, tuple | list):
        return type(placement)(map(_published_name, placement))
    known = isinstance(placement, str) and re.fullmatch("|".join(PLACEMENTS), placement)
    return f"published_{placement}" if known else placement


def _where_default(config: C, default: C, changed: dict[str, Any]) -> C:
    """Returns a config with those fields changed that are as by default."""
    return replace(config, **{k: x for k, x in changed.items() if getattr(config, k) == getattr(default, k)})
