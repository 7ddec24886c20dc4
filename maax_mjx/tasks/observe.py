"""Observation modes of the games."""

from __future__ import annotations

from maax_mjx.common.checks import check_choice
from maax_mjx.core.env import Environment
from maax_mjx.wrappers import CriticObservations, EgocentricObservations, FlattenObservations, SplitObservations

OBSERVATIONS = ("raw", "split", "flat", "ego")
OBSERVE = ("self", "team", "all")


def observed_by_agents(env: Environment, observations: str, observe: str = "self") -> Environment:
    """Gives every agent its own observations, like those of Baker et al.'s policies.

    Args:
        env: the game.
        observations: "raw" keeps the game's; "split" gives arrays whose first axis is the agents', see
            `SplitObservations`; "flat" joins these to one vector, with zeros in place of what an agent does not see;
            "ego" is "split" in every agent's own frame and in fixed scales, see `EgocentricObservations`.
        observe: what a critic sees: "self" the same as the policy, "team" also what any agent of the team sees, "all"
            everything; see `CriticObservations`.

    Raises:
        ValueError: an unknown name, or a critic of raw observations.
    """
    check_choice("observations", observations, OBSERVATIONS)
    if check_choice("observe", observe, OBSERVE) != "self" and observations == "raw":
        raise ValueError(f"observe: got {observe!r} with observations='raw'; takes 'self' there")
    if observations == "raw":
        return env
    env = SplitObservations(env)
    if observe != "self":
        env = CriticObservations(env, observe)
    if observations == "flat":
        return FlattenObservations(env)
    return EgocentricObservations(env) if observations == "ego" else env
