"""Pictures in three dimensions, where there may be no OpenGL."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

import maax_mjx as maax


@contextmanager
def skipped_without_opengl() -> Iterator[None]:
    """Skips the test where what is drawn inside needs an OpenGL that is not there."""
    try:
        yield
    except maax.MissingLibraryError as error:
        pytest.skip(f"no OpenGL: {error}")
