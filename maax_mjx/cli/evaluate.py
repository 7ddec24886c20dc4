"""`maax-mjx evaluate`: a policy against scripted agents, other policies and its own past."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import tyro

from maax_mjx import training
from maax_mjx.cli.interrupt import Interrupt
from maax_mjx.cli.options import Seed, names, on_engine, values_of
from maax_mjx.common.annotated import Bounds, check_fields
from maax_mjx.physics import impls


@dataclass
class Evaluate:
    """Plays a policy as each team against each opponent, and prints returns and shares won with 95 % intervals.

    Fields of the game's config are changed as in --env.n_boxes 3. Opponents may be scripts: random, still, chase,
    close_door, tag, capture_the_flag, lock_and_return, sequential_lock, blueprint, shelter.
    """

    policy: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="POLICY")]]
    """A policy: its file, the folder of a run, or the name of one that comes with the package, quadrant/forts."""
    against: tuple[str, ...] = ("random",)
    """Opponents: self, files, names such as quadrant/chase, folders, a run's past as in runs/x@50M, or scripts."""
    episodes: Annotated[int, Bounds(2)] = 1024
    """Episodes of every match, each in a world of its own."""
    seed: Seed = 0
    """Seed of the worlds and the actions."""
    impl: names(impls()) = "auto"  # type: ignore[valid-type]
    """Physics engine."""
    json: bool = False
    """Whether to print the result as JSON."""


def evaluate(args: Evaluate, overrides: Mapping[str, str]) -> None:
    """Runs the command.

    Args:
        args: the options.
        overrides: values of the game's config fields, as texts.

    Raises:
        ValueError: two engines, or what `training.evaluate` refuses.
    """
    check_fields(args)
    policy = training.player_of("policy", args.policy)
    if not isinstance(policy, training.TrainedPolicy):
        raise ValueError(
            f"policy: got the scripted {args.policy!r}; takes a file, the folder of a run, or a name such as "
            "quadrant/forts"
        )
    with Interrupt():
        fields = values_of(policy.game["game"], overrides) if policy.game else {}
        env = policy.make_env(**on_engine(args.impl, fields))
        found = training.evaluate(policy, args.against, args.episodes, env, seed=args.seed, bar=True)
    print(json.dumps(training.as_json(found), indent=1) if args.json else found, flush=True)
