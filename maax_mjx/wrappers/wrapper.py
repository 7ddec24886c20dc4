"""The base classes of wrappers, with Gymnasium's semantics, on the state after the step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

import jax
import jax.numpy as jnp
from gymnasium import spaces

from maax_mjx.common.arrays import null_rows
from maax_mjx.common.checks import array_words, described
from maax_mjx.common.observed import Observed, check_arrays
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Base, Environment, check_environment
from maax_mjx.core.state import State, check_returned
from maax_mjx.core.teams import Team
from maax_mjx.modules import Placed

W = TypeVar("W", bound="Wrapper")
P = TypeVar("P", bound=Placed)


class _NotGiven:
    """What a wrapper's `env` is before `Wrapper.__init__` sets it."""

    def __get__(self, wrapper: Any, kind: type) -> Any:
        if wrapper is None:
            return self
        raise AttributeError(f"env: {kind.__name__} has none; takes a first line super().__init__(env) in its __init__")


class Wrapper(Environment):
    """An environment around another. Subclass one of its kinds, or this class to override `begin` and `transition`.

    Wrapping does not change the given environment: a wrapper that needs modules adds them to a copy.

    Wrappers are pure: a wrapper keeps its memory of a world in `state.mechanics[self.name]`, a pytree of its own. It
    reads everything else from `state.data`, `state.world` and `state.mechanics`, never from observations, which a
    wrapper in between may have changed.

    Args:
        env: environment to wrap.

    Attributes:
        name: of its memory in `state.mechanics`; "" for a wrapper without.
        requires: kinds of wrappers that must be inside this one.
        precedes, follows: kinds that must be outside this one, or inside it, if present.
        everyone_for_itself: whether the agents of one team play against each other, which `training.evaluate` needs to
            know.

    Raises:
        ValueError: `env` is not an environment, lacks a wrapper that this one requires, or has one that must be
            outside this one or has its name.
    """

    env: Environment = _NotGiven()  # type: ignore[assignment]
    name: str = ""
    requires: ClassVar[tuple[type[Wrapper], ...]] = ()
    precedes: ClassVar[tuple[type[Wrapper], ...]] = ()
    follows: ClassVar[tuple[type[Wrapper], ...]] = ()
    everyone_for_itself: ClassVar[bool] = False

    def __init__(self, env: Environment):
        self.env = check_environment(env)
        mine = type(self).__name__
        _check_implemented(self)
        for kind in self.requires:
            self.inner(kind)
        for layer in env.layers:
            if isinstance(layer, self.precedes) or isinstance(self, layer.follows):
                other = type(layer).__name__
                raise ValueError(
                    f"{mine}: env has {other} already; wrap with {mine} before it: {other}({mine}(env, ...)), or with "
                    f'a game, maax.make("...", inside={{"{other}": maax.{mine}}})'
                )
        if self.name and any(layer.name == self.name for layer in env.layers):
            raise ValueError(f"{mine}: env has a wrapper named {self.name!r} already; takes one of each")
        env.base.around.add(self)

    @property
    def base(self) -> Base:
        return self.env.base

    @property
    def layers(self) -> tuple[Any, ...]:
        return self, *self.env.layers

    @property
    def given(self) -> Environment:
        """The environment that was given, which is not `self.env` where the wrapper works on a copy."""
        return next((x for x in self.made_with.values if isinstance(x, Environment)), self.env)

    @property
    def action_space(self) -> spaces.Dict:
        return self.env.action_space

    @property
    def acts_on(self) -> dict[str, tuple[tuple[str, int], ...]]:
        return self.env.acts_on

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        return self.env.begin(key, params)

    def transition(self, state: State, action: Any) -> State:
        return self.env.advance(state, action)

    @property
    def n_agents(self) -> int:  # type: ignore[override]
        return self.base.n_agents

    @property
    def teams(self) -> dict[str, Team]:
        return self.env.teams

    def declared(self) -> dict[str, Observed]:
        """Returns all declarations; a wrapper that adds some returns `self.env.declared() | {name: Observed(...)}`."""
        return self.env.declared()

    def add_module(self, module: Any) -> None:
        """Refuses a module: what is in the world is settled before it is wrapped.

        Raises:
            ValueError: always; the message says how a game gets another module.
        """
        raise ValueError(
            f"add_module: got {type(module).__name__} for {type(self).__name__}, which is wrapped around its world; "
            'takes modules with the game, maax.make("tag", modules=[...]), or before the first wrapper'
        )

    def inner(self, kind: type[W]) -> W:
        """Returns the wrapper of a kind inside this one.

        Raises:
            ValueError: no such wrapper.
        """
        found = find(self.env, kind)
        if found is None:
            mine, other = type(self).__name__, kind.__name__
            raise ValueError(f"{mine}: needs {other}; wrap with it first: {mine}({other}(env, ...))")
        return found

    def module_of(self, kind: type[P]) -> P:
        """Returns the environment's first module of a kind that has any things.

        Raises:
            ValueError: no such module.
        """
        found = next((m for m in self.base.modules.values() if isinstance(m, kind) and m.n_max), None)
        if found is None:
            mine, one = type(self).__name__, kind.__name__
            raise ValueError(f"env: got {self.env!r}, without {one}; {mine} takes one with {one}")
        return found

    def remember(self, state: State, memory: Any) -> State:
        """Returns the state with this wrapper's memory replaced.

        Raises:
            ValueError: the wrapper has no name, or its memory had other shapes or types before.
        """
        mine = type(self).__name__
        if not self.name:
            raise ValueError(
                f"remember: {mine} has no name, under which its memory is kept; takes a text of its own, in the class: "
                f"name = {mine.lower()!r}"
            )
        if self.name in state.mechanics:
            was, now = _forms(state.mechanics[self.name]), _forms(memory)
            for at in dict.fromkeys((*was, *now)):
                if was.get(at) != now.get(at):
                    raise ValueError(
                        f"remember: got {now.get(at, 'nothing')} as the memory{at} of {mine}, which was "
                        f"{was.get(at, 'not there')} before; takes the same shapes and types at every step"
                    )
        return state.replace(mechanics=state.mechanics | {self.name: memory})

    def playing(self, state: State) -> jax.Array:
        """Returns which agents are in play: (n_agents,) bool."""
        return state.active

    @property
    def senses(self) -> tuple[str, ...]:
        """Names of observations (n_agents, ...) that are senses, which `blind` zeroes."""
        return ()

    def blind(self, state: State, who: jax.Array) -> State:
        """Zeroes what the agents in `who` (n_agents,) bool sense through this wrapper.

        Raises:
            ValueError: its senses are not observed any more, or in another shape.
        """
        self.check_senses({name: array.shape for name, array in state.obs.items()})
        kept = {key: state.obs[key] for key in self.senses}
        return state.replace(obs=state.obs | null_rows(kept, who))

    def check_senses(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        """Refuses observations in which its senses were hidden or changed, so that `blind` cannot zero them.

        Args:
            shapes: shapes of the observations, by name.

        Raises:
            ValueError: such observations.
        """
        mine = type(self).__name__
        for name in self.senses:
            was, now = self.observation_space[name].shape, shapes.get(name)
            if now is None:
                raise ValueError(
                    f"blind: {name!r} of {mine} is not observed any more; put what blinds inside what hid it, such as "
                    "FlattenObservations"
                )
            if now != was:
                raise ValueError(
                    f"blind: {name!r} of {mine} has shape {now}, and had {was}; put what blinds inside what changed it"
                )


class ActionWrapper(Wrapper):
    """Changes actions before the step: implement `action`, and `action_space` if it differs."""

    def action(self, state: State, action: Any) -> Any:
        """Returns the inner environment's action, from the state before the step and this wrapper's action."""
        raise NotImplementedError

    def transition(self, state: State, action: Any) -> State:
        inner = self.action(state, action)
        if not isinstance(inner, Mapping):
            raise ValueError(
                f"action: {type(self).__name__} returned {described(inner)}; takes the action of what it wraps, a dict "
                f"of {sorted(self.env.action_space.spaces)}"
            )
        for name, space in self.env.action_space.spaces.items():
            if name not in inner and name in action:
                raise ValueError(
                    f"action: {type(self).__name__} returned an action without {name!r}, which it got; takes all of "
                    f"what it wraps, {sorted(self.env.action_space.spaces)}"
                )
            if name in inner and jnp.shape(inner[name]) != space.shape:
                raise ValueError(
                    f"action: {type(self).__name__} returned {name!r} of shape {jnp.shape(inner[name])}; takes "
                    f"{space.shape}, as what it wraps"
                )
        return self.env.advance(state, inner)


class StateWrapper(Wrapper):
    """Adds to the states after resets and steps: implement `observe`."""

    def observe(self, state: State) -> State:
        """Returns the state with what this wrapper adds: observations, memory, metrics."""
        raise NotImplementedError

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        return check_returned("observe", self, self.observe(self.env.begun(key, params)))

    def transition(self, state: State, action: Any) -> State:
        return check_returned("observe", self, self.observe(self.env.advance(state, action)))


class ObservationWrapper(StateWrapper):
    """Changes observations: implement `observation`, and `declared` for added ones. The space follows."""

    def observation(self, state: State) -> dict[str, jax.Array]:
        """Returns the observations of a state after a reset or step, whose `obs` are the inner environment's."""
        raise NotImplementedError

    def observe(self, state: State) -> State:
        return state.replace(obs=check_arrays(self.observation(state), "observation", type(self).__name__))


class RewardWrapper(Wrapper):
    """Changes rewards: implement `reward`."""

    def reward(self, state: State) -> jax.Array:
        """Returns (n_agents,) rewards of a state after a step, whose `reward` is the inner environment's.

        Whole numbers and booleans count as floats.
        """
        raise NotImplementedError

    def transition(self, state: State, action: Any) -> State:
        state = self.env.advance(state, action)
        reward = self.reward(state)
        if reward is None or jnp.shape(reward) != (self.n_agents,):
            got = array_words(reward) if hasattr(reward, "dtype") else described(reward)
            raise ValueError(
                f"reward: {type(self).__name__} returned {got}; takes an array {(self.n_agents,)}, one number for each "
                "agent"
            )
        return state.replace(reward=jnp.asarray(reward, state.reward.dtype))


IMPLEMENTED: tuple[tuple[type[Wrapper], str, tuple[str, ...]], ...] = (
    (ActionWrapper, "action", ("transition",)),
    (ObservationWrapper, "observation", ("observe",)),
    (StateWrapper, "observe", ("begin", "transition")),
    (RewardWrapper, "reward", ("transition",)),
)
"""Kinds of wrappers, the method that a subclass implements, and those that call it."""


def _check_implemented(wrapper: Wrapper) -> None:
    """Refuses a wrapper whose method is missing, or has a misspelt name, before it is first called.

    Raises:
        ValueError: neither the method nor all that call it are the subclass's own.
    """
    mine = type(wrapper)
    for kind, method, callers in IMPLEMENTED:
        if not isinstance(wrapper, kind) or getattr(mine, method) is not getattr(kind, method):
            continue
        if any(getattr(mine, name) is getattr(kind, name) for name in callers):
            raise ValueError(f"{method}: {mine.__name__} has none; takes a {kind.__name__} with a method of this name")


def find(env: Environment, kind: type[W]) -> W | None:
    """Returns the outermost wrapper of a kind, or None."""
    return next(iter(find_all(env, kind)), None)


def find_all(env: Environment, kind: type[W]) -> list[W]:
    """Returns all wrappers of a kind, the outermost first."""
    return [layer for layer in env.layers if isinstance(layer, kind)]


def _forms(memory: Any) -> dict[str, str]:
    """Types and shapes of a memory's arrays, by their places in it."""
    return {jax.tree_util.keystr(at): array_words(jnp.asarray(x)) for at, x in jax.tree.leaves_with_path(memory)}
