"""`maax-mjx bench`: the benchmarks by name."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from maax_mjx.benchmarks import BENCHMARKS
from maax_mjx.benchmarks.bench import Command
from maax_mjx.cli.interrupt import Interrupt
from maax_mjx.common.checks import check_choice


def bench(args: list[str]) -> None:
    """Runs a module of `maax_mjx.benchmarks` with its own options, or lists them."""
    if not args or args[0] in ("-h", "--help"):
        print("usage: maax-mjx bench NAME [OPTIONS]; maax-mjx bench NAME --help lists them.\n\nNAME:")
        width = max(map(len, BENCHMARKS))
        for name in BENCHMARKS:
            print(f"  {name:{width}} {_command(name).description.splitlines()[0]}")
        return
    name = check_choice("bench", args[0], BENCHMARKS)
    command = _command(name)
    options = command.parse(args[1:], prog=f"maax-mjx bench {name}")
    with Interrupt():
        command.main(options)


def _command(name: str) -> Command[Any]:
    """The benchmark's program; benchmarks are imported only when they are used."""
    return import_module(f"maax_mjx.benchmarks.{name}").COMMAND
