"""Gymnasium spaces of JAX arrays, samples of them and checks of actions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces

from maax_mjx.common.checks import array_words, is_real_array, is_traced


def space_of(tree: Mapping[str, Any]) -> spaces.Dict:
    """Returns the space of a dict of arrays or shapes: MultiBinary for bool, else an unbounded Box.

    Empty arrays of bool, such as those about the others of a single agent, have a Box, since MultiBinary takes none.
    """

    def one(x: Any) -> spaces.Space:
        if x.dtype == bool:
            return spaces.MultiBinary(x.shape) if 0 not in x.shape else spaces.Box(0, 1, x.shape, np.bool_)
        return spaces.Box(-np.inf, np.inf, x.shape, np.dtype(x.dtype))

    return spaces.Dict({name: one(x) for name, x in sorted(tree.items())})


def check_space(space: spaces.Dict) -> None:
    """Refuses a space of actions with a part that agents, samples and networks could not share.

    Raises:
        ValueError: such a part, by its name.
    """
    for name, part in space.spaces.items():
        if not _is_shared(part):
            raise ValueError(
                f"action_space: got {part} for {name!r}; takes a Box with bounds, floats that are the same for all "
                "agents, a MultiBinary, or a MultiDiscrete with bins of one size from 0 on"
            )


def _is_shared(part: spaces.Space) -> bool:
    if isinstance(part, spaces.MultiDiscrete):
        return len(np.unique(part.nvec)) < 2 and not np.any(part.start)
    if isinstance(part, spaces.Box):
        bounds = np.stack([part.low, part.high])
        return bool(np.issubdtype(part.dtype, np.floating) and np.isfinite(bounds).all() and _same_rows(bounds))
    return isinstance(part, spaces.MultiBinary)


def _same_rows(bounds: np.ndarray) -> bool:
    """Whether all agents have the same bounds, (2, n_agents, ...)."""
    return bounds.ndim < 2 or bool((bounds == bounds[:, :1]).all())


def sample(space: spaces.Dict, key: jax.Array) -> dict[str, jax.Array]:
    """Draws a uniform sample of a dict of bounded boxes, bins and binaries; traceable.

    Raises:
        ValueError: a part of another kind; see `check_space`.
    """
    check_space(space)
    out = {}
    for k, (name, sub) in zip(jax.random.split(key, len(space.spaces)), space.spaces.items(), strict=True):
        if isinstance(sub, spaces.Box):
            out[name] = jax.random.uniform(k, sub.shape, jnp.float32, sub.low, sub.high)
        elif isinstance(sub, spaces.MultiDiscrete):
            out[name] = jax.random.randint(k, sub.shape, 0, jnp.asarray(sub.nvec))
        else:
            out[name] = jax.random.bernoulli(k, shape=sub.shape).astype(jnp.int8)
    return out


def check_action(space: spaces.Dict, action: Any, lead: tuple[int, ...] = (), argument: str = "action") -> None:
    """Refuses an action whose names, shapes or dtypes differ from the space's.

    Outside traced code, NaN and bins or binaries out of range are refused too.

    Args:
        space: the action space of one world.
        action: the action, with leading axes `lead`.
        lead: the leading axes.
        argument: name of the argument in messages.

    Raises:
        ValueError: a wrong action; the message names its part.
    """
    check_kinds(space, action, lead, argument)
    for name, sub in space.spaces.items():
        for part in [] if is_traced(action[name]) else _on_host(action[name]):
            if np.isnan(part).any():
                raise ValueError(f"{argument}: {name!r} holds NaN; takes {_takes(sub)}")
            if not isinstance(sub, spaces.Box) and ((part < 0) | (part > _most(sub))).any():
                raise ValueError(f"{argument}: {name!r} holds {part.min():g} to {part.max():g}; takes {_takes(sub)}")


def check_kinds(space: spaces.Dict, action: Any, lead: tuple[int, ...], argument: str) -> None:
    """Refuses an action whose names, shapes or dtypes differ from the space's; arguments as of `check_action`.

    Raises:
        ValueError: a wrong action; the message names its part.
    """
    if not isinstance(action, Mapping):
        got = "an array" if isinstance(action, jax.Array) else type(action).__name__
        raise ValueError(f"{argument}: got {got}; takes a dict with {sorted(space.spaces)}")
    if set(action) != set(space.spaces):
        raise ValueError(f"{argument}: got {sorted(action)}; takes exactly {sorted(space.spaces)}")
    for name, sub in space.spaces.items():
        if not is_real_array(action[name]):
            raise ValueError(f"{argument}: {name!r} is {array_words(action[name])}; takes an array of {_takes(sub)}")
        want = (*lead, *(sub.shape or ()))
        if jnp.shape(action[name]) != want:
            raise ValueError(f"{argument}: {name!r} has shape {jnp.shape(action[name])}; takes {want}")
        kind = jnp.result_type(action[name])
        if isinstance(sub, spaces.MultiDiscrete) and not jnp.issubdtype(kind, jnp.integer):
            raise ValueError(f"{argument}: {name!r} holds {kind}; takes whole numbers, the bins from 0 on")


def _most(space: spaces.Space) -> int:
    """Returns the greatest bin or binary; all bins have the same size."""
    return int(space.nvec.flat[0]) - 1 if isinstance(space, spaces.MultiDiscrete) else 1


def _takes(space: spaces.Space) -> str:
    if not isinstance(space, spaces.Box):
        return f"whole numbers from 0 to {_most(space)}"
    low, high = np.unique(space.low), np.unique(space.high)
    return f"numbers in [{low[0]:g}, {high[0]:g}]" if len(low) == len(high) == 1 else f"numbers in {space}"


def _on_host(x: Any) -> list[np.ndarray]:
    """Returns an array on the host; for an array that spans processes, its parts in this process."""
    if isinstance(x, jax.Array) and not x.is_fully_addressable:
        return [np.asarray(part.data) for part in x.addressable_shards]
    return [np.asarray(x)]
