"""`maax-mjx bench`: the benchmarks by name."""

from __future__ import annotations

from importlib import import_module

import tyro

from maax_mjx.checks import check_choice

BENCHMARKS = (
    "breakdown", "devices", "engines", "fidelity", "gradients", "grabs", "hostile", "layouts", "load", "memory",
    "objects", "outer", "plots", "profile", "sampling", "scaling", "scenes", "soak", "step",
)  # fmt: skip


def bench(args: list[str]) -> None:
    """Runs a module of `maax_mjx.benchmarks` with its own options, or lists them."""
    listed = "\n  ".join(BENCHMARKS)
    if not args or args[0] in ("-h", "--help"):
        print(f"usage: maax-mjx bench NAME [OPTIONS]; maax-mjx bench NAME --help lists them.\n\nNAME:\n  {listed}")
        return
    name = check_choice("bench", args[0], BENCHMARKS)
    module = import_module(f"maax_mjx.benchmarks.{name}")
    module.main(tyro.cli(module.Config, args=args[1:], prog=f"maax-mjx bench {name}", description=module.__doc__))
