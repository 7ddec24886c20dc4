"""Observations with zeros in place of what is not seen, and as one vector per agent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp

from maax_mjx.common.arrays import shown
from maax_mjx.common.checks import check_choice
from maax_mjx.common.observed import AGENT, Column, Observed, flag
from maax_mjx.core.describe import Description
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.critic import CriticObservations
from maax_mjx.wrappers.ego import EgocentricObservations
from maax_mjx.wrappers.split import SplitObservations, declared_table
from maax_mjx.wrappers.wrapper import ObservationWrapper, find


class MaskObservations(ObservationWrapper):
    """Replaces what an agent does not see by zeros, as for entities that are not in play.

    For policies without attention, which cannot use masks.

    Args:
        env: environment to wrap, with split observations.
        masks: by the name of an observation (n_agents, k, ...), the name of its mask (n_agents, k), such as
            `{"box_obs": "sees_box"}`; None uses the declared masks. The masks stay observed.

    Raises:
        ValueError: observations that are not split, a name that is not observed, or shapes that do not fit.
    """

    requires = (SplitObservations,)

    def __init__(self, env: Environment, masks: Mapping[str, str] | None = None):
        super().__init__(env)
        self.masks = _seen_masks(env.observed) if masks is None else dict(masks)
        observed = env.observation_space.spaces
        for key, mask in self.masks.items():
            for name in (key, mask):
                check_choice("masks", name, observed)
            shape, takes = observed[mask].shape or (), (observed[key].shape or ())[:2]
            if shape != takes:
                raise ValueError(f"masks: {mask!r} has shape {shape}; takes {takes} for {key!r}")

    def observation(self, state: State) -> dict[str, jax.Array]:
        return _masked(state.obs, self.masks)


class FlattenObservations(ObservationWrapper):
    """Concatenates all observations, sorted by name, into one vector per agent: `obs` (n_agents, d) float32.

    What an agent does not see, by the declared masks, is zero, and so is its place in `obs_mask` (n_agents, d) bool;
    `env.observed["obs"].names()` are the names of the columns. With `CriticObservations` inside it adds `critic`
    (n_agents, d + k): the same numbers without these masks (for a team's critic: with the masks of what its team
    sees), followed by the observations for critics only.

    Args:
        env: environment to wrap, with split observations.

    Raises:
        ValueError: observations that are not split or not declared, or that were added outside of `SplitObservations`
            and do not have the agents' axis first.
    """

    requires = (SplitObservations,)
    follows = (CriticObservations, EgocentricObservations, MaskObservations)

    def __init__(self, env: Environment):
        super().__init__(env)
        if find(env, FlattenObservations) is not None:
            raise ValueError("FlattenObservations: got an environment with one; takes it once")
        table = declared_table(env, "FlattenObservations", masks=("seen",))
        for name, one in table.items():
            if not one.is_of_agents:
                raise ValueError(
                    f"FlattenObservations: {name!r} has axes {one.axes}; takes the agents' axis first: add it inside "
                    "SplitObservations, or leave it out with SelectObservations"
                )
        self._shapes = {name: space.shape or () for name, space in env.observation_space.spaces.items()}
        self._table = dict(sorted(table.items()))
        self._seen = _seen_masks(self._table)
        self._policys = [name for name, one in self._table.items() if not one.critic]
        self._critics = [name for name, one in self._table.items() if one.critic]
        critic = find(env, CriticObservations)
        self._critic = None if critic is None else critic.of
        self._teams = {name: f"team_{mask}" for name, mask in self._seen.items()} if self._critic == "team" else {}
        for name, mask in self._teams.items():
            if mask not in table:
                raise ValueError(
                    f"FlattenObservations: {mask!r}, by which a team's critic sees {name!r}, is not observed; takes it "
                    "as well, in SelectObservations"
                )

    def observation(self, state: State) -> dict[str, jax.Array]:
        mask = self._mask(state)
        # Of agents that are not in play nothing is left, either.
        seen = jnp.where(mask, _flat(_masked(state.obs, self._seen), self._policys), 0.0)
        obs = {"obs": seen, "obs_mask": mask}
        if self._critic is not None:
            whole = _flat(_masked(state.obs, self._teams), self._policys)
            obs["critic"] = jnp.concatenate([whole, _flat(state.obs, self._critics)], axis=1)
        return obs

    def _mask(self, state: State) -> jax.Array:
        """Returns which numbers of the vectors are seen by an agent in play: (n_agents, d) bool."""
        ones = {name: jnp.ones(self._shapes[name], bool) for name in self._policys}
        ones = {name: shown(x, self.playing(state)) for name, x in ones.items()}
        masks = {name: state.obs[mask] > 0 for name, mask in self._seen.items()}
        parts = [shown(x, masks[name]) if name in masks else x for name, x in ones.items()]
        return jnp.concatenate([x.reshape(len(x), -1) for x in parts], axis=1)

    def declared(self) -> dict[str, Observed]:
        columns = self._columns(self._policys)
        table = {"obs": Observed((AGENT,), columns), "obs_mask": Observed((AGENT,), flag(*(c.name for c in columns)))}
        if self._critic is not None:
            table["critic"] = Observed((AGENT,), columns + self._columns(self._critics), critic=True)
        return table

    def describe(self) -> Description:
        """Makes the table of the vectors, followed by that of the arrays in them."""
        parts = (row._replace(name=f"  {row.name}") for row in self.env.describe())
        return Description((*super().describe(), *parts))

    def _columns(self, names: list[str]) -> tuple[Column, ...]:
        """Returns the columns of the flat vector: "box_obs[0] x", "sees_box[1]", ..."""
        columns: list[Column] = []
        for name in names:
            own = self._table[name].columns
            lengths = self._shapes[name][1 : len(self._table[name].axes)]
            for index in product(*(range(n) for n in lengths)):
                place = name + "".join(f"[{i}]" for i in index)
                columns += [replace(c, name=f"{place} {c.name}") for c in own] if own else [Column(place)]
        return tuple(columns)


def _flat(obs: Mapping[str, jax.Array], names: list[str]) -> jax.Array:
    """Concatenates some observations into (n_agents, d)."""
    return jnp.concatenate([obs[name].reshape(len(obs[name]), -1).astype(jnp.float32) for name in names], axis=1)


def _seen_masks(table: Mapping[str, Observed]) -> dict[str, str]:
    """Returns the `seen` mask of every observation that has one, by name."""
    return {name: one.seen for name, one in table.items() if one.seen and one.columns and not one.critic}


def _masked(obs: Mapping[str, jax.Array], masks: Mapping[str, str]) -> dict[str, jax.Array]:
    return {**obs} | {key: shown(obs[key], obs[mask] > 0) for key, mask in masks.items()}
