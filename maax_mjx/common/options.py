"""Command lines parsed by tyro, whose refusals become one sentence like all others."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable
from typing import Any, TypeVar

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

T = TypeVar("T")

OPTION = r"^[│|]? {1,7}(--[a-zA-Z][\w.-]*)"
"""An option at the beginning of a line of tyro's; what helps with it is further in."""

NUMBERS = ConstructorRegistry()
"""Takes every text as a number; `check_fields`, which all commands call, refuses those that are none."""


@NUMBERS.primitive_rule
def _number(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    kind = info.type
    if kind not in (int, float):
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=kind.__name__.upper(),
        instance_from_str=lambda words: number_of(words[0], kind),
        is_instance=lambda x: isinstance(x, (int, str) if kind is int else (int, float, str)),
        str_from_instance=lambda x: [str(x)],
    )


def number_of(text: str, kind: Any) -> Any:
    """Returns a text as a number of a kind, int or float; the text itself where it is none. 1e6 is a whole number."""
    with contextlib.suppress(ValueError):
        return kind(text)
    with contextlib.suppress(ValueError, OverflowError):
        if float(text).is_integer() and abs(float(text)) < 2**53:
            return int(float(text))
    return text


def parsed(parse: Callable[[], T]) -> T:
    """Calls a parser of tyro's, and raises in a sentence what it would print in a box.

    Raises:
        ValueError: options that tyro refuses.
        SystemExit: 0 after help was printed.
    """
    printed = io.StringIO()
    try:
        with contextlib.redirect_stderr(printed):
            return parse()
    except SystemExit as exited:
        if not exited.code or not printed.getvalue():
            raise
    raise ValueError(sentence(printed.getvalue()))


def sentence(box: str) -> str:
    """Returns what a box of tyro's says, on one line."""
    inside = [line.strip(" │") for line in box.splitlines() if not line.startswith(("╭", "╰"))]
    parts = [" ".join(part.split()) for part in re.split(r"─{5,}|-{5,}", " ".join(inside))]
    if not box.lstrip().startswith("╭"):  # where only ASCII can be printed: the title, and a line below it
        parts = parts[1:]
    said = re.sub(r" \(applied to [^)]*\)", "", parts[0]).partition(" Arguments are applied")[0].rstrip(".")
    near = box.partition("Perhaps")[2]
    # tyro names the command that was given for some mistakes alone; its first guess is of it.
    command = (
        re.search(r"\(applied to (maax-mjx[\w -]*)\)", parts[0])
        or re.search(r"(maax-mjx[\w -]*) --help", near)
        or re.search(r"(maax-mjx[\w -]*) --help", parts[-1])
    )
    # What was given is an option of another command where it is also what was meant.
    meant = [name for name in guesses(near, command[1] if command else "") if name not in said.split()]
    hint = f"; did you mean {' or '.join(meant)}?" if meant else ""
    return said[:1].lower() + said[1:] + hint + (f"; {command[1]} --help lists what it takes" if command else "")


def guesses(near: str, command: str) -> list[str]:
    """Returns the options that tyro guesses in its box, without those that it says are other commands' alone."""
    _, *rest = re.split(OPTION, near, flags=re.MULTILINE)
    found = {}
    for name, text in zip(rest[::2], rest[1::2], strict=True):
        commands = re.findall(r"in (maax-mjx[\w -]*) --help", text)
        if command in commands or not commands:
            found[name] = True
    return list(found)
