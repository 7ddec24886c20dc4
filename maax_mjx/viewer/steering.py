"""What an agent does that a person steers by keys."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from string import ascii_lowercase, ascii_uppercase
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import MultiBinary

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.tasks.scripted import to_action

WAYS = {
    "KeyW": (1, 0, 0),
    "KeyS": (-1, 0, 0),
    "KeyA": (0, 1, 0),
    "KeyD": (0, -1, 0),
    "KeyQ": (0, 0, 1),
    "KeyE": (0, 0, -1),
}
"""Forces ahead and to the left, and the torque, of a key."""
SWITCHES = {"grab": "KeyG", "lock": "KeyL"}
"""Keys that turn a part of an action on and off; other parts have the first free letter of their name."""
TAKEN = "KeyN"
"""The letter that goes to the next world."""
HELP = "**W A S D** move, **Q E** turn"


class Steering:
    """Turns keys into an agent's action.

    Args:
        env: the environment.

    Attributes:
        switches: the parts of an action that keys turn on and off, by key.
        on: which of them are on, by name.
    """

    def __init__(self, env: Environment):
        self._env = env
        parts = [
            name for name, space in env.action_space.spaces.items() if name != "move" and isinstance(space, MultiBinary)
        ]
        self.switches = _switches(parts)
        self.on = dict.fromkeys(self.switches.values(), False)

    @property
    def help(self) -> str:
        """The keys, as Markdown."""
        return ", ".join([HELP, *(f"**{key[-1]}** {name} on or off" for key, name in self.switches.items())])

    def press(self, key: str) -> None:
        """Turns on or off what a key is for."""
        if name := self.switches.get(key):
            self.on[name] = not self.on[name]

    def release(self) -> None:
        """Turns everything off."""
        self.on = dict.fromkeys(self.on, False)

    def forces(self, held: Collection[str], heading: float) -> np.ndarray:
        """Returns (3,) forces along the world's x and y, and the torque.

        Args:
            held: the keys that are held.
            heading: where the agent looks, in radians from the x axis.
        """
        ahead, left, torque = np.sum([WAYS[key] for key in held if key in WAYS] or [(0, 0, 0)], axis=0, dtype=float)
        push = np.array([ahead, left]) / max(np.hypot(ahead, left), 1.0)
        cos, sin = np.cos(heading), np.sin(heading)
        return np.array([push[0] * cos - push[1] * sin, push[0] * sin + push[1] * cos, torque], np.float32)

    def action(self, forces: jax.Array, on: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Returns the action in which all agents do what one was told. Traceable.

        Args:
            forces: (3,).
            on: bool by name, whether a part is on.
        """
        n = self._env.n_agents
        parts = {name: jnp.full(n, is_on, jnp.int32) for name, is_on in on.items()}
        return to_action(self._env, jnp.broadcast_to(forces, (n, 3)), **parts)


def _switches(parts: Sequence[str]) -> dict[str, str]:
    """Returns a key for every part, as long as there are letters."""
    switches = {SWITCHES[name]: name for name in parts if name in SWITCHES}
    for name in parts:
        free = (f"Key{letter}" for letter in (name + ascii_lowercase).upper() if letter in ascii_uppercase)
        key = next((key for key in free if key not in {*WAYS, TAKEN, *SWITCHES.values(), *switches}), None)
        if name not in SWITCHES and key is not None:
            switches[key] = name
    return switches


def steered(env: Environment, steering: Steering, others: Any) -> Any:
    """Returns a policy in which a person plays one agent, and others the rest.

    Args:
        env: the environment.
        steering: makes the person's action.
        others: `(state, key, memory, params) -> (action, memory)`.

    Returns:
        `(state, key, memory, params, slot, forces, on) -> (action, memory)`; a slot of -1 steers nobody.
    """

    def policy(
        state: State,
        key: jax.Array,
        memory: Any,
        params: Any,
        slot: jax.Array,
        forces: jax.Array,
        on: dict[str, jax.Array],
    ) -> tuple[Any, Any]:
        action, memory = others(state, key, memory, params)
        mine = jnp.arange(env.n_agents) == slot

        def chosen(told: jax.Array, played: jax.Array) -> jax.Array:
            return jnp.where(mine.reshape(-1, *[1] * (played.ndim - 1)), told.astype(played.dtype), played)

        return jax.tree.map(chosen, steering.action(forces, on), action), memory

    return policy
