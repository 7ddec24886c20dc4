"""What a policy of one game knows that helps in another, whose observations and actions differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from maax_mjx.training.nets import FILTERS
from maax_mjx.training.network import Moments, Network, Weights
from maax_mjx.training.spec import Part, Spec

Rows = Sequence[tuple[str, str]]
"""Names of the rows of a kernel: of an array and of one of its columns."""


def transferred(weights: Weights, old: Network, new: Network, drawn: Weights) -> Weights:
    """Returns the weights of one game's networks for another's.

    Whatever both have is taken over, by its name: layers, and in the first ones the rows of each column. A column that
    only the new game has counts for nothing at first. Kinds of entities and layers that only it has are as drawn; so
    are the last layers, and the layer norms before them, as where Baker et al. fine-tune their policies.

    Args:
        weights: of the old game.
        old: its networks, which pool or attend over entities.
        new: the new game's, of the same form.
        drawn: weights of the new game; the critic stays as drawn if the old one is missing.

    Raises:
        ValueError: networks with parameters for other teams.
    """
    actor = _tower(weights.actor, drawn.actor, old, new, critic=False)
    critic = _tower(weights.critic, drawn.critic, old, new, critic=True) if weights.critic else drawn.critic
    norm = drawn.norm
    if isinstance(norm, Moments):
        norm = _moments(weights.norm, norm, old.spec, new.spec)
    return Weights(actor, critic, norm)


def _tower(
    known: Mapping[str, Any], drawn: Mapping[str, Any], old: Network, new: Network, *, critic: bool
) -> dict[str, Any]:
    if set(known) != set(drawn):
        raise ValueError(
            f"begin_from (--from): got a policy with parameters for {sorted(known)}, and the run has {sorted(drawn)}; "
            "takes a policy of the same teams, or one whose agents share parameters (net.share=all)"
        )
    rows_were, rows_are = _rows(old, critic), _rows(new, critic)
    last = {head.name for head in new.heads} | {"value", "norm hidden" if new.net.core == "none" else "norm out"}

    def layer(name: str, was: Any, fresh: Any) -> Any:
        if was is None or any(name == one or name.startswith(f"{one} ") for one in last):
            return fresh
        if name in rows_are:
            kernel = _by_row(was["kernel"], rows_were[name], rows_are[name])
            return {**fresh, **was, "kernel": kernel}
        same = jax.tree.map(jnp.shape, was) == jax.tree.map(jnp.shape, fresh)
        return was if same else fresh

    return {
        group: {name: layer(name, known[group].get(name), fresh) for name, fresh in layers.items()}
        for group, layers in drawn.items()
    }


def _rows(network: Network, critic: bool) -> dict[str, Rows]:
    """Returns the names of the rows of the first layers' kernels, in order, as `Tower` joins them."""
    spec = network.spec
    lidar = [(part.name, f"{ray} {i}") for part in spec.rays for ray in range(spec.n_rays) for i in range(FILTERS)]
    own = [*_columns(spec.own), *lidar, *(_columns(spec.critic) if critic else ())]
    rows = {"embed own": own} | {f"embed {kind.name}": _columns(kind.parts) for kind in spec.kinds}
    # Published, all that the agent observes is joined to every entity; elsewhere its embedding is.
    attends = network.net.encoder == "attend"
    return rows | ({f"embed own for {kind.name}": own for kind in spec.kinds} if attends else {})


def _columns(parts: Sequence[Part]) -> Rows:
    return [(part.name, name) for part in parts for name in _names(part)]


def _names(part: Part) -> Sequence[str]:
    """Names of an array's columns, by which those of another game are found.

    In a counted array of another size, such as who sees whom, the same count is another number.
    """
    return [f"{column} of {len(part.columns)}" for column in part.columns] if part.is_counted else part.columns


def _by_row(was: jax.Array, names_were: Rows, names_are: Rows, new: float | jax.Array = 0.0) -> jax.Array:
    """Returns rows (n, ...) by name, filled with a number where they are new."""
    at = {name: i for i, name in enumerate(names_were)}
    found = jnp.asarray([at.get(name, len(names_were)) for name in names_are], jnp.int32)
    return jnp.concatenate([jnp.asarray(was), jnp.full((1, *was.shape[1:]), new, was.dtype)])[found]


def _moments(was: Moments, fresh: Moments, old: Spec, new: Spec) -> Moments:
    """Returns the moments of the columns that both have; those of the others are those of numbers in their scales."""

    def names(spec: Spec) -> dict[str, Rows]:
        plain = {"own": spec.own, "rays": spec.rays, "critic": spec.critic}
        return {name: _columns(parts) for name, parts in plain.items()} | {
            f"entities {kind.name}": _columns(kind.parts) for kind in spec.kinds
        }

    were, are = names(old), names(new)

    def of(known: Mapping[str, jax.Array], value: float | jax.Array) -> dict[str, jax.Array]:
        none = jnp.zeros(0)
        return {name: _by_row(known.get(name, none), were.get(name, ()), are[name], value) for name in fresh.mean}

    return Moments(of(was.mean, 0.0), of(was.square, was.weight), jnp.asarray(was.weight))
