"""Wrappers that select, join and pad observations, and add constant ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from maax_mjx.common.checks import check_count, described
from maax_mjx.common.observed import Column, Observed, check_shapes
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.wrapper import ObservationWrapper


class SelectObservations(ObservationWrapper):
    """Keeps only some observations.

    Args:
        env: environment to wrap.
        keys: names of the observations to keep.

    Raises:
        ValueError: a name that is not observed.
    """

    def __init__(self, env: Environment, keys: Sequence[str]):
        super().__init__(env)
        check_names(env.observation_space.spaces, keys)
        self.keys = tuple(keys)

    def observation(self, state: State) -> dict[str, jax.Array]:
        return {key: state.obs[key] for key in self.keys}

    def declared(self) -> dict[str, Observed]:
        return {name: one for name, one in self.env.observed.items() if name in self.keys}


class ConcatenateObservations(ObservationWrapper):
    """Joins observations along their last axis, in place of the parts.

    Args:
        env: environment to wrap.
        joined: by new name, the names of its parts, whose shapes differ only in the last axis.

    Raises:
        ValueError: a name that is not observed, or parts that do not fit each other.
    """

    def __init__(self, env: Environment, joined: Mapping[str, Sequence[str]]):
        super().__init__(env)
        self.joined = {name: tuple(parts) for name, parts in joined.items()}
        for name, parts in self.joined.items():
            check_names(env.observation_space.spaces, parts)
            if name in env.observation_space.spaces and name not in parts:
                raise ValueError(f"joined: got {name!r}, which is observed already; takes another name")
            shapes = [env.observation_space[part].shape or () for part in parts]
            if not parts or len({shape[:-1] for shape in shapes}) > 1:
                raise ValueError(f"{name}: got parts of shapes {shapes}; takes equal ones but for the last axis")

    def observation(self, state: State) -> dict[str, jax.Array]:
        used = {part for parts in self.joined.values() for part in parts}
        kept = {key: value for key, value in state.obs.items() if key not in used}
        whole = {
            name: jnp.concatenate([state.obs[part] for part in parts], axis=-1) for name, parts in self.joined.items()
        }
        return kept | whole

    def declared(self) -> dict[str, Observed]:
        table = self.env.observed
        used = {part for parts in self.joined.values() for part in parts}
        found = {name: one for name, one in table.items() if name not in used}
        for name, parts in self.joined.items():
            every = [table[part] for part in parts if part in table]
            # Parts about different things, or that only their owners see, have no common declaration.
            if (
                len(every) == len(parts)
                and all(one.columns for one in every)
                and len({_about(one) for one in every}) == 1
            ):
                columns = [(part, column) for part, one in zip(parts, every, strict=True) for column in one.columns]
                found[name] = replace(every[0], columns=_distinct(columns))
        return found


class SpoofEntities(ObservationWrapper):
    """Pads entities to a fixed number, so that one policy serves worlds of different sizes (Baker et al.).

    Adds `<name>_spoof` (n_agents, total), False for padding, for every mask that it pads, and for every other
    observation in `keys` without a mask of what is in play, whose mask it then is.

    Args:
        env: environment to wrap, with split observations.
        total: number of entities after padding.
        keys: observations (n_agents, k, ...), padded with zeros to (n_agents, total, ...).
        mask_keys: masks (n_agents, k), padded with False; None takes the declared masks of `keys`.

    Raises:
        ValueError: a name that is not observed, an observation of more entities than `total`, or `mask_keys` without a
            mask of `keys`, which would show what it hides.
    """

    def __init__(self, env: Environment, total: int, keys: Sequence[str], mask_keys: Sequence[str] | None = None):
        super().__init__(env)
        self.total = check_count("total", total, minimum=1)
        spaces = env.observation_space.spaces
        check_names(spaces, keys)
        self.keys = tuple(keys)
        masks = _masks_of(env, self.keys)
        check_names(spaces, mask_keys or ())
        self.mask_keys = masks if mask_keys is None else tuple(mask_keys)
        for mask in masks:
            if mask not in self.mask_keys:
                raise ValueError(f"mask_keys: got {list(self.mask_keys)}; takes {mask!r}, of these keys, as well")
        for key in [*self.keys, *self.mask_keys]:
            shape = env.observation_space[key].shape or ()
            if len(shape) < 2 or shape[1] > total:
                raise ValueError(f"{key}: has shape {shape}; takes (n_agents, k, ...) with k up to total, {total}")
            one = env.observed.get(key)
            if one is not None and len(one.axes) < 2:
                raise ValueError(f"{key}: has axes {one.axes}; takes an observation with rows of several things")
        bare = [key for key in self.keys if key in env.observed and env.observed[key].present is None]
        self._marked = {*self.mask_keys, *bare}

    def observation(self, state: State) -> dict[str, jax.Array]:
        obs = dict(state.obs)
        for key in [*self.keys, *self.mask_keys]:
            x = state.obs[key]
            obs[key] = jnp.pad(x, [(0, 0), (0, self.total - x.shape[1])] + [(0, 0)] * (x.ndim - 2))
            if key in self._marked:
                real = jnp.arange(self.total) < x.shape[1]
                obs[_spoof(key)] = jnp.broadcast_to(real, obs[key].shape[:2])
        return obs

    def declared(self) -> dict[str, Observed]:
        table = dict(self.env.observed)
        for key in {*self.keys, *self.mask_keys} & set(table):
            one = table[key]
            axes = (one.axes[0], f"{one.axes[1]} of {self.total}", *one.axes[2:])
            present = _spoof(key) if key in self._marked and key not in self.mask_keys else one.present
            table[key] = replace(one, axes=axes, present=present)
            if key in self._marked:
                table[_spoof(key)] = Observed(axes[:2])
        return table


def _spoof(key: str) -> str:
    return f"{key}_spoof"


def _masks_of(env: Environment, keys: Sequence[str]) -> tuple[str, ...]:
    """Returns the observed masks of observations, those of a team's critic among them."""
    every = [env.observed[key] for key in keys if key in env.observed]
    named = [mask for one in every for mask in (one.present, one.seen, one.seen and f"team_{one.seen}") if mask]
    return tuple(mask for mask in dict.fromkeys(named) if mask in env.observation_space.spaces)


class AddConstantObservations(ObservationWrapper):
    """Adds observations that are the same in all worlds at all times.

    With them an environment observes what a policy of another game reads (Baker et al.'s transfer tasks).

    Args:
        env: environment to wrap.
        constants: by name, the declaration and the array, with a length for each declared axis and then the columns.

    Raises:
        ValueError: a name that is observed already, something that is no array of numbers, or one that does not fit its
            declaration.
    """

    def __init__(self, env: Environment, constants: Mapping[str, tuple[Observed, ArrayLike]]):
        super().__init__(env)
        self._declared: dict[str, Observed] = {}
        self._arrays: dict[str, np.ndarray] = {}
        if not isinstance(constants, Mapping) or not all(isinstance(name, str) for name in constants):
            raise ValueError(
                f"constants: got {described(constants)}; takes a dict by name, {{name: (Observed, array)}}"
            )
        for name, given in constants.items():
            if name in env.observation_space.spaces:
                raise ValueError(f"constants: got {name!r}, which is observed already; takes another name")
            if not (isinstance(given, tuple) and len(given) == 2 and isinstance(given[0], Observed)):
                raise ValueError(f"constants: got {described(given)} for {name!r}; takes (Observed(...), array)")
            self._declared[name] = given[0]
            self._arrays[name] = _constant(name, given[1])
        known = env.observed | self._declared
        for name, one in self._declared.items():
            for mask in filter(None, (one.present, one.seen)):
                if mask not in known:
                    raise ValueError(f"constants: got the mask {mask!r} for {name!r}; takes one of {sorted(known)}")
        shapes = {
            name: space.shape or () for name, space in env.observation_space.spaces.items() if name in env.observed
        }
        shapes |= {name: x.shape for name, x in self._arrays.items()}
        check_shapes(known, shapes, type(self).__name__)

    def observation(self, state: State) -> dict[str, jax.Array]:
        return state.obs | {name: jnp.asarray(x) for name, x in self._arrays.items()}

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | self._declared


def _constant(name: str, given: ArrayLike) -> np.ndarray:
    """An array as JAX has it: float32, int32 or bool.

    Raises:
        ValueError: something that is no array of finite numbers within these types.
    """
    try:
        array = np.asarray(given)
    except ValueError:
        array = np.asarray(None)
    if array.dtype.kind not in "biuf":
        raise ValueError(f"constants: got {described(given)} for {name!r}; takes an array of numbers")
    kind = {"f": np.float32, "b": np.bool_}.get(array.dtype.kind, np.int32)
    with np.errstate(over="ignore"):
        found: np.ndarray = array.astype(kind)
    if not np.isfinite(found).all() or (kind is np.int32 and (found != array).any()):
        raise ValueError(f"constants: got {described(given)} for {name!r}; takes finite numbers of 32 bits")
    return found


def check_names(observed: Mapping[str, object], names: Sequence[str]) -> None:
    """Refuses names that are not observed.

    Raises:
        ValueError: unknown names, which the message lists, or a text instead of a list of names.
    """
    if isinstance(names, str):
        raise ValueError(f"observations: got {names!r}; takes a list of names")
    unknown = [name for name in names if name not in observed]
    if unknown:
        raise ValueError(f"observations: got {unknown}; takes some of {sorted(observed)}")


def _about(one: Observed) -> tuple:
    return one.axes, one.private, one.critic, one.present, one.seen


def _distinct(columns: Sequence[tuple[str, Column]]) -> tuple[Column, ...]:
    """Returns the columns of several arrays; columns of equal names get the array's name in front."""
    names = [column.name for _, column in columns]
    return tuple(
        replace(column, name=f"{part} {column.name}") if names.count(column.name) > 1 else column
        for part, column in columns
    )
