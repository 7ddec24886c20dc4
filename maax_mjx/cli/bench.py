"""`maax-mjx bench`: the benchmarks by name."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import tyro

from maax_mjx import benchmarks
from maax_mjx.cli.interrupt import Interrupt
from maax_mjx.common.checks import check_choice


def _about() -> dict[str, str]:
    """What every benchmark is about, by name: the modules that have a `main`, without importing them."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in sorted(Path(benchmarks.__path__[0]).glob("*.py"))}
    return {name: text.split('"""')[1].split(": `")[0] for name, text in texts.items() if "\ndef main(" in text}


BENCHMARKS = _about()


def bench(args: list[str]) -> None:
    """Runs a module of `maax_mjx.benchmarks` with its own options, or lists them."""
    if not args or args[0] in ("-h", "--help"):
        listed = "\n".join(f"  {name:10} {about}." for name, about in BENCHMARKS.items())
        print(f"usage: maax-mjx bench NAME [OPTIONS]; maax-mjx bench NAME --help lists them.\n\nNAME:\n{listed}")
        return
    name = check_choice("bench", args[0], BENCHMARKS)
    module = import_module(f"maax_mjx.benchmarks.{name}")
    config = tyro.cli(module.Config, args=args[1:], prog=f"maax-mjx bench {name}", description=module.__doc__)
    with Interrupt():
        module.main(config)
