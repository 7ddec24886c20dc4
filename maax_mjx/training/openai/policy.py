"""A published policy that plays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.training.openai.network import OpenAINetwork
from maax_mjx.training.openai.observations import PARTS, POSE, SITES, Adapter, adapter_of
from maax_mjx.training.openai.structure import network_of
from maax_mjx.training.openai.weights import Arrays, read_weights
from maax_mjx.training.trained import TrainedPolicy

TASKS = ("lock_and_return", "sequential_lock", "shelter")
"""Transfer tasks whose published networks have the form of the full game's: files of these names play them. That of
blueprint is known by its construction sites."""


@dataclass(frozen=True)
class OpenAIPlay:
    """A published network as a policy of one world, `(state, key, memory, weights) -> (action, memory)`.

    Attributes:
        network: the network.
        adapter: reads the published observations; None before it is known which environment is played.
        deterministic: whether it takes the most likely action instead of drawing one.
    """

    network: OpenAINetwork
    adapter: Adapter | None = None
    deterministic: bool = False

    def __call__(self, state: State, key: jax.Array, memory: jax.Array, weights: Any) -> tuple[Any, jax.Array]:
        logits, memory = self.network(weights, self.adapted.read(state.obs), memory)
        keys = jax.random.split(key, len(PARTS))
        action = {}
        for part, (name, theirs) in zip(keys, PARTS.items(), strict=True):
            x = logits[theirs]
            x = x.reshape(len(x), 3, -1) if name == "move" else x
            chosen = x.argmax(axis=-1) if self.deterministic else jax.random.categorical(part, x)
            action[name] = chosen.astype(jnp.int32 if name == "move" else jnp.int8)
        return action, memory

    @property
    def adapted(self) -> Adapter:
        """The adapter.

        Raises:
            ValueError: there is none.
        """
        if self.adapter is None:
            raise ValueError("policy: got a published policy that no environment was given; takes policy.on(env)")
        return self.adapter


class OpenAIPolicy(TrainedPolicy):
    """A policy that Baker et al. published, as it plays the hide-and-seek games here; `Policy.from_openai` reads one.

    Args:
        name: what it is called.
        weights: its variables by name.
        play: its network, and what it plays.
    """

    play: OpenAIPlay

    def __init__(self, name: str, weights: Arrays, play: OpenAIPlay):
        self.name, self.params, self.play, self.steps = name, weights, play, 0
        # The quadrant's ramps cannot be locked, so that its policies observe no locks of them.
        game = "hide_and_seek_quadrant" if play.network.widths[3] == len(POSE) else "hide_and_seek_full"
        self.game = {"game": game, "config": {"published": True}}
        sites = SITES in play.network.masks
        if sites or (name in TASKS and game == "hide_and_seek_full"):
            self.game = {"game": "blueprint" if sites else name, "config": {"made_up": True, "published": True}}

    @classmethod
    def read(cls, path: str | Path) -> OpenAIPolicy:
        """Reads a published file; see `Policy.from_openai`."""
        weights = read_weights(path)
        try:
            network = network_of(weights)
        except ValueError as error:
            raise ValueError(f"path: got {path}: {error}") from None
        return cls(Path(path).stem, weights, OpenAIPlay(network))

    def __repr__(self) -> str:
        return f"<OpenAIPolicy {self.name!r}>"

    def memory(self, n_worlds: int) -> np.ndarray:
        """Returns what it remembers at the beginning of episodes, zeros (n_worlds, n_agents, m).

        Raises:
            ValueError: before `on` an environment.
        """
        return np.zeros((n_worlds, self.play.adapted.n_agents, self.play.network.memory_size), np.float32)

    def greedy(self) -> OpenAIPolicy:
        """Returns the policy that takes the most likely actions."""
        return OpenAIPolicy(self.name, self.params, replace(self.play, deterministic=True))

    def on(self, env: Environment) -> OpenAIPolicy:
        """Returns the policy as it plays an environment.

        Raises:
            ValueError: an environment that does not observe, or is not acted in, as the published game.
        """
        play = replace(self.play, adapter=adapter_of(env, self.play.network))
        return OpenAIPolicy(self.name, self.params, play)
