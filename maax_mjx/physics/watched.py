"""An engine that shows every physics step to the host, for looking at what happens inside of an env step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.experimental import io_callback

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.fields import Fields

Watch = Callable[[Fields, Data], Any]
"""Called on the host with a world's fields and its state, before the first physics step and after every one."""


class Watched:
    """Another engine, stepped one physics step at a time, of single worlds.

    Args:
        engine: the engine.
        watch: what is shown every physics step.
    """

    def __init__(self, engine: Engine, watch: Watch):
        self._engine = engine
        self._watch = watch

    def __getattr__(self, name: str) -> Any:
        return getattr(self._engine, name)

    def advance(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        """Advances a world as the engine does, in as many calls as physics steps."""
        io_callback(self._watch, None, fields, data, ordered=True)

        def frame(data: Data, _: None) -> tuple[Data, jax.Array]:
            data, overflow = self._engine.advance(fields, data, 1)
            io_callback(self._watch, None, fields, data, ordered=True)
            return data, overflow

        data, overflow = jax.lax.scan(frame, data, length=n_frames)
        return data, overflow.any()
