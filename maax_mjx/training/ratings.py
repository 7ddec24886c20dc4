"""Ratings: how much better one player is than another, in Elo's points, from who won how often."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from maax_mjx.common.annotated import is_number
from maax_mjx.common.checks import described

POINTS = 400 / np.log(10)
"""Elo's points per unit of log-odds: 400 points are ten wins for each loss."""
SPREAD = 800.0
"""Standard deviation, in points, of what ratings are thought to be before anything is played. Without it a player who
never wins would be rated minus infinity."""
LIKELY = 1.96
"""Standard errors on either side of a mean that hold it in 95 of 100 cases."""


class Result(NamedTuple):
    """What a player won against another.

    Attributes:
        player, opponent: their names.
        team: the player's team; the opponent plays the others.
        won: share of the episodes that the player won, draws as half, in [0, 1].
        episodes: number of episodes.
    """

    player: str
    opponent: str
    team: str
    won: float
    episodes: int


class Rating(NamedTuple):
    """A player's rating.

    Attributes:
        points: Elo's points above the player at 0.
        margin: half of the width of the 95 % interval.
    """

    points: float
    margin: float

    def __str__(self) -> str:
        return f"{round(self.points):+d} ± {self.margin:.0f}"


def rate(results: Sequence[Result], zero: str) -> dict[str, Rating]:
    """Rates players by the likeliest log-odds of winning: the difference of their ratings and that of their teams.

    Teams have ratings of their own, since a game can be easier for hiders than for seekers (Bradley and Terry 1952), if
    there are results of more than one.
    Draws count as half a win, which makes intervals wider than they need to be.

    Args:
        results: of any pairs of players; one against itself tells of the teams.
        zero: the player whose rating is 0.

    Returns:
        Ratings of all players, the best first.

    Raises:
        ValueError: what is no result, a share outside [0, 1], no episodes, or a player at 0 who did not play.
    """
    for result in results:
        if not isinstance(result, Result):
            raise ValueError(
                f"results: got {described(result)} in it; takes training.Result(player, opponent, team, ...)"
            )
        # Scalars of JAX are numbers as well.
        numbers = all(is_number(np.asarray(x)[()]) for x in (result.won, result.episodes))
        if not numbers or not 0 <= result.won <= 1 or not 0 < result.episodes < np.inf:
            raise ValueError(f"results: got {result}; takes won in [0, 1], and episodes from 1 on")
    players = sorted({name for result in results for name in (result.player, result.opponent)})
    if zero not in players:
        raise ValueError(f"zero: got {zero!r}; takes one of {players}")
    others, teams = [name for name in players if name != zero], sorted({result.team for result in results})
    # What a team is worth shows only beside another; of one alone it would take half of what its players won.
    teams = teams if len(teams) > 1 else []
    column = {name: i for i, name in enumerate(others)}
    which = np.zeros((len(results), len(others) + len(teams)))
    for row, result in zip(which, results, strict=True):
        for name, sign in ((result.player, 1.0), (result.opponent, -1.0)):
            if name in column:
                row[column[name]] += sign
        # The opponent plays the other teams: what is easier for one side is harder for the other.
        if teams:
            row[len(others) :] = -1.0 / (len(teams) - 1)
            row[len(others) + teams.index(result.team)] = 1.0
    won = np.array([result.won for result in results])
    n = np.array([result.episodes for result in results], float)
    precision = (POINTS / SPREAD) ** 2

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        odds = which @ x
        likely = n * (won * log_expit(odds) + (1 - won) * log_expit(-odds))
        return -likely.sum() + precision * x @ x / 2, which.T @ (n * (expit(odds) - won)) + precision * x

    found = minimize(cost, np.zeros(which.shape[1]), jac=True, method="L-BFGS-B", options={"gtol": 1e-9}).x
    chance = expit(which @ found)
    bend = (which * (n * chance * (1 - chance))[:, None]).T @ which + precision * np.eye(len(found))
    errors = np.sqrt(np.diag(np.linalg.inv(bend)))
    rated = {name: Rating(float(POINTS * found[i]), float(LIKELY * POINTS * errors[i])) for name, i in column.items()}
    rated[zero] = Rating(0.0, 0.0)
    return dict(sorted(rated.items(), key=lambda item: -item[1].points))
