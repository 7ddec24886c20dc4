"""Wrappers in an order that would not do what they say, and arguments that they cannot mean, are refused."""

from __future__ import annotations

import pytest

import maax_mjx as maax

PREP, RECT = maax.PreparationPhase, (1, 1, 5, 5)


@pytest.fixture(scope="module")
def teams():
    """Made anew for every case: locks are built into the model."""
    return lambda: maax.AgentAgentContactMask2D(maax.TeamMembership(maax.make("standard", impl="c")))


REFUSED = {
    "tag in the phase": (lambda e: maax.Tag(PREP(e)), "Tag: env has PreparationPhase already; wrap with Tag before it"),
    "reward outside the rectangle": (
        lambda e: maax.HideAndSeekReward(maax.RestrictAgentsRect(e, RECT)),
        "env has RestrictAgentsRect already; wrap with HideAndSeekReward before it",
    ),
    "locks outside the statistics": (
        lambda e: maax.LockObjects(maax.TrackStats(e)),
        "LockObjects: env has TrackStats already; wrap with LockObjects before it",
    ),
    "phase outside the statistics": (
        lambda e: PREP(maax.TrackStats(e)),
        "PreparationPhase: env has TrackStats already",
    ),
    "sight outside of split observations": (
        lambda e: maax.LineOfSight(maax.SplitObservations(e)),
        "LineOfSight: env has SplitObservations already; wrap with LineOfSight before it: SplitObservations(",
    ),
    "locks around a flat game": (
        lambda e: maax.LockObjects(maax.FlattenObservations(maax.SplitObservations(e))),
        'maax.make("...", inside={"SplitObservations": maax.LockObjects})',
    ),
    "ego around flat observations": (
        lambda e: maax.EgocentricObservations(maax.FlattenObservations(maax.SplitObservations(e))),
        "EgocentricObservations: env has FlattenObservations already; wrap with EgocentricObservations before it",
    ),
    "a critic around flat observations": (
        lambda e: maax.CriticObservations(maax.FlattenObservations(maax.SplitObservations(e))),
        "CriticObservations: env has FlattenObservations already; wrap with CriticObservations before it",
    ),
    "agents as objects": (
        lambda e: maax.GrabObjects(e, ["agent"]),
        "objects: got 'agent'; takes one of ['box', 'ramp']",
    ),
    "objects twice": (lambda e: maax.LockObjects(e, ["box", "box"]), "takes a list of different names"),
    "a bare name": (lambda e: maax.LineOfSight(e, objects="box"), "objects: got 'box'; takes a list of different"),
    "a rectangle beside the floor": (
        lambda e: maax.RestrictAgentsRect(e, (100, 100, 200, 200)),
        "takes one that overlaps the floor, 0 to 6 metres",
    ),
    "a word for a truth": (
        lambda e: maax.RestrictAgentsRect(e, RECT, penalize_objects_out="no"),
        "penalize_objects_out: got 'no'; takes True or False",
    ),
}


@pytest.mark.parametrize(("wrap", "message"), REFUSED.values(), ids=REFUSED)
def test_refused(wrap, message, teams):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        wrap(teams())
    assert message in str(error.value)


def test_the_right_order(teams):
    env = maax.RestrictAgentsRect(maax.HideAndSeekReward(maax.LockObjects(teams())), RECT)
    assert maax.TrackStats(PREP(env)).action_space["lock"].shape == (4, 2)
