"""Command lines parsed by tyro, whose refusals become one sentence like all others."""

from __future__ import annotations

import ast
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


def parsed(parse: Callable[[], T], command: str) -> T:
    """Calls a parser of tyro's, and raises in a sentence what it would print in a box.

    Args:
        parse: the parser.
        command: what was called, as "maax-mjx rollout".

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
    raise ValueError(sentence(printed.getvalue(), command))


def sentence(box: str, command: str) -> str:
    """Returns what a box of tyro's says about a command, on one line."""
    inside = [line.strip(" │") for line in box.splitlines() if not line.startswith(("╭", "╰"))]
    parts = [" ".join(part.split()) for part in re.split(r"─{5,}|-{5,}", " ".join(inside))]
    if not box.lstrip().startswith("╭"):  # where only ASCII can be printed: the title, and a line below it
        parts = parts[1:]
    said = re.sub(r" \(applied to [^)]*\)", "", parts[0]).partition(" Arguments are applied")[0].rstrip(".")
    said = re.sub(r"(?<=one of )\(('[^)]*')\)", lambda found: f"({in_order(found[1])})", said)
    meant = guesses(box.partition("Perhaps")[2], command)
    if set(meant) & set(said.split()):
        meant = []  # What was given is there, and stands before its command.
    hint = f"; did you mean {' or '.join(meant)}?" if meant else ""
    return f"{said[:1].lower()}{said[1:]}{hint}; {command} --help lists what it takes"


def in_order(choices: str) -> str:
    """Returns quoted choices in the order of the alphabet: tyro's order differs from process to process."""
    return ", ".join(sorted(choice for choice in choices.split(", ") if choice != "'None'"))


def guesses(near: str, command: str) -> list[str]:
    """Returns the options that tyro guesses, of any command, without those that are other commands' alone."""
    _, *rest = re.split(OPTION, near, flags=re.MULTILINE)
    found = []
    for name, text in zip(rest[::2], rest[1::2], strict=True):
        commands = re.findall(r"in (maax-mjx[\w -]*) --help", text)
        # Before any command, those of all are meant; where there is one command alone, tyro names none.
        if not commands or any(x.startswith(command) for x in commands):
            found.append(name)
    return list(dict.fromkeys(found))


def value_of(text: str) -> Any:
    """Parses a Python literal, words between commas as a tuple, or a single word."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return tuple(value_of(part) for part in text.split(",")) if "," in text else text
