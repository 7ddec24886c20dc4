"""What a policy is: a function of one world's state, with or without a memory."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, TypeGuard

import jax
import jax.numpy as jnp

from maax_mjx.common.checks import described
from maax_mjx.common.spaces import check_action
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State

Policy = Callable[..., Any]
"""`(state, key, *args) -> action` for one world: its `State`, a key for this world and step, and the rollout's further
arguments: `args`, which all worlds share, such as a network's parameters, then the world's own of `per_world`.

With a memory `(state, key, memory, *args) -> (action, memory)`, where the memory is the world's own; it is zero where
an episode begins. Either may also return a dict of arrays to keep, such as values: `(action, extras)` and
`(action, memory, extras)`.
"""


class Player(Protocol):
    """A policy that brings parameters and a memory of its own, such as `maax_mjx.training.Policy`."""

    @property
    def play(self) -> Policy:
        """`(state, key, memory, params) -> (action, memory)` for one world."""

    @property
    def params(self) -> Any:
        """What `play` gets as its last argument."""

    def memory(self, n_worlds: int) -> Any:
        """Returns the memory at the beginning of episodes, with the leading axis (n_worlds,)."""

    def on(self, env: Environment) -> Player:
        """Returns it as it plays an environment.

        Raises:
            ValueError: an environment that it cannot play.
        """


class Playable(Protocol):
    """What becomes a player of an environment, such as one of `maax_mjx.training.SCRIPTED`.

    One that can be called itself has `play` as well, or it counts as a function.
    """

    def on(self, env: Environment) -> Player:
        """Returns it as it plays an environment.

        Raises:
            ValueError: an environment that it cannot play.
        """


def is_player(policy: Any) -> TypeGuard[Playable]:
    """Whether a policy becomes a player of an environment, with parameters and a memory of its own."""
    # A function or an object of one's own that is called may have a method of this name for something else.
    return callable(getattr(policy, "on", None)) and (hasattr(policy, "play") or not callable(policy))


class Decision(NamedTuple):
    """What a policy gave for one world.

    Attributes:
        action: the action.
        memory: its next memory; None without.
        extras: further arrays by name.
    """

    action: Any
    memory: Any
    extras: dict[str, jax.Array]


def check_policy(policy: Any, with_memory: bool, args: tuple[Any, ...]) -> None:
    """Refuses what cannot be called as a policy.

    Args:
        policy: the policy.
        with_memory: whether it is called with a memory.
        args: its further arguments.

    Raises:
        ValueError: no function, one that takes other arguments, or arguments that are no arrays.
    """
    called = ("state", "key", *(("memory",) if with_memory else ()), *(f"args[{i}]" for i in range(len(args))))
    if not callable(policy):
        if callable(getattr(policy, "policy", None)):
            raise ValueError(f"policy: got {described(policy)}; takes its policy, run.policy")
        known = "training.Policy.load(name) or training.SCRIPTED[name]"
        trained = f", or a player: {known}" if isinstance(policy, str) else ""
        raise ValueError(f"policy: got {described(policy)}; takes a function of ({', '.join(called)}){trained}")
    try:
        signature = inspect.signature(policy)
    except (TypeError, ValueError):
        signature = None
    if signature is not None:
        try:
            signature.bind(*called)
        except TypeError as error:
            name = getattr(policy, "__name__", type(policy).__name__)
            raise ValueError(
                f"policy: got {name}{signature}, which is called with ({', '.join(called)}): {error}"
            ) from None
    for i, arg in enumerate(args):
        for leaf in jax.tree.leaves(arg):
            if not hasattr(leaf, "dtype") and not isinstance(leaf, int | float | complex):
                raise ValueError(
                    f"args[{i}]: got {described(leaf)} in it; takes arrays, which may change from call to call: a "
                    "policy knows everything else by itself"
                )


def decide(policy: Policy, env: Environment, state: State, key: jax.Array, memory: Any, args: tuple) -> Decision:
    """Calls a policy for one world, and checks what it gives.

    Raises:
        ValueError: an action that is not in the environment's space, a memory of another kind than the one before, or
            extras that are no dict of arrays.
    """
    given = policy(state, key, *(() if memory is None else (memory,)), *args)
    parts = given if isinstance(given, tuple) else (given,)
    n = 1 if memory is None else 2
    if not n <= len(parts) <= n + 1:
        takes = "(action, memory) or (action, memory, extras)" if n == 2 else "an action or (action, extras)"
        got = f"a tuple of {len(parts)}" if isinstance(given, tuple) else described(given)
        raise ValueError(f"policy: got {got} from it; takes {takes}")
    action, after, extras = parts[0], parts[1] if n == 2 else None, parts[n] if len(parts) > n else {}
    check_action(env.action_space, action, argument="policy's action")
    if not isinstance(extras, Mapping) or not all(isinstance(x, jax.Array) for x in jax.tree.leaves(extras)):
        raise ValueError(f"policy: got {described(extras)} as extras; takes a dict of arrays")
    if kind_of(after) != kind_of(memory):
        raise ValueError(f"policy: got the memory {kind_of(after)} from it, and gave {kind_of(memory)}; takes the same")
    return Decision(action, after, dict(extras))


def kind_of(tree: Any) -> str:
    """Returns a text of a tree's structure, shapes and dtypes."""
    return str(jax.tree.map(lambda x: f"{jnp.result_type(x)}{list(jnp.shape(x))}", tree))


def forgotten(memory: Any, done: jax.Array) -> Any:
    """Returns the memory of some worlds (n, ...), zero where an episode is done (n,) bool."""
    return jax.tree.map(lambda x: jnp.where(done.reshape(-1, *[1] * (x.ndim - 1)), jnp.zeros_like(x), x), memory)
