"""Observations as policies want them: per agent, padded, selected, joined, flat."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.arrays import shown
from maax_mjx.common.checks import check_choice, check_count
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.teams import TeamMembership
from maax_mjx.wrappers.wrapper import ObservationWrapper


class SplitObservations(ObservationWrapper):
    """Gives every agent observations of its own: every array's first axis becomes the agents' (Baker et al.).

    Where agent i sees others, they stand in circulant order: i - 1, i - 2, ... modulo n_agents.

    Args:
        env: what to wrap.
        own: what agents know of themselves and see of others, (n_agents, d): becomes `<name>_self` (n_agents, d) and
            `<name>` (n_agents, n_agents - 1, d).
        matrices: of agents by agents, (n_agents, n_agents): becomes (n_agents, n_agents - 1), without oneself.
        copies: what is per agent already and stays.
        external: what all agents share, (k, ...): becomes (n_agents, k, ...). None is everything else.

    Raises:
        ValueError: a name that is not observed, is given twice, or whose first axis is not the agents'.
    """

    name = "split_observations"

    def __init__(
        self,
        env: Environment,
        own: Sequence[str],
        matrices: Sequence[str] = (),
        copies: Sequence[str] = (),
        external: Sequence[str] | None = None,
    ):
        super().__init__(env)
        n = env.base.n_agents
        observed = env.observation_space.spaces
        named = [*own, *matrices, *copies]
        self.own, self.matrices, self.copies = tuple(own), tuple(matrices), tuple(copies)
        self.external = tuple(k for k in observed if k not in named) if external is None else tuple(external)
        everything = [*named, *self.external]
        _check_names(observed, everything)
        if len(set(everything)) < len(everything):
            twice = sorted({k for k in everything if everything.count(k) > 1})
            raise ValueError(f"own, matrices, copies, external: got {twice} twice; each takes others")
        for key in named:
            shape = observed[key].shape or ()
            want = (n, n) if key in self.matrices else (n, *shape[1:])
            if shape != want:
                raise ValueError(f"{key}: has shape {shape}; takes {want} here, the first axis the agents'")
        self._others = (np.arange(n)[:, None] - np.arange(1, n)) % n

    def observation(self, state: State) -> dict[str, jax.Array]:
        obs, n = state.obs, self.base.n_agents
        split = {f"{key}_self": obs[key] for key in self.own} | {key: obs[key][self._others] for key in self.own}
        split |= {key: obs[key][np.arange(n)[:, None], self._others] for key in self.matrices}
        split |= {key: obs[key] for key in self.copies}
        return split | {key: jnp.broadcast_to(obs[key], (n, *obs[key].shape)) for key in self.external}


class SpoofEntities(ObservationWrapper):
    """Pads entities to a fixed number, so that one policy serves worlds of different sizes (Baker et al.).

    Args:
        env: what to wrap; its observations are split.
        total: how many entities there are to be.
        keys: observations (n_agents, k, ...): padded with zeros to (n_agents, total, ...).
        mask_keys: masks (n_agents, k): padded with False; `<name>_spoof` (n_agents, total) is False for padding.

    Raises:
        ValueError: a name that is not observed, or of more entities than `total`.
    """

    def __init__(self, env: Environment, total: int, keys: Sequence[str], mask_keys: Sequence[str] = ()):
        super().__init__(env)
        self.total = check_count("total", total, minimum=1)
        self.keys, self.mask_keys = tuple(keys), tuple(mask_keys)
        _check_names(env.observation_space.spaces, [*keys, *mask_keys])
        for key in [*keys, *mask_keys]:
            shape = env.observation_space[key].shape or ()
            if len(shape) < 2 or shape[1] > total:
                raise ValueError(f"{key}: has shape {shape}; takes (n_agents, k, ...) with k up to total, {total}")

    def observation(self, state: State) -> dict[str, jax.Array]:
        obs = dict(state.obs)
        for key in [*self.keys, *self.mask_keys]:
            x = state.obs[key]
            obs[key] = jnp.pad(x, [(0, 0), (0, self.total - x.shape[1])] + [(0, 0)] * (x.ndim - 2))
            if key in self.mask_keys:
                real = jnp.arange(self.total) < x.shape[1]
                obs[f"{key}_spoof"] = jnp.broadcast_to(real, obs[key].shape)
        return obs


class SelectObservations(ObservationWrapper):
    """Keeps some observations.

    Args:
        env: what to wrap.
        keys: their names.

    Raises:
        ValueError: a name that is not observed.
    """

    def __init__(self, env: Environment, keys: Sequence[str]):
        super().__init__(env)
        self.keys = tuple(keys)
        _check_names(env.observation_space.spaces, self.keys)

    def observation(self, state: State) -> dict[str, jax.Array]:
        return {key: state.obs[key] for key in self.keys}


class ConcatenateObservations(ObservationWrapper):
    """Joins observations along their last axis; the parts are left out.

    Args:
        env: what to wrap.
        joined: by the new name, the names of its parts, of equal shape but for the last axis.

    Raises:
        ValueError: a name that is not observed, or parts that do not fit each other.
    """

    def __init__(self, env: Environment, joined: Mapping[str, Sequence[str]]):
        super().__init__(env)
        self.joined = {name: tuple(parts) for name, parts in joined.items()}
        for name, parts in self.joined.items():
            _check_names(env.observation_space.spaces, parts)
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


class MaskObservations(ObservationWrapper):
    """Hides what an agent does not see: zeros instead, as for what is not in play.

    For policies without attention, which can make no use of masks.

    Args:
        env: what to wrap; its observations are split.
        masks: by observation (n_agents, k, ...), the mask (n_agents, k) of what is shown, such as
            `{"box_obs": "sees_boxes"}`. Masks stay.

    Raises:
        ValueError: a name that is not observed, or shapes that do not fit.
    """

    def __init__(self, env: Environment, masks: Mapping[str, str]):
        super().__init__(env)
        self.masks = _checked_masks(env, masks)

    def observation(self, state: State) -> dict[str, jax.Array]:
        return _masked(state.obs, self.masks)


class FlattenObservations(ObservationWrapper):
    """One vector for every agent: `obs` (n_agents, d), of all observations by name in order, flat, as float32.

    For a central critic, `privileged` (n_agents, n_agents * d) is the vectors of oneself and of others, in the
    circulant order of `SplitObservations`, with what `masks` hide in `obs`; zeros stand for those who are not in play
    or not in one's team.

    Args:
        env: what to wrap; its observations are split, so that all have the agents' axis first.
        observe: "self" (no privileged observation), "team" or "all": whose observations are privileged.
        masks: what `obs` alone hides: see `MaskObservations`.

    Raises:
        ValueError: they are not split; an unknown `observe`, or "team" without `TeamMembership`; masks that do not fit.
    """

    requires = (SplitObservations,)

    def __init__(self, env: Environment, observe: str = "self", masks: Mapping[str, str] | None = None):
        super().__init__(env)
        self.observe = check_choice("observe", observe, ("self", "team", "all"))
        self.masks = _checked_masks(env, masks or {})
        n = self.base.n_agents
        for key, space in env.observation_space.spaces.items():
            if (space.shape or (0,))[0] != n:
                raise ValueError(
                    f"FlattenObservations: {key!r} has shape {space.shape}; takes ({n}, ...) with the agents' axis "
                    "first: add it inside SplitObservations, or leave it out with SelectObservations"
                )
        self._order = (np.arange(n)[:, None] - np.arange(n)) % n
        self._shown = np.ones((n, n), bool)
        if observe == "team":
            team = self.inner(TeamMembership).team_index
            self._shown = team[self._order] == team[:, None]

    def observation(self, state: State) -> dict[str, jax.Array]:
        obs = {"obs": _flat(_masked(state.obs, self.masks))}
        if self.observe != "self":
            shown_to = self._shown & self.playing(state)[self._order]
            privileged = jnp.where(shown_to[..., None], _flat(state.obs)[self._order], 0.0)
            obs["privileged"] = privileged.reshape(self.base.n_agents, -1)
        return obs


def _flat(obs: Mapping[str, jax.Array]) -> jax.Array:
    """(n_agents, d), by name in order."""
    return jnp.concatenate([obs[key].reshape(len(obs[key]), -1).astype(jnp.float32) for key in sorted(obs)], axis=1)


def _masked(obs: Mapping[str, jax.Array], masks: Mapping[str, str]) -> dict[str, jax.Array]:
    return {**obs} | {key: shown(obs[key], obs[mask] > 0) for key, mask in masks.items()}


def _checked_masks(env: Environment, masks: Mapping[str, str]) -> dict[str, str]:
    """Masks by observation, where both are observed and fit each other."""
    observed = env.observation_space.spaces
    for key, mask in masks.items():
        for name in (key, mask):
            check_choice("masks", name, observed)
        shape, takes = observed[mask].shape or (), (observed[key].shape or ())[:2]
        if shape != takes:
            raise ValueError(f"masks: {mask!r} has shape {shape}; takes {takes} for {key!r}")
    return dict(masks)


def _check_names(observed: Mapping[str, object], names: Sequence[str]) -> None:
    unknown = [name for name in names if name not in observed]
    if unknown:
        raise ValueError(f"observations: got {unknown}; takes some of {sorted(observed)}")
