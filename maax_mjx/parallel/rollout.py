"""Rollouts: many steps under a policy as one compiled program, which keeps only the requested parts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from maax_mjx.common.spaces import check_action
from maax_mjx.core.env import Environment
from maax_mjx.core.state import plain
from maax_mjx.parallel.episodes import WorldsState, advance

Policy = Callable[..., Any]
"""`(state, key, *args) -> action` for one world: its `State`, a key for this world and step, and the rollout's further
arguments, such as a network's parameters, which all worlds share."""

BEFORE = "obs"
ACTION = "action"
PARTS = (
    "obs", "action", "reward", "terminated", "truncated", "final_obs", "metrics", "episode_return", "episode_length",
    "step", "data", "world", "mechanics",
)  # fmt: skip


def check_keep(keep: Any) -> tuple[str, ...]:
    """Returns the names of parts to keep.

    Raises:
        ValueError: names that are not parts of a step.
    """
    if not isinstance(keep, tuple | list) or not all(isinstance(name, str) for name in keep):
        raise ValueError(
            f"keep: got {keep!r}; takes a tuple of names such as ('obs', 'reward', 'metrics.physics_fault')"
        )
    for name in keep:
        if name.split(".")[0] not in PARTS:
            raise ValueError(f"keep: got {name!r}; takes names that begin with one of {', '.join(PARTS)}")
    return tuple(keep)


def unroll(
    env: Environment,
    policy: Policy,
    n_steps: int,
    keep: tuple[str, ...],
    index: jax.Array,
    states: WorldsState,
    key: jax.Array,
    args: tuple[Any, ...],
) -> tuple[WorldsState, dict[str, Any]]:
    """Steps all worlds `n_steps` times.

    Returns:
        The states after the last step, and by the names of `keep` the parts of every step, (n_steps, n, ...) each.
    """
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(index)

    def act(state: Any, key: jax.Array, t: jax.Array) -> Any:
        action = policy(state, jax.random.fold_in(key, t), *args)
        check_action(env.action_space, action, argument="policy's action")
        return action

    def step(states: WorldsState, t: jax.Array) -> tuple[WorldsState, dict[str, Any]]:
        action = jax.vmap(act, in_axes=(0, 0, None))(plain(states), keys, t)
        after = advance(env, states, action)
        return after, {name: _part(name, states, action, after) for name in keep}

    return jax.lax.scan(step, states, jnp.arange(n_steps))


def _part(name: str, before: WorldsState, action: Any, after: WorldsState) -> Any:
    first, *rest = name.split(".")
    value = action if first == ACTION else getattr(before if first == BEFORE else after, first)
    for part in rest:
        value = _inner(value, part, name)
    return value


def _inner(value: Any, part: str, name: str) -> Any:
    names = list(value) if isinstance(value, dict) else list(getattr(value, "__dataclass_fields__", ()))
    if part not in names:
        has = f"takes one of {', '.join(sorted(names))} there" if names else "there is an array without parts"
        raise ValueError(f"keep: got {name!r}; has no {part!r}: {has}")
    return value[part] if isinstance(value, dict) else getattr(value, part)
