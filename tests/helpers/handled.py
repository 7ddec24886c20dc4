"""Locks and holds of all kinds of objects together, from the observations by kind."""

from __future__ import annotations

import numpy as np

COLUMNS = {"lock": ("you_lock", "team_lock", "obj_lock"), "pull": ("you_pull", "obj_pull")}


def handled(obs, kinds=("box", "ramp")):
    """By column: of agents (..., n_agents, n_objects, 1), and what holds for anybody (..., n_objects, 1)."""
    found = {}
    for what, columns in COLUMNS.items():
        parts = [np.asarray(obs[f"{kind}_{what}"]) for kind in kinds if f"{kind}_{what}" in obs]
        if parts:
            whole = np.concatenate(parts, axis=-2)
            for i, name in enumerate(columns):
                of_agents = whole[..., i : i + 1]
                if name.startswith("obj"):
                    # The same for every agent.
                    np.testing.assert_array_equal(of_agents, np.broadcast_to(of_agents[..., :1, :, :], of_agents.shape))
                    of_agents = of_agents[..., 0, :, :]
                found[name] = of_agents
    return found
