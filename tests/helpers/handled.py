"""Locks and holds of all kinds of objects together, from the observations by kind."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

COLUMNS = {"lock": ("you_lock", "team_lock", "obj_lock"), "pull": ("you_pull", "obj_pull")}


def handled(obs, kinds=("box", "ramp")):
    """By column: of agents (..., n_agents, n_objects, 1), and what holds for anybody (..., n_objects, 1)."""
    found = {}
    traced = any(isinstance(x, jax.core.Tracer) for x in obs.values())
    xp = jnp if traced else np  # outside of compiled code nothing is compiled
    for what, columns in COLUMNS.items():
        parts = [xp.asarray(obs[f"{kind}_{what}"]) for kind in kinds if f"{kind}_{what}" in obs]
        if parts:
            whole = xp.concatenate(parts, axis=-2)
            for i, name in enumerate(columns):
                of_agents = whole[..., i : i + 1]
                # The same for every agent: the least of all, so that one that differs is found.
                found[name] = of_agents.min(axis=-3) if name.startswith("obj") else of_agents
    return found
