"""Rollouts: many steps under a policy as one compiled program, which keeps only the requested parts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from maax_mjx.common.checks import suggestion
from maax_mjx.core.env import Environment
from maax_mjx.core.state import plain
from maax_mjx.parallel.episodes import WorldsState
from maax_mjx.parallel.policy import Decision, Policy, decide, forgotten

BEFORE = ("obs", "active", "can_act")
"""Parts of the state that the policy saw; the others are those after the step."""
ACTION, EXTRAS = "action", "extras"
PARTS = (
    *BEFORE, ACTION, EXTRAS, "reward", "terminated", "truncated", "final_obs", "metrics", "episode_return",
    "episode_length", "step", "data", "world", "mechanics",
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
            hint = suggestion(name.split(".")[0], PARTS)
            raise ValueError(f"keep: got {name!r}{hint}; takes names that begin with one of {', '.join(PARTS)}")
    return tuple(keep)


def unroll(
    env: Environment,
    advance: Callable[[WorldsState, Any], WorldsState],
    policy: Policy,
    n_steps: int,
    keep: tuple[str, ...],
    index: jax.Array,
    states: WorldsState,
    key: jax.Array,
    args: tuple[Any, ...],
    memory: Any,
    per_world: tuple[Any, ...],
) -> tuple[WorldsState, dict[str, Any], Any]:
    """Steps all worlds `n_steps` times; `advance` makes a step.

    Returns:
        The states after the last step; by the names of `keep` the parts of every step, (n_steps, n, ...) each; and the
        memory after the last step, (n, ...).
    """
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(index)

    def act(state: Any, key: jax.Array, memory: Any, own: tuple[Any, ...], t: jax.Array) -> Decision:
        return decide(policy, env, state, jax.random.fold_in(key, t), memory, (*args, *own))

    def step(carry: tuple[WorldsState, Any], t: jax.Array) -> tuple[tuple[WorldsState, Any], dict[str, Any]]:
        states, memory = carry
        decided = jax.vmap(act, in_axes=(0, 0, 0, 0, None))(plain(states), keys, memory, per_world, t)
        after = advance(states, decided.action)
        kept = {name: _part(name, states, decided, after) for name in keep}
        return (after, forgotten(decided.memory, after.done)), kept

    (states, memory), kept = jax.lax.scan(step, (states, memory), jnp.arange(n_steps))
    return states, kept, memory


def _part(name: str, before: WorldsState, decided: Decision, after: WorldsState) -> Any:
    first, *rest = name.split(".")
    given = decided if first in (ACTION, EXTRAS) else before if first in BEFORE else after
    value = getattr(given, first)
    for part in rest:
        value = _inner(value, part, name)
    return value


def _inner(value: Any, part: str, name: str) -> Any:
    names = list(value) if isinstance(value, dict) else list(getattr(value, "__dataclass_fields__", ()))
    if part not in names:
        has = f"takes one of {', '.join(sorted(names))} there" if names else "there is an array without parts"
        raise ValueError(f"keep: got {name!r}; has no {part!r}: {has}")
    return value[part] if isinstance(value, dict) else getattr(value, part)
