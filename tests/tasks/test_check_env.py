"""`check_env` on every game, as it is registered."""

from __future__ import annotations

import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.cli.info import of_env
from maax_mjx.testing import check_env


@pytest.mark.slow
@pytest.mark.parametrize("name", maax.tasks())
def test_registered_games_hold_what_every_environment_must(name):
    # As many worlds as in `test_games`, whose batches of most games are then compiled already, or the other way round.
    check_env(maax.make(name, impl="c"), n_worlds=4, n_steps=2, seed=seeds.seed(0))


@pytest.mark.parametrize("name", maax.tasks())
def test_all_that_can_be_said_of_a_registered_game_is_said(name):
    told = of_env(name, {})
    assert told["fields"]["impl"] == "auto"
    assert told["action space"]
    assert told["observations"]
    assert told["about"]
