"""Domain randomisation parameters as data (thesis 3.2.2, Appendix A)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.annotated import LARGEST
from maax_mjx.common.checks import array_words, check_choice, described, is_real_array, is_traced
from maax_mjx.common.keys import draw_integer, named_keys


@dataclass(frozen=True)
class Parameter:
    """The declaration of a parameter by a module.

    Attributes:
        name: name, unique within an environment, such as "n_boxes".
        default: (low, high) to draw from unless the params say otherwise; whole numbers for a count.
        bound: (low, high) that the compiled model can hold.
    """

    name: str
    default: tuple[float, float]
    bound: tuple[float, float]

    @property
    def dtype(self) -> Any:
        """Type of its values: int32 for a count, else the default float."""
        return jnp.int32 if all(isinstance(x, int) for x in self.default) else jnp.result_type(float)


@jax.tree_util.register_pytree_with_keys_class
class DomainParams(Mapping[str, jax.Array]):
    """A range (low, high), both included, for every parameter of an environment: a pytree that `reset` takes.

    Ranges are data: moving them never recompiles, and a batch may hold a different one for every world (leaves of
    shape (n_worlds, 2)).

    Example:
        ```python
        env = maax.make("hide_and_seek", n_boxes=(1, 4))  # at most four, for which there is room
        params = env.default_params.replace(n_boxes=(2, 4))
        state = env.reset(key, params)
        ```
    """

    def __init__(self, ranges: Mapping[str, Any]):
        if not isinstance(ranges, Mapping):
            raise ValueError(f"ranges: got {described(ranges)}; takes a dict from names to arrays (low, high)")
        self._ranges = dict(ranges)

    def replace(self, **ranges: Any) -> DomainParams:
        """Returns the params with some ranges changed; a single number is a range of one value.

        Raises:
            ValueError: an unknown name, values that are not numbers of 32 bits, or fractions for a count.
        """
        new = dict(self._ranges)
        for name, value in ranges.items():
            check_choice("DomainParams.replace", name, new)
            array = jnp.asarray(value if is_traced(value) else _numbers(name, value, new[name].dtype), new[name].dtype)
            new[name] = jnp.stack([array, array]) if array.ndim == 0 else array
        return DomainParams(new)

    def __getitem__(self, name: str) -> jax.Array:
        return self._ranges[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._ranges)

    def __len__(self) -> int:
        return len(self._ranges)

    def __repr__(self) -> str:
        return f"DomainParams({', '.join(f'{k}={v}' for k, v in self._ranges.items())})"

    def tree_flatten_with_keys(self) -> tuple[tuple, tuple[str, ...]]:
        names = tuple(sorted(self._ranges))
        return tuple((jax.tree_util.DictKey(n), self._ranges[n]) for n in names), names

    @classmethod
    def tree_unflatten(cls, names: tuple[str, ...], leaves: tuple) -> DomainParams:
        return cls(dict(zip(names, leaves, strict=True)))

    def draw_counts(self, key: jax.Array, names: Iterable[str]) -> jax.Array:
        """Draws (n,) int32, uniform over the ranges of the named parameters, each with a key of its own name."""
        names = list(names)
        low, high = jnp.stack([self._ranges[name] for name in names], axis=1)
        return jax.vmap(draw_integer)(named_keys(key, names), low, high)

    def draw(self, key: jax.Array, name: str) -> jax.Array:
        """Draws a number, () float, uniform over the parameter's range."""
        low, high = self._ranges[name]
        return low + (high - low) * jax.random.uniform(key)


def _numbers(name: str, value: Any, dtype: Any) -> np.ndarray:
    """Returns a number, a range or an array of ranges as an array that fits the type."""
    whole = dtype == jnp.int32
    try:
        array = np.asarray(value)
    except ValueError:  # Rows of unequal lengths.
        array = np.asarray(None)
    most = LARGEST[int if whole else float]
    if array.dtype.kind not in ("iu" if whole else "iuf") or _beyond(array, most):
        what = "whole number" if whole else "number"
        raise ValueError(f"{name}: got {value!r}; takes a {what} of 32 bits, or (low, high) of {what}s")
    return array


def _beyond(array: np.ndarray, most: float) -> bool:
    finite = array[np.isfinite(array)]
    return bool(((finite > most) | (finite < -most)).any())


def default_params(parameters: Mapping[str, Parameter]) -> DomainParams:
    """Returns the default range of every declared parameter."""
    return DomainParams({name: jnp.array(p.default, p.dtype) for name, p in parameters.items()})


def params_in_bounds(params: DomainParams, parameters: Mapping[str, Parameter]) -> jax.Array:
    """Whether every range lies in its bound and is not reversed: () bool. Traceable."""
    ok = [
        (p.bound[0] <= params[name][0]) & (params[name][0] <= params[name][1]) & (params[name][1] <= p.bound[1])
        for name, p in parameters.items()
    ]
    return jnp.all(jnp.stack([jnp.asarray(v) for v in ok])) if ok else jnp.ones((), bool)


def check_params(params: DomainParams, parameters: Mapping[str, Parameter], lead: tuple[int, ...] = ()) -> None:
    """Refuses params that belong to other parameters or leave their bounds.

    Values are checked only outside traced code.

    Args:
        params: ranges with leaves (2,) or (*lead, 2).
        parameters: declarations, by name.
        lead: (n_worlds,) where every world may have a range of its own.

    Raises:
        ValueError: wrong params; the message names the parameter, its value and its bound.
    """
    if not isinstance(params, DomainParams):
        raise ValueError(f"params: got {type(params).__name__}; takes env.default_params, changed with .replace(...)")
    if set(params) != set(parameters):
        raise ValueError(f"params: got ranges for {sorted(params)}; takes exactly {sorted(parameters)}")
    for name, p in parameters.items():
        if not is_real_array(params[name]):
            raise ValueError(
                f"params: {name} is {array_words(params[name])}; takes an array, as .replace(...) makes it"
            )
        if jnp.shape(params[name]) not in ((2,), (*lead, 2)):
            takes = " or ".join(map(str, dict.fromkeys([(2,), (*lead, 2)])))
            raise ValueError(f"params: {name} has shape {jnp.shape(params[name])}; takes {takes}")
        kind = jnp.integer if p.dtype == jnp.int32 else jnp.floating
        if not jnp.issubdtype(jnp.result_type(params[name]), kind):
            got = jnp.result_type(params[name]) if is_traced(params[name]) else np.asarray(params[name]).tolist()
            what = "whole numbers" if p.dtype == jnp.int32 else "floats"
            raise ValueError(f"params: {name} is {got}; takes {what}")
        if is_traced(params[name]):
            continue
        value = np.asarray(params[name]).reshape(-1, 2)
        # Written so that NaN counts as wrong.
        wrong = ~((value[:, 0] <= value[:, 1]) & (value[:, 0] >= p.bound[0]) & (value[:, 1] <= p.bound[1]))
        if wrong.any():
            low, high = value[wrong.argmax()]
            raise ValueError(
                f"params: {name} is ({low}, {high}); takes (low, high) with "
                f"{p.bound[0]} <= low <= high <= {p.bound[1]}, the maximum the environment was built with"
            )
