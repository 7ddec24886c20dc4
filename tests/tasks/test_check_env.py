"""`check_env` on every game, as it is registered."""

from __future__ import annotations

import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.testing import check_env


@pytest.mark.slow
@pytest.mark.parametrize("name", maax.tasks())
def test_registered_games_hold_what_every_environment_must(name):
    # As many worlds as in `test_games`, whose batches of most games are then compiled already, or the other way round.
    check_env(maax.make(name, impl="c"), n_worlds=4, n_steps=2, seed=seeds.seed(0))
