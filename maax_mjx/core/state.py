"""The state of an environment: one flat pytree."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from maax_mjx.common.checks import array_words, check_not_donated, described, is_traced
from maax_mjx.common.observed import AGENT
from maax_mjx.common.params import DomainParams
from maax_mjx.layout import World
from maax_mjx.physics import Data


class State(struct.PyTreeNode):
    """The complete state of one world at one time.

    Attributes:
        data: the physics state.
        world: the model fields in which this world differs from the compiled model, and its room plan.
        params: the ranges it was drawn from; after a batch's ranges were changed, those of its next episode.
        obs: observations by name.
        reward: (n_agents,) reward of the step that led here.
        terminated: () bool, whether the episode ended by the game's rules.
        truncated: () bool, whether it was cut off by the horizon or a physics fault.
        can_act: (n_agents,) bool, whether what the agent does in the next step has an effect: it is in play and does
            not wait for others' preparation.
        step: () int32, env steps since reset.
        key: the world's random key.
        metrics: numbers of this step: "physics_fault", "layout_invalid", "contact_overflow", each () bool,
            and the wrappers'.
        mechanics: each wrapper's own struct, by the wrapper's name.
    """

    data: Data
    world: World
    params: DomainParams
    obs: dict[str, jax.Array]
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    can_act: jax.Array
    step: jax.Array
    key: jax.Array
    metrics: dict[str, jax.Array]
    mechanics: dict[str, Any]

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {', '.join(summary(self))}>"

    @property
    def active(self) -> jax.Array:
        """Whether the agents are in play: (n_agents,) bool."""
        return self.world.active[AGENT]

    @property
    def done(self) -> jax.Array:
        """Whether the episode is terminated or truncated: () bool."""
        return self.terminated | self.truncated


def summary(state: State) -> list[str]:
    """Returns parts of a text about states: how many worlds, agents, their steps, what is observed and kept."""
    n_agents, lead = np.shape(state.reward)[-1:], np.shape(state.step)
    parts = [" x ".join(map(str, lead)) + " worlds"] if lead else []
    parts += [f"{n_agents[0]} agents"] if n_agents else []
    if not lead and isinstance(state.step, jax.Array | np.ndarray) and not is_traced(state.step):
        parts.append(f"step {int(state.step)}")
    names = {"obs": state.obs, "mechanics": state.mechanics}
    return parts + [f"{what} {' '.join(sorted(found))}" for what, found in names.items() if found]


FIELDS = tuple(State.__dataclass_fields__)


def plain(state: State) -> State:
    """Returns the state without the fields that a subclass adds for a batch."""
    return State(**{name: getattr(state, name) for name in FIELDS})


def check_state(state: Any, wanted: State) -> None:
    """Refuses what is not the state of one world of an environment.

    Args:
        state: the state to check.
        wanted: the environment's `state_shape`.

    Raises:
        ValueError: no State, a batch of states, or a state of another environment.
        RuntimeError: a state that was donated.
    """
    if not isinstance(state, State):
        raise ValueError(f"state: got {described(state)}; takes a State, as reset and step give it")
    if batch := jnp.shape(state.step):
        raise ValueError(
            f"state: got a batch of {batch[0]} worlds; takes one world: use jax.vmap(env.step) for a batch, or "
            "maax.Worlds(env, n_worlds), whose worlds begin new episodes by themselves"
        )
    check_not_donated(state.step)
    check_fits(state, wanted)


def check_returned(hook: str, layer: Any, state: Any) -> State:
    """Refuses what is no state, where a user's class forgot to return one, and ends that are not one bool.

    Args:
        hook: name of the method that returned it.
        layer: the environment whose method it is.
        state: what it returned.

    Raises:
        ValueError: no State, or one whose `terminated` or `truncated` is anything but one bool.
    """
    if not isinstance(state, State):
        raise ValueError(
            f"{hook}: {type(layer).__name__} returned {described(state)}; takes the state of what it wraps, changed "
            "with state.replace(...)"
        )
    for name in ("terminated", "truncated"):
        end = getattr(state, name)
        if jnp.shape(end) != () or jnp.result_type(end) != jnp.bool_:
            raise ValueError(
                f"{name}: {type(layer).__name__} returned {array_words(end)}; takes one bool for the world, such as "
                "x.any() for agents of whom one ends it"
            )
    return state


def check_kept(env: Any, before: State, after: State) -> State:
    """Refuses a memory that a step began: states keep their structure from `begin` on.

    Raises:
        ValueError: a wrapper's memory that `begin` did not give, or that is gone after the step.
    """
    for name in sorted(after.mechanics.keys() ^ before.mechanics.keys()):
        layer = next((type(layer).__name__ for layer in env.layers if layer.name == name), name)
        where = "at a step, and not from begin" if name in after.mechanics else "from begin, and not after a step"
        raise ValueError(
            f"remember: got a memory of {layer} {where}; takes one from both: begin returns "
            "self.remember(self.env.begin(key, params), ...)"
        )
    return after


def check_fits(states: State, wanted: State, leading: int = 0) -> None:
    """Refuses states with other things in a world or other mechanics than `wanted`; the engine may be another one.

    Args:
        states: states with some leading axes.
        wanted: an environment's `state_shape`.
        leading: number of leading axes.

    Raises:
        ValueError: states of another environment; the message names what differs.
    """
    needs, got = _shapes(wanted, 0), _shapes(states, leading)
    for name in (*needs, *got):
        if needs.get(name) != got.get(name):
            here, there = (str(of.get(name, "nothing")) for of in (got, needs))
            raise ValueError(
                f"states: got states of another environment: {name} has {here}, and in env {there}; takes what env's "
                "reset and step give"
            )


def _shapes(state: State, leading: int) -> dict[str, tuple[int, ...]]:
    """Shapes of what is in a world and of what its mechanics keep, by name, without some leading axes."""
    parts = {"reward": state.reward, "world": state.world, "mechanics": state.mechanics}
    parts["data"] = {"geom_xpos": state.data.geom_xpos, "qpos": state.data.qpos}
    return {
        "state" + "".join(f".{getattr(key, 'key', getattr(key, 'name', key))}" for key in path): leaf.shape[leading:]
        for path, leaf in jax.tree_util.tree_leaves_with_path(parts)
    }
