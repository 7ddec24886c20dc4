"""What networks read of an environment: which arrays are an agent's own, which list entities, who may see what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.observed import AGENT, Observed
from maax_mjx.core.env import Environment

RAY = "ray"
CLIP = 5.0
"""Scales at which observations with a unit are cut off."""


class Features(struct.PyTreeNode):
    """Observations as networks read them; all arrays have leading axes such as (n_steps, n_worlds, n_agents).

    Attributes:
        own: (..., f) float32, what an agent knows of itself.
        rays: (..., n_rays, c) float32, lidar; c is 0 without.
        critic: (..., f) float32, what only critics know.
        entities: by kind (..., n, c) float32.
        seen: by kind (..., n) bool, what the agent's policy may use.
        known: by kind (..., n) bool, what its critic may use.
    """

    own: jax.Array
    rays: jax.Array
    critic: jax.Array
    entities: dict[str, jax.Array]
    seen: dict[str, jax.Array]
    known: dict[str, jax.Array]


@dataclass(frozen=True)
class Part:
    """One array of observations.

    Attributes:
        name: its name.
        axes: number of its axes after the agents', without that of entities or rays.
        columns: names of its numbers, its own columns or one for each of a plain array.
        scales: what its columns are divided by.
        clipped: which columns are cut off, those with a unit.
    """

    name: str
    axes: int
    columns: tuple[str, ...]
    scales: tuple[float, ...]
    clipped: tuple[bool, ...]

    @property
    def is_counted(self) -> bool:
        """Whether its columns are the numbers of a plain array of several axes, counted through."""
        return self.axes > 1 and self.columns == _counted(self.name, len(self.columns))

    def scaled(self, x: jax.Array) -> jax.Array:
        """Returns the array (..., c) in its columns' scales."""
        x = x.astype(jnp.float32) / jnp.asarray(self.scales, jnp.float32)
        return jnp.where(jnp.asarray(self.clipped), jnp.clip(x, -CLIP, CLIP), x)


@dataclass(frozen=True)
class Kind:
    """Entities of a kind.

    Attributes:
        name: the kind's name, such as "box".
        n: number of its slots.
        parts: arrays with a row per entity.
        present, seen, known: names of masks: what is in play, what the agent sees, what a team's critic knows.
    """

    name: str
    n: int
    parts: tuple[Part, ...]
    present: str | None
    seen: str | None
    known: str | None


@dataclass(frozen=True)
class Spec:
    """What networks read of an environment's observations; equal for environments that one policy can play.

    Attributes:
        own: arrays (n_agents, ...) of agents' own numbers.
        rays: arrays (n_agents, n_rays, c).
        critic: arrays only for critics.
        kinds: the entities.
        n_rays: number of rays; 0 without.
    """

    own: tuple[Part, ...]
    rays: tuple[Part, ...]
    critic: tuple[Part, ...]
    kinds: tuple[Kind, ...]
    n_rays: int = 0

    def columns(self) -> dict[str, tuple[str, ...]]:
        """Returns the names of all columns that a policy reads, by array."""
        parts = [*self.own, *self.rays, *(part for kind in self.kinds for part in kind.parts)]
        return {part.name: part.columns for part in parts}

    def in_scales_of(self, learnt: Spec) -> Spec:
        """Returns the same arrays in the scales of another game's, of those that both have."""
        known = {part.name: part for part in learnt._parts()}

        def scaled(parts: tuple[Part, ...]) -> tuple[Part, ...]:
            return tuple(
                replace(part, scales=known[part.name].scales)
                if part.name in known and known[part.name].columns == part.columns
                else part
                for part in parts
            )

        kinds = tuple(replace(kind, parts=scaled(kind.parts)) for kind in self.kinds)
        return replace(self, own=scaled(self.own), rays=scaled(self.rays), critic=scaled(self.critic), kinds=kinds)

    def _parts(self) -> list[Part]:
        return [*self.own, *self.rays, *self.critic, *(part for kind in self.kinds for part in kind.parts)]

    def shapes(self, n_agents: int) -> Features:
        """Returns the shapes and dtypes of one world's features."""

        def numbers(*shape: int, dtype: Any = jnp.float32) -> Any:
            return jax.ShapeDtypeStruct((n_agents, *shape), dtype)

        masks = {kind.name: numbers(kind.n, dtype=bool) for kind in self.kinds}
        return Features(
            own=numbers(sum(len(part.columns) for part in self.own)),
            rays=numbers(self.n_rays, sum(len(part.columns) for part in self.rays)),
            critic=numbers(sum(len(part.columns) for part in self.critic)),
            entities={kind.name: numbers(kind.n, sum(len(p.columns) for p in kind.parts)) for kind in self.kinds},
            seen=masks,
            known=dict(masks),
        )

    def features(self, obs: Mapping[str, jax.Array]) -> Features:
        """Returns observations (..., n_agents, ...) as networks read them."""
        first = obs[self.own[0].name]
        lead = first.shape[: first.ndim - self.own[0].axes]
        entities, seen, known = {}, {}, {}
        for kind in self.kinds:
            rows = [self._rows(part, obs, (*lead, kind.n)) for part in kind.parts]
            entities[kind.name] = jnp.concatenate(rows, axis=-1)
            there = obs[kind.present] > 0 if kind.present else jnp.ones((*lead, kind.n), bool)
            seen[kind.name] = there & (obs[kind.seen] > 0) if kind.seen else there
            known[kind.name] = there & (obs[kind.known] > 0) if kind.known else there
        return Features(
            own=_joined([self._rows(part, obs, lead) for part in self.own], lead),
            rays=_joined([self._rows(part, obs, (*lead, self.n_rays)) for part in self.rays], (*lead, self.n_rays)),
            critic=_joined([self._rows(part, obs, lead) for part in self.critic], lead),
            entities=entities,
            seen=seen,
            known=known,
        )

    def _rows(self, part: Part, obs: Mapping[str, jax.Array], lead: tuple[int, ...]) -> jax.Array:
        return part.scaled(obs[part.name].reshape(*lead, len(part.columns)))


def _joined(rows: list[jax.Array], lead: tuple[int, ...]) -> jax.Array:
    return jnp.concatenate(rows, axis=-1) if rows else jnp.zeros((*lead, 0), jnp.float32)


def spec_of(env: Environment) -> Spec:
    """Returns what networks read of an environment.

    Raises:
        ValueError: observations that do not belong to one agent each, such as a game's raw ones.
    """
    shapes = {name: x.shape for name, x in env.state_shape.obs.items()}
    table = {name: one for name, one in env.observed.items() if name in shapes}
    masks = {mask for one in table.values() for mask in (one.present, one.seen) if mask}
    own, rays, critic = [], [], []
    kinds: dict[str, list[Part]] = {}
    for name in sorted(table):
        one, shape = table[name], shapes[name]
        if not one.is_of_agents or not one.private:
            raise ValueError(
                f"env: got {name!r} in its observations, which belongs to no agent; takes an environment whose agents "
                "observe for themselves: --env.observations ego or split of a game, observations='ego' in Python, or "
                "SplitObservations(env); standard has neither, nor rewards"
            )
        if one.derived or 0 in shape or (name in masks and not one.columns):
            continue
        if one.critic:
            # Masks of what a team sees stand in for those of what an agent sees.
            if name.removeprefix("team_") not in masks:
                critic.append(_part(name, one, shape[1:]))
        elif one.axes == (AGENT,):
            own.append(_part(name, one, shape[1:]))
        elif one.axes == (AGENT, RAY):
            rays.append(_part(name, one, shape[2:]))
        elif len(one.axes) == 2:
            kinds.setdefault(one.axes[1], []).append(_part(name, one, shape[2:]))
        else:
            own.append(_part(name, one, shape[1:]))
    if not own:
        raise ValueError(f"env: got the observations {sorted(shapes)}; takes some of the agents themselves")
    listed = tuple(_kind(name, parts, table, shapes) for name, parts in kinds.items())
    return Spec(tuple(own), tuple(rays), tuple(critic), listed, shapes[rays[0].name][1] if rays else 0)


def _part(name: str, one: Observed, shape: tuple[int, ...]) -> Part:
    """Returns an array whose rows have a shape; columns that are scaled already have the scale 1."""
    n = 1
    for length in shape:
        n *= length
    if one.columns and len(one.columns) == n:
        scales, clipped = tuple(c.scale for c in one.columns), tuple(bool(c.unit) for c in one.columns)
        return Part(name, len(shape), one.names(), scales, clipped)
    return Part(name, len(shape), _counted(name, n), (1.0,) * n, (False,) * n)


def _counted(name: str, n: int) -> tuple[str, ...]:
    """Returns the names of the numbers of a plain array."""
    return tuple(f"{name} {i}" for i in range(n))


def _kind(name: str, parts: list[Part], table: Mapping[str, Observed], shapes: Mapping[str, Any]) -> Kind:
    declared = [table[part.name] for part in parts]
    present = next((one.present for one in declared if one.present), None)
    seen = next((one.seen for one in declared if one.seen), None)
    known = f"team_{seen}" if f"team_{seen}" in shapes else None
    return Kind(name, shapes[parts[0].name][1], tuple(parts), present, seen, known)
