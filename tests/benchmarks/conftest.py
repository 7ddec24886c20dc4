"""Benchmarks run in this process, as their command lines would."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import replace

import jax.numpy as jnp
import pytest

import maax_mjx as maax
from maax_mjx.tasks.standard import standard


@dataclasses.dataclass(frozen=True)
class TinyConfig(maax.StandardConfig):
    """One agent on an open floor, which compiles fast."""

    scenario: str = "empty"
    n_hiders: int = 1
    n_seekers: int = 0
    n_boxes: int = 0
    n_ramps: int = 0


class Faulty(maax.Wrapper):
    """Makes a physics fault of every step."""

    def transition(self, state, action):
        return self.env.advance(state, {"move": jnp.full_like(action["move"], jnp.nan)})


GAMES = {
    "tiny": lambda config: maax.RestrictAgentsRect(standard(config), (1, 1, 5, 5)),
    "tiny_bins": lambda config: maax.DiscretizeActions(standard(replace(config, n_frames=3)), 11),
    "tiny_faulty": lambda config: Faulty(standard(config)),
}


@pytest.fixture(scope="session", autouse=True)
def tiny():
    """Registers small environments."""
    for name, build in GAMES.items():
        if name not in maax.tasks():
            maax.register(name, build, TinyConfig)


def _run(module, path, **options):
    """The rows of a benchmark's file, checked against its `Row` and with the run that measured them."""
    command = module.COMMAND
    command.main(command.config(out=path, **options))
    record = json.loads(path.read_text())
    assert set(record) == {"conditions", "rows"}
    for row in record["rows"]:
        assert set(row) == {field.name for field in dataclasses.fields(module.Row)}
    return record["rows"]


@pytest.fixture(scope="session")
def run():
    """`run(module, path, **options)`: a benchmark's rows."""
    return _run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where a file's tests leave their results."""
    return tmp_path_factory.mktemp("results")
