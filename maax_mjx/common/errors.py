"""Errors that several rooms raise."""

from __future__ import annotations


class MissingLibraryError(RuntimeError):
    """A library that is missing or has a version that does not fit; the message says what to install."""


def brought_by(extra: str) -> str:
    """Returns the part of a message that says how to install an extra."""
    return f'the extra "{extra}" brings it, pip install -e ".[{extra}]" in a clone of maax_mjx'
