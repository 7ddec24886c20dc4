"""The published games as their code has them, where ours differ by default."""

from __future__ import annotations

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
    "lock": {"method": "joint_range", "soft": True},
    "grab": {"soft": True},
    "world_params": {"iterations": ITERATIONS},
}
"""Fields of a config, and of configs in it, and what they are in the published code."""
PLACEMENTS = {name: f"published_{name}" for name in ("uniform", "quad", "outside_quad", "team")}


def as_published(config: C) -> C:
    """Returns a config of a published game with everything that has a published form in that form.

    Args:
        config: the config; parts of it that are None stay so, and so do placements that the published code does not
            have.
    """
    parts = {
        name: replace(getattr(config, name), **changed) for name, changed in PARTS.items() if getattr(config, name)
    }
    placements = {}
    for f in fields(config):
        value = getattr(config, f.name)
        if f.name.endswith("_placement") and isinstance(value, str):
            placements[f.name] = PLACEMENTS.get(value, value)
    return replace(config, **WORLD, **parts, **placements)
