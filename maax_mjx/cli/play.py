"""`maax-mjx play`: a page in which a person steers an agent by keyboard, against policies or beside them."""

from __future__ import annotations

import logging
import sys
import webbrowser
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

import tyro

from maax_mjx.cli.interrupt import Interrupt
from maax_mjx.cli.options import Seed, as_learnt, game_names, make_env, names
from maax_mjx.common.annotated import Bounds, check_fields
from maax_mjx.common.checks import check_choice
from maax_mjx.physics import impls
from maax_mjx.training.evaluate import player_of, seated
from maax_mjx.training.trained import TrainedPolicy
from maax_mjx.viewer.live import is_open, play
from maax_mjx.viewer.nodes import HERE
from maax_mjx.viewer.panel import NOBODY


@dataclass
class Play:
    """Opens a page in which you steer an agent by keyboard, in real time; Ctrl-C ends it.

    W A S D move, Q E turn, G and L turn grabbing and locking on and off, Space pauses, N is the next world. Fields of
    the environment's config, which `maax-mjx info ENV` lists, are set as in --env.n_boxes 3. Needs the extra "viewer".
    Scripts are random, still, chase, close_door, tag, capture_the_flag, lock_and_return, sequential_lock, blueprint,
    shelter.
    """

    env: tyro.conf.Positional[game_names()] = "hide_and_seek_quadrant"  # type: ignore[valid-type]
    """Name of the environment, or a game in a file of your own, my_game.py:football."""
    policy: str = "random"
    """Who plays the other agents: a policy (file, run's folder, name), its game as it was learnt, or a script."""
    opponents: str | None = None
    """Who plays the other teams; by default the policy."""
    agent: str | None = None
    """Whom you steer, such as seeker_0, or nobody; by default the first one."""
    seed: Seed = 0
    """Seed of the worlds and of the others' actions."""
    impl: names(impls()) = "c"  # type: ignore[valid-type]
    """Physics engine; c is the quickest for one world."""
    host: str = HERE
    """Address to serve the page at; with 0.0.0.0 whoever reaches this machine can watch and steer, unasked."""
    port: Annotated[int, Bounds(0, 65535)] = 8080
    """Port to serve the page at, or the next one that is free; 0 is any free one."""
    browser: bool = True
    """Whether to open the page in a browser."""


def run_play(args: Play, overrides: Mapping[str, str]) -> None:
    """Runs the command, until it is interrupted.

    Args:
        args: the options.
        overrides: values of the environment's config fields, as texts.

    Raises:
        ValueError: an option out of its range, a policy that does not fit, or arguments that `maax.make` refuses.
        MissingLibraryError: without viser.
    """
    check_fields(args)
    policy = player_of("policy", args.policy)
    opponents = None if args.opponents is None else player_of("opponents", args.opponents)
    for player in (opponents, policy):
        if isinstance(player, TrainedPolicy):
            overrides = as_learnt(args.env, player) | dict(overrides)
    with Interrupt(), _without_handshakes():
        env = make_env(args.env, args.impl, overrides)
        if args.agent is not None:
            check_choice("agent", args.agent, [*env.agent_names, NOBODY])
        for player in (policy, *([] if opponents is None else [opponents])):
            seated(player, env)  # refuses a game that it cannot play
        print("compiling", file=sys.stderr, flush=True)
        live = play(
            env, policy, opponents, agent=args.agent, seed=args.seed, host=args.host, port=args.port
        )  # fmt: skip
        print(f"play at {live.url}   (Ctrl-C ends it)", flush=True)
        if is_open(args.host):
            print(f"whoever reaches this machine at port {live.port} can watch and steer", file=sys.stderr, flush=True)
        if args.browser:
            webbrowser.open(live.url)
        try:
            live.wait()
        finally:
            live.stop()


@contextmanager
def _without_handshakes() -> Iterator[None]:
    """Keeps tracebacks of connections that never were, such as of a browser that looks ahead, out of the terminal."""
    logger = logging.getLogger("websockets.server")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
