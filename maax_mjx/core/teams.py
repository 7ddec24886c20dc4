"""Teams: their names, their slots and their agents' names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from maax_mjx.common.colours import Colour
from maax_mjx.core.named import Named


@dataclass(frozen=True)
class Team:
    """A team of agents that play together.

    Attributes:
        name: the team's name, such as "hiders".
        slots: its agents' slots, in order.
        agents: its agents' names, such as ("hider_0", "hider_1").
        colour: its colour in pictures.
    """

    name: str
    slots: tuple[int, ...]
    agents: tuple[str, ...]
    colour: Colour

    @property
    def n_agents(self) -> int:
        """Number of the team's slots."""
        return len(self.slots)


def make_teams(names: Sequence[str], team_index: np.ndarray, colours: Sequence[Colour]) -> dict[str, Team]:
    """Makes the teams, by name.

    Args:
        names: the teams' names.
        team_index: (n_agents,) team of every slot.
        colours: RGBA of every slot; a team gets that of its first agent.

    Raises:
        ValueError: a name that is no text or is there twice, a team without agents, or two teams whose agents would
            have the same names, such as "red" and "reds".
    """
    teams: Named[Team] = Named("teams")
    members: dict[str, str] = {}
    for i, name in enumerate(names):
        if not isinstance(name, str) or not name:
            raise ValueError(f"teams: got the name {name!r}; takes a text")
        if name in teams:
            raise ValueError(f"teams: got {name!r} twice in {list(names)}; takes different names")
        slots = tuple(int(slot) for slot in np.flatnonzero(team_index == i))
        if not slots:
            raise ValueError(f"teams: got {name!r} without agents; takes teams of at least one agent")
        other = members.setdefault(member_of(name), name)
        if other != name:
            raise ValueError(f"teams: got {other!r} and {name!r}, whose agents have the same names; takes others")
        agents = tuple(f"{member_of(name)}_{k}" for k in range(len(slots)))
        teams[name] = Team(name, slots, agents, tuple(float(x) for x in colours[slots[0]]))  # type: ignore[arg-type]
    return teams


def member_of(team: str) -> str:
    """Returns the word for one member of a team: "hider" for "hiders", "red" for "red"."""
    return team[:-1] if len(team) > 1 and team.endswith("s") and not team.endswith("ss") else team


def agent_names(teams: Mapping[str, Team]) -> tuple[str, ...]:
    """Returns the names of all agents, by slot."""
    named = {slot: name for team in teams.values() for slot, name in zip(team.slots, team.agents, strict=True)}
    return tuple(named[slot] for slot in sorted(named))
