"""Batches of a module's own `env`, of as many worlds as its `N` says, whose states stay."""

from __future__ import annotations

import pytest
from helpers import seeds

import maax_mjx as maax


@pytest.fixture(scope="module")
def worlds(request, env):
    return maax.Worlds(env, request.module.N, donate=False)


@pytest.fixture(scope="module")
def start(worlds):
    return worlds.reset(seeds.key(3), stagger=True)
