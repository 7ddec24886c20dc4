"""One agent's part of an environment: what it observes and decides, as other libraries want it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces

from maax_mjx.common.checks import array_words, check_bool, described, is_real_array
from maax_mjx.common.observed import Observed
from maax_mjx.common.spaces import check_action, check_kinds
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.state import State
from maax_mjx.wrappers import FlattenObservations, MaskObservations, SplitObservations
from maax_mjx.wrappers.wrapper import find

FLAT = "obs"


class WithVectors(FlattenObservations):
    """Adds the vectors of `FlattenObservations` beside the arrays, which policies of the game read as before."""

    def observation(self, state: State) -> dict[str, jax.Array]:
        return {**state.obs, **super().observation(state)}

    def declared(self) -> dict[str, Observed]:
        vectors = {name: replace(one, derived=True) for name, one in super().declared().items()}
        return {**self.env.observed, **vectors}


class PerAgent:
    """An environment whose agents observe and act one by one, with spaces of a single agent.

    Observations are the vector of `FlattenObservations`, or a dict of arrays, in both of which what an agent does not
    see is zero. Actions are one space where their parts can be joined: a single part as it is, and bins, locks and
    grabs as one `MultiDiscrete`, in the order of their names; otherwise they are a dict.

    Args:
        env: an environment whose agents observe for themselves: with `SplitObservations`, or flat.
        flat: whether observations are one vector.
        argument: what the environment was passed as, for messages.

    Attributes:
        env: the environment, with what was wrapped around it.
        observation_space, action_space: of one agent.
        parts: the spaces of what one agent decides, by name.

    Raises:
        ValueError: an environment whose agents share their observations, or a flat one that should not be.
    """

    def __init__(self, env: Environment, flat: bool = True, argument: str = "env"):
        check_environment(env)
        check_bool("flat", flat)
        if find(env, FlattenObservations) is None:
            if find(env, SplitObservations) is None:
                raise ValueError(
                    f"{argument}: got {env!r}, whose agents share what is observed; takes one with SplitObservations "
                    'or EgocentricObservations, such as a game with observations="ego"'
                )
            env = WithVectors(env) if flat else MaskObservations(env)
        elif not flat:
            raise ValueError(f"flat: got False for {env!r}, whose observations are vectors; takes one that is split")
        self.env, self.flat = env, flat
        table = env.observed
        self._shown = [FLAT] if flat else [name for name, one in table.items() if not one.critic]
        seen = {name: _seen_by_one(env.observation_space[name]) for name in self._shown if table[name].is_of_agents}
        if missing := [name for name in self._shown if name not in seen]:
            raise ValueError(
                f"{argument}: got {env!r}, in which {missing} belong to no agent; takes observations of agents"
            )
        self.observation_space: spaces.Space = seen[FLAT] if flat else spaces.Dict(seen)
        self.parts = {name: _of_one(space) for name, space in sorted(env.action_space.spaces.items())}
        self.action_space: spaces.Space = _joined(self.parts)

    def observations(self, obs: Mapping[str, jax.Array]) -> Any:
        """Returns observations (..., n_agents, ...) as the spaces have them: an array, or a dict of arrays."""
        if self.flat:
            return obs[FLAT]
        return {name: obs[name].astype(jnp.int8) if obs[name].dtype == bool else obs[name] for name in self._shown}

    def one_kind(self, argument: str) -> spaces.Space:
        """Returns the action space, for libraries that know no dicts of actions.

        Raises:
            ValueError: a dict, of numbers and choices.
        """
        if isinstance(self.action_space, spaces.Dict):
            raise ValueError(
                f"{argument}: got {self.env!r}, whose agents decide {sorted(self.parts)} as numbers and choices; "
                "takes one with bins, DiscretizeActions, or with actions of one kind"
            )
        return self.action_space

    def action(self, chosen: Any) -> dict[str, jax.Array]:
        """Returns the environment's action.

        Args:
            chosen: (..., n_agents, k), or a dict of such arrays, as the agents' action space has them.
        """
        if isinstance(self.action_space, spaces.Dict):
            return {name: jnp.asarray(chosen[name]) for name in self.parts}
        if len(self.parts) == 1:
            return {name: jnp.asarray(chosen) for name in self.parts}
        parts, at = {}, 0
        for name, part in self.parts.items():
            width = _width(part)
            taken = jnp.asarray(chosen)[..., at : at + width]
            parts[name] = taken[..., 0] if part.shape == () else taken
            at += width
        return parts

    def check(self, chosen: Any, lead: tuple[int, ...], argument: str) -> None:
        """Refuses what is no action of agents by its shape or dtype.

        Args:
            chosen: an array (*lead, k), or a dict of such arrays, as the agents' action space has them.
            lead: the leading axes.
            argument: what it was passed as, for messages.

        Raises:
            ValueError: another shape or dtype.
        """
        space = self.action_space
        if isinstance(space, spaces.Dict):
            check_kinds(space, chosen, lead, argument)
            for name, part in space.spaces.items():
                kind = jnp.result_type(chosen[name])
                if not isinstance(part, spaces.Box) and jnp.issubdtype(kind, jnp.floating):
                    raise ValueError(f"{argument}: {name!r} holds {kind}; takes whole numbers, the choices from 0 on")
            return
        takes = (*lead, *(space.shape or ()))
        if not is_real_array(chosen):
            got = described(chosen) if not hasattr(chosen, "dtype") else array_words(chosen)
            raise ValueError(f"{argument}: got {got}; takes an array {takes}")
        if jnp.shape(chosen) != takes:
            raise ValueError(f"{argument}: got shape {jnp.shape(chosen)}; takes an array {takes}")
        if isinstance(space, spaces.MultiDiscrete) and not jnp.issubdtype(chosen.dtype, jnp.integer):
            raise ValueError(f"{argument}: got {chosen.dtype}; takes whole numbers, the choices from 0 on")

    def check_one(self, chosen: Any, argument: str) -> Any:
        """Returns what one agent chose as arrays; lists and numbers may be given.

        Raises:
            ValueError: no action of one agent; the message says what is.
        """
        chosen = arrays_of(chosen, argument)
        self.check(chosen, (), argument)
        check_action(spaces.Dict(self.parts), jax.tree.map(np.asarray, self.action(chosen)), (), argument)
        return chosen

    @property
    def idle(self) -> Any:
        """An action of one agent that does nothing."""

        def still(part: spaces.Space) -> np.ndarray:
            rest = part.nvec // 2 if isinstance(part, spaces.MultiDiscrete) else np.zeros(part.shape or ())
            return np.asarray(rest, part.dtype)

        found = {name: still(part) for name, part in self.parts.items()}
        if isinstance(self.action_space, spaces.Dict):
            return found
        rows = np.concatenate([np.atleast_1d(part) for part in found.values()])
        return rows.astype(self.action_space.dtype).reshape(self.action_space.shape or ())


def arrays_of(chosen: Any, argument: str) -> Any:
    """Returns actions as an array, or as a dict of arrays.

    Raises:
        ValueError: what no array of numbers can be made of.
    """
    try:
        is_dict = isinstance(chosen, Mapping)
        given = {name: np.asarray(x) for name, x in chosen.items()} if is_dict else np.asarray(chosen)
        if all(is_real_array(x) for x in jax.tree.leaves(given)):
            return given
    except (TypeError, ValueError):
        pass  # NumPy's of lists that differ in length, PyTorch's of tensors on a GPU
    raise ValueError(f"{argument}: got {described(chosen)}; takes what action_space.sample() gives")


def _seen_by_one(space: spaces.Space) -> spaces.Space:
    """Returns the space of what one agent observes, from that of all; flags are numbers, 0 and 1."""
    shape = (space.shape or ())[1:]
    if isinstance(space, spaces.MultiBinary):
        return spaces.Box(0, 1, shape, np.int8)
    assert isinstance(space, spaces.Box)
    return spaces.Box(np.reshape(space.low[0], shape), np.reshape(space.high[0], shape), shape, space.dtype.type)


def _of_one(space: spaces.Space) -> spaces.Space:
    """Returns the space of what one agent decides, from that of all."""
    if isinstance(space, spaces.MultiDiscrete):
        return spaces.MultiDiscrete(space.nvec[0])
    if isinstance(space, spaces.MultiBinary):
        shape = tuple(np.atleast_1d(space.n))[1:]
        return spaces.MultiBinary([int(n) for n in shape]) if shape else spaces.Discrete(2)
    return _seen_by_one(space)


def _width(part: spaces.Space) -> int:
    return int(np.prod(part.shape or (1,)))


def _joined(parts: Mapping[str, spaces.Space]) -> spaces.Space:
    """Returns one space of all parts where there is one, else a dict."""
    if len(parts) == 1:
        return next(iter(parts.values()))
    choices: list[int] = []
    for part in parts.values():
        if (of_part := choices_of(part)) is None:
            return spaces.Dict(dict(parts))
        choices += of_part
    return spaces.MultiDiscrete(choices)


def choices_of(space: spaces.Space) -> list[int] | None:
    """Returns how many choices there are for each number of what one agent decides; None for a box."""
    if isinstance(space, spaces.Box):
        return None
    return [int(n) for n in space.nvec.ravel()] if isinstance(space, spaces.MultiDiscrete) else [2] * _width(space)
