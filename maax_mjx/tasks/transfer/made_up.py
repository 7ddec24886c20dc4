"""What the published transfer tasks make up, so that policies of hide-and-seek find all that they read."""

from __future__ import annotations

import numpy as np

from maax_mjx.common.observed import AGENT, POSITION, SPIN, TURN, VELOCITY, YAW, Observed, flag
from maax_mjx.core.env import Environment
from maax_mjx.wrappers import AddConstantObservations, SelectObservations
from maax_mjx.wrappers.locks.wrapper import COLUMNS as LOCKS
from maax_mjx.wrappers.split import OTHER

POSE = (*POSITION, *TURN, *VELOCITY, *SPIN)
N_RAMPS = 1


def with_made_up(env: Environment, n_others: int, *, hider: bool) -> Environment:
    """Adds the agents, the ramp and the constants that the published tasks make up.

    Other agents are all zeros, and the first of them counts as seen, as in the published code, which keeps an agent's
    own entry in the mask. A ramp, where the world has none, is all zeros, and not seen. `hider` says which side the
    agent is told to be on; `prep_obs` is 0, the beginning of the preparation.

    Args:
        env: a task of one agent, with split observations.
        n_others: number of agents.
        hider: whether the agent is told that it is a hider.
    """
    # Of the others there are, none, only empty arrays are observed.
    env = SelectObservations(env, [name for name, one in env.observed.items() if OTHER not in one.axes])
    others = (AGENT, OTHER)
    constants = {
        "agent_qpos_qvel": (Observed(others, (*POSITION, *YAW, *VELOCITY, *SPIN)), np.zeros((1, n_others, 8))),
        # Nobody is a hider.
        "agent_team": (Observed(others, flag("team")), np.ones((1, n_others, 1), np.float32)),
        "agent_mask": (Observed(others), np.zeros((1, n_others), bool)),
        "sees_agent": (Observed(others), np.arange(n_others)[None] == 0),
        "hider": (Observed((AGENT,), flag("hider")), np.full((1, 1), float(hider))),
        "prep_obs": (Observed((AGENT,), flag("preparation")), np.zeros((1, 1))),
    }
    if "ramp_obs" not in env.observed:
        ramps = (AGENT, "ramp")
        constants |= {
            "ramp_obs": (Observed(ramps, (*POSE, *LOCKS)), np.zeros((1, N_RAMPS, len(POSE) + len(LOCKS)))),
            "ramp_mask": (Observed(ramps), np.zeros((1, N_RAMPS), bool)),
            "sees_ramp": (Observed(ramps), np.zeros((1, N_RAMPS), bool)),
        }
    return AddConstantObservations(env, constants)
