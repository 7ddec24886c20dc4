"""Errors that several rooms raise."""

from __future__ import annotations


class MissingLibraryError(RuntimeError):
    """A library that is missing or has a version that does not fit; the message says what to install."""
