"""Fields of a game's config that the command line gives as texts."""

from __future__ import annotations

import pytest

from maax_mjx import GrabConfig, config_of
from maax_mjx.cli.options import config_with, values_of


def test_a_config_within_a_config_is_switched_on_and_off():
    values = values_of("hide_and_seek", {"grab": "True", "lock": "False", "grab.radius": "0.3", "fast": "False"})
    assert values == {"grab": GrabConfig(), "lock": None, "grab.radius": 0.3, "fast": False}
    assert config_of("hide_and_seek").lock is not None
    config = config_with("hide_and_seek", "auto", {"lock": "False", "lidar": "False"})
    assert config.lock is None
    assert config.lidar is None


def test_an_engine_is_given_one_way():
    assert config_with("tag", "auto", {"impl": "c"}).impl == "c"
    assert config_with("tag", "c", {"impl": "c"}).impl == "c"
    with pytest.raises(ValueError, match=r"impl: got --impl jax and --env\.impl c; takes one of them"):
        config_with("tag", "jax", {"impl": "c"})
