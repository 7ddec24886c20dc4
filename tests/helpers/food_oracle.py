"""Food of hide and seek in plain Python, written from a description of the published code, not from the package's."""

from __future__ import annotations

from fractions import Fraction

import numpy as np


class Table:
    """What is left of the food of one world.

    Args:
        there: (n_food,) bool, the pieces of this world.
        max_health: units of a piece at first.
        respawn_steps: for how many steps an empty piece is away; None for ever.
        split: whether those who eat of a piece share a unit.
    """

    def __init__(self, there, max_health, respawn_steps=None, split=False):
        self.there = [bool(x) for x in there]
        self.max_health, self.respawn_steps, self.split = max_health, respawn_steps, split
        self.health = [max_health if x else 0 for x in self.there]
        self.counters = [0] * len(self.there)

    def step(self, bites):
        """What everyone ate, rows of Fractions, of the (n_agents, n_food) bites: what is asked for and near."""
        eaten = [[Fraction(0)] * len(self.there) for _ in bites]
        for piece, left in enumerate(self.health):
            eaters = [agent for agent, row in enumerate(bites) if row[piece]]
            if not self.there[piece] or left == 0 or not eaters:
                continue
            asked = 1 if self.split else len(eaters)
            taken = min(asked, left)
            for agent in eaters:
                eaten[agent][piece] = Fraction(taken, len(eaters))
            self.health[piece] = left - taken
        for piece, there in enumerate(self.there):
            if there and self.counters[piece] == self.respawn_steps:
                self.health[piece] = self.max_health
        self.counters = [
            counter + 1 if health == 0 else 0 for counter, health in zip(self.counters, self.health, strict=True)
        ]
        return eaten


HALF = 0.15
"""Metres, half of an agent's extents."""


def distances(agents, food, between="centres"):
    """(..., n_agents, n_food) metres from agents to the middles of pieces (..., n_food, 3).

    Agents' centres are (..., n_agents, 3); "corners" are their lower ones, which `agent_pos` of the published code is.
    """
    agents = np.float64(agents) - (HALF if between == "corners" else 0.0)
    return np.sqrt(((np.float64(agents)[..., :, None, :] - np.float64(food)[..., None, :, :]) ** 2).sum(axis=-1))


def rewards(eaten, rew_type, team_index, playing):
    """What everyone gets for what they ate, at a reward of 1 for a unit; absent agents get nothing."""
    own = [sum(row, Fraction(0)) for row in eaten]
    if rew_type == "selfish":
        return [float(x) if here else 0.0 for x, here in zip(own, playing, strict=True)]
    got = []
    for agent, here in enumerate(playing):
        team = [x for x, i, plays in zip(own, team_index, playing, strict=True) if plays and i == team_index[agent]]
        got.append(float(sum(team) / len(team)) if here else 0.0)
    return got
