"""Pieces that benchmarks share: options, the command line, and the loop that measures and writes what is missing."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import tyro
from tqdm import tqdm

from maax_mjx.benchmarks import record
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import OneOf, Positive, check_fields
from maax_mjx.common.options import NUMBERS, parsed
from maax_mjx.common.progress import progress
from maax_mjx.physics import impls
from maax_mjx.tasks.registry import check_game

Impl = Annotated[str, OneOf(impls)]
"""An engine's name, of those that are registered."""


@dataclass
class Options:
    """Options of all benchmarks.

    Attributes:
        max_minutes: after so long no further row is begun; a later run with the same `out` goes on.
        out: JSON file to write; rows that it has already are not measured again. Nothing is written without one.
    """

    max_minutes: Positive | None = None
    out: Path | None = None

    def check(self) -> None:
        """Refuses what cannot be measured.

        Raises:
            ValueError: naming the option.
        """
        check_fields(self)
        games = getattr(self, "env", None) or ()
        for name in (games,) if isinstance(games, str) else games:
            check_game("env", name)
        if self.out is not None and self.out.is_dir():
            raise ValueError(f"out: got {self.out}, which is a folder; takes a JSON file")


C = TypeVar("C")
O = TypeVar("O", bound=Options)  # noqa: E741
Case = TypeVar("Case")
R = TypeVar("R", bound=Measured)


@dataclass(frozen=True)
class Command(Generic[C]):
    """A program with options.

    Attributes:
        config: dataclass of the options; the docstring of its module describes the program.
        main: the program.
    """

    config: type[C]
    main: Callable[[C], None]

    @property
    def description(self) -> str:
        """Description of what the program does."""
        return sys.modules[self.config.__module__].__doc__ or ""

    def parse(self, args: Sequence[str] | None = None, prog: str | None = None) -> C:
        """The options that a command line gives.

        Args:
            args: words of the command line; None takes those of the process.
            prog: name of the program in its help.
        """
        prog = prog or Path(sys.argv[0]).name
        return parsed(
            lambda: tyro.cli(self.config, args=args, prog=prog, description=self.description, registry=NUMBERS), prog
        )

    def cli(self) -> None:
        """Runs the program with the options of the process.

        Raises:
            SystemExit: 2 for options that there are not.
        """
        try:
            options = self.parse()
        except ValueError as error:
            print(error, file=sys.stderr)
            raise SystemExit(2) from None
        self.main(options)


def benchmark(
    config: type[O],
    row: type[R],
    cases: Callable[[O], Iterable[Case]],
    measure: Callable[[Case, O], R],
    line: Callable[[R], str],
    header: str = "",
) -> Command[O]:
    """A program that checks its options, measures the cases that its file lacks, and writes and prints each row.

    Args:
        config: its options.
        row: its rows; a row has the fields of its case.
        cases: from the options to dataclasses, the most valuable first.
        measure: from a case and the options to its row.
        line: a row of the printed table.
        header: the first line of that table.
    """

    def main(options: O) -> None:
        options.check()
        found = list(cases(options))
        without = [name for name, value in vars(options).items() if value == ()]
        if not found and without:
            raise ValueError(f"{', '.join(without)}: got none; takes at least one")
        rows = record.resume(options.out, row)
        fill(options, rows, found, lambda case: measure(case, options), line, header)

    return Command(config, main)


def fill(
    options: Options,
    rows: list[R],
    cases: Iterable[Case],
    measure: Callable[[Case], R],
    line: Callable[[R], str],
    header: str = "",
) -> None:
    """Measures the cases that `rows` lack; writes each row at once, so that an interruption loses none, and prints it.

    Args:
        options: of the benchmark.
        rows: those of earlier runs, to which the new ones are added.
        cases: dataclasses, the most valuable first.
        measure: from a case to its row.
        line: a row of the printed table.
        header: the first line of that table.
    """
    run = record.run_of(options)
    if rows:
        tqdm.write(f"{options.out} has {len(rows)} of the rows, not measured again")
    if header:
        tqdm.write(header)
    for case in remaining(cases, rows, options.max_minutes):
        rows.append(replace(measure(case), measured=run))
        record.write(options.out, rows)
        tqdm.write(line(rows[-1]))


def remaining(cases: Iterable[Case], rows: Sequence[Any], max_minutes: float | None) -> Iterator[Case]:
    """The cases without a row, under a progress bar, until the minutes are over.

    Args:
        cases: dataclasses; a row is of a case if it has the values of all its fields.
        rows: what is measured already.
        max_minutes: no case is begun later than this.
    """
    begun = time.monotonic()
    todo = [case for case in cases if not any(_is_of(row, case) for row in rows)]
    for i, case in enumerate(progress(todo, "measuring", unit="rows", leave=False)):
        if max_minutes is not None and time.monotonic() - begun > 60 * max_minutes:
            tqdm.write(f"stopped after {max_minutes:g} minutes with {len(todo) - i} rows to go; run again to go on")
            return
        yield case


def _is_of(row: Any, case: Any) -> bool:
    return all(getattr(row, name) == value for name, value in vars(case).items())


def command_line(module: str, **options: Any) -> list[str]:
    """The command that runs a benchmark in a process of its own."""
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    return [sys.executable, "-m", f"maax_mjx.benchmarks.{module}", *words]
