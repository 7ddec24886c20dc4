"""Ratings against results whose odds are known."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import seeds
from scipy.special import expit

from maax_mjx.training.evaluate import _share, estimate
from maax_mjx.training.ratings import POINTS, Rating, Result, rate

TRUTH = {"self": 0.0, "weak": -350.0, "strong": 150.0, "equal": 0.0}
SIDES = {"hiders": 120.0, "seekers": -120.0}


def played(rng, episodes):
    """Results of every player against every other, as each team."""
    results = []
    for a in TRUTH:
        for b in TRUTH:
            for team, side in SIDES.items():
                chance = expit((TRUTH[a] - TRUTH[b] + 2 * side) / POINTS)
                results.append(Result(a, b, team, rng.binomial(episodes, chance) / episodes, episodes))
    return results


def test_known_strengths_are_found_within_their_intervals():
    """Of 60 tables of results with four ratings each, 95 % of the intervals hold the truth."""
    rng = seeds.rng(0)
    held, off = [], []
    for _ in range(60):
        found = rate(played(rng, 200), "self")
        assert found["self"] == (0.0, 0.0)
        for name in ("weak", "strong", "equal"):
            held.append(abs(found[name].points - TRUTH[name]) < found[name].margin)
            off.append(found[name].points - TRUTH[name])
    # 180 intervals, those of one table not quite independent: 0.88 is four standard errors below 0.95.
    assert 0.88 < np.mean(held) < 1.0
    assert abs(np.mean(off)) < 12


def test_the_best_is_first_and_ten_wins_a_loss_are_400_points():
    even = [Result("self", "other", team, 10 / 11, 100_000) for team in SIDES]
    found = rate(even, "self")
    assert list(found) == ["self", "other"]
    assert found["other"].points == pytest.approx(-400, abs=2)


def test_one_team_alone_takes_nothing_of_what_its_players_won():
    found = rate([Result("self", "other", "hiders", 10 / 11, 100_000)], "other")
    assert found["self"].points == pytest.approx(400, abs=2)
    assert found["self"].margin < 10


def test_who_never_wins_has_a_rating():
    found = rate([Result("self", "other", team, 1.0, 1000) for team in SIDES], "self")
    assert -6000 < found["other"].points < -800
    assert found["other"].margin > 100
    with pytest.raises(ValueError, match=r"zero: got 'me'; takes one of \['other', 'self'\]"):
        rate([Result("self", "other", "hiders", 0.5, 10)], "me")
    with pytest.raises(ValueError, match=r"results: got tuple in it; takes training\.Result"):
        rate([("self", "other", "hiders", 0.5, 10)], "self")
    for won, episodes in ((1.7, 100), (float("nan"), 100), (0.5, 0), (0.5, -3), ("x", 9), (0.5, True), (None, 9)):
        with pytest.raises(ValueError, match=r"results: got Result\(.*\); takes won in \[0, 1\], and episodes from 1"):
            rate([Result("self", "other", "hiders", won, episodes)], "self")


def test_numbers_are_as_people_write_them():
    """No minus before a zero, and an interval although everybody won."""
    assert str(Rating(-0.3, 5.0)) == "+0 ± 5"
    assert _share(np.ones(60)).margin == pytest.approx(0.05)
    assert _share(np.array([0.0, 1.0, 1.0])).margin == estimate(np.array([0.0, 1.0, 1.0])).margin
