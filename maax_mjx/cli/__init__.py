"""The command line, `maax-mjx`, with a file for each command."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import tyro

from maax_mjx.cli.bench import BENCHMARKS, bench
from maax_mjx.cli.evaluate import Evaluate, evaluate
from maax_mjx.cli.info import Info, check_named, info
from maax_mjx.cli.interrupt import EXIT_CODE, Interrupt
from maax_mjx.cli.options import MISTAKES, check_words, names, split_overrides
from maax_mjx.cli.play import Play, run_play
from maax_mjx.cli.replay import Replay, replay
from maax_mjx.cli.rollout import Rollout, rollout
from maax_mjx.cli.train import Train, train
from maax_mjx.cli.worlds import Sheet, sheet
from maax_mjx.common.checks import check_choice
from maax_mjx.common.options import NUMBERS, parsed
from maax_mjx.common.runtime import is_out_of_memory
from maax_mjx.common.version import VERSION
from maax_mjx.tasks import check_game
from maax_mjx.training.config import GROUPS
from maax_mjx.training.folder import is_run

DESCRIPTION = """maax_mjx: procedurally generated multi-agent worlds on MuJoCo MJX.

Exit codes: 0 done; 2 a mistake in the arguments, or no memory or disk left, said on stderr; 130 interrupted, after
finished work was written.
Tab completion: maax-mjx --tyro-print-completion bash (or zsh, fish) prints what your shell is to source."""


SHELLS = ("bash", "fish", "zsh")
"""Shells that completions can be printed for."""


@dataclass
class Bench:
    """Runs a benchmark: maax-mjx bench lists them, maax-mjx bench NAME --help shows the options."""

    name: tyro.conf.Positional[names(BENCHMARKS)]  # type: ignore[valid-type]
    """Name of the benchmark."""


COMMANDS: dict[str, Callable[..., Any]] = {
    "rollout": Rollout,
    "train": Train,
    "evaluate": Evaluate,
    "worlds": Sheet,
    "replay": Replay,
    "play": Play,
    "info": Info,
    "bench": Bench,
}


def main(argv: list[str] | None = None) -> None:
    """The entry point: parses the command line and runs the command.

    Args:
        argv: the arguments; None uses those of the process.

    Raises:
        SystemExit: 2 for a user's mistake, 130 after Ctrl-C.
    """
    argv = sys.argv[1:] if argv is None else argv
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A terminal without ± shows ? for it, instead of a traceback after all matches were played.
        sys.stdout.reconfigure(errors="replace")
    try:
        check_words(argv)
        if argv[:1] == ["--tyro-print-completion"]:
            check_choice("tyro-print-completion", argv[1] if len(argv) > 1 else "nothing", SHELLS)
        if argv == ["--version"]:
            print(f"maax-mjx {VERSION}")
        elif argv[:1] == ["bench"]:
            bench(argv[1:])
        else:
            run(argv)
    except BrokenPipeError:
        # Whoever read what is printed, such as `head`, has enough. Python would complain once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except MISTAKES as error:
        print(f"maax-mjx: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except jax.errors.JaxRuntimeError as error:
        if not is_out_of_memory(error):
            raise
        print(
            f"maax-mjx: the memory does not suffice ({str(error).splitlines()[0]}); takes fewer worlds", file=sys.stderr
        )
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("maax-mjx: interrupted", file=sys.stderr)
        raise SystemExit(EXIT_CODE) from None


def run(argv: list[str]) -> None:
    """Runs any command but `bench`, whose options belong to the benchmarks."""
    command = "maax-mjx"
    if argv and not argv[0].startswith("-"):
        check_choice("command", argv[0], COMMANDS)
        command = f"maax-mjx {argv[0]}"
    argv, overrides = split_overrides(argv)
    settings: dict[str, str] = {}
    for group in GROUPS if argv[:1] == ["train"] else ():
        argv, found = split_overrides(argv, f"--{group}.")
        settings |= {f"{group}.{name}": text for name, text in found.items()}
    named = argv[:1] in (["rollout"], ["info"], ["worlds"], ["play"]) and len(argv) > 1 and not argv[1].startswith("-")
    if named and argv[0] == "info":
        check_named(argv[1])
    elif named:
        if argv[0] == "rollout" and is_run(argv[1]):
            raise ValueError(
                f"env: got {argv[1]}, the folder of a run; takes a game: maax-mjx rollout GAME --policy {argv[1]}"
            )
        check_game("env", argv[1])
    args = parsed(
        lambda: tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            args=argv,
            prog="maax-mjx",
            description=DESCRIPTION,
            config=(tyro.conf.OmitArgPrefixes,),
            registry=NUMBERS,
        ),
        command,
    )
    if isinstance(args, Rollout):
        rollout(args, overrides)
    elif isinstance(args, Train):
        train(replace(args, settings=settings), overrides)
    elif isinstance(args, Evaluate):
        evaluate(args, overrides)
    elif isinstance(args, Play):
        run_play(args, overrides)
    elif isinstance(args, Info) and (args.env or not overrides):
        info(args, overrides)
    elif isinstance(args, Sheet) and (args.env or not overrides):
        with Interrupt():
            sheet(args, overrides)
    elif overrides:
        field = f"--env.{next(iter(overrides))}"
        raise ValueError(
            f"{field}: only rollout, train, evaluate, play, and info and worlds of an environment take fields of its "
            "config"
        )
    elif isinstance(args, Replay):
        replay(args)
