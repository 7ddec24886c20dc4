"""Errors that several rooms raise."""

from __future__ import annotations


class MissingLibraryError(RuntimeError):
    """A library is not installed, or not in a version that fits; the message says what to install."""
