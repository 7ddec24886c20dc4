"""Tasks of locking objects: all of them, one after the other, and to return (Baker et al.'s transfer tasks)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnasium import spaces

from maax_mjx.common.annotated import NonNegative, Positive, check_value
from maax_mjx.common.checks import check_bool, check_choice
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.locks import LockObjects
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.wrapper import ActionWrapper, Wrapper, find_all

NOTHING = -1
CORNERS = 0.1
"""Metres, on each axis, by which a cube of 0.5 m has its lower corner further from its centre than an agent has."""


def locks_of(wrapper: Wrapper, action_name: str, kind: str) -> tuple[LockObjects, np.ndarray]:
    """Returns the wrapper that has an action of locking, and the numbers of a kind's objects among those it locks.

    Raises:
        ValueError: no such wrapper with a choice for every object, or a kind that it does not lock.
    """
    mine = type(wrapper).__name__
    found = {layer.action_name: layer for layer in find_all(wrapper.env, LockObjects) if layer.per_object}
    if action_name not in found:
        raise ValueError(
            f"action_name: got {action_name!r}; {mine} takes that of a LockObjects inside it with per_object=True, "
            f"one of {sorted(found)}"
        )
    locks = found[action_name]
    kinds = np.array([m.kind for m in locks.modules for _ in range(m.n_max)])
    check_choice("kind", kind, set(kinds.tolist()))
    return locks, np.flatnonzero(kinds == kind)


class LockTogether(ActionWrapper):
    """Gives agents one choice for everything in reach, around a `LockObjects` with a choice for every object.

    As `LockObjects(per_object=False)`, with room for rules about single objects in between.

    Args:
        env: environment to wrap.
        action_name: of the locks.

    Raises:
        ValueError: no such locks.
    """

    name = "lock_together"

    def __init__(self, env: Environment, action_name: str = "lock"):
        super().__init__(env)
        space = env.action_space.spaces.get(action_name)
        if not isinstance(space, spaces.MultiBinary) or len(space.shape or ()) != 2:
            raise ValueError(
                f"action_name: got {action_name!r}, with the space {space}; takes that of a LockObjects with "
                "per_object=True"
            )
        self._action_name, (self._n_agents, self._n) = action_name, space.shape

    @property
    def action_space(self) -> spaces.Dict:
        return spaces.Dict({**self.env.action_space.spaces, self._action_name: spaces.MultiBinary((self._n_agents,))})

    @property
    def acts_on(self) -> dict[str, tuple[tuple[str, int], ...]]:
        return {name: kinds for name, kinds in self.env.acts_on.items() if name != self._action_name}

    def action(self, state: State, action: dict[str, Any]) -> dict[str, Any]:
        wants = jnp.asarray(action[self._action_name])
        return {**action, self._action_name: jnp.broadcast_to(wants[:, None], (self._n_agents, self._n))}


class LockInOrder(ActionWrapper):
    """Lets agents lock objects of a kind in the order of their numbers only.

    While several are unlocked, nobody can lock any but the first of them (Baker et al.'s "order" tasks). All can be
    unlocked at any time.

    Args:
        env: environment to wrap.
        kind: of the objects.
        action_name: of the locks.

    Raises:
        ValueError: no such locks, or locks without a choice for every object.
    """

    name = "lock_in_order"

    def __init__(self, env: Environment, kind: str = "box", action_name: str = "lock"):
        super().__init__(env)
        self.kind, self._action_name = kind, action_name
        self._locks, self._ids = locks_of(self, action_name, kind)

    def action(self, state: State, action: dict[str, Any]) -> dict[str, Any]:
        wants = jnp.asarray(action[self._action_name])
        unlocked = state.world.active[self.kind] & ~state.mechanics[self._locks.name].locked[self._ids]
        later = unlocked & (jnp.arange(len(self._ids)) != jnp.argmax(unlocked))
        allowed = jnp.where(later, 0, wants[:, self._ids])
        return {**action, self._action_name: wants.at[:, self._ids].set(allowed)}


class Progress(struct.PyTreeNode):
    """How far a lock task is.

    Attributes:
        spawn: (2,) metres, where the agent began.
        target: the object that is to be locked next, -1 for none.
        gap: metres from the agent to it, 0 without one.
        home: metres from the agent to where it began.
    """

    spawn: jax.Array
    target: jax.Array
    gap: jax.Array
    home: jax.Array


class LockTask(Wrapper):
    """Pays one agent for locking all objects of a kind (Baker et al.'s lock tasks, by their published code).

    At every step it gets `lock` for each object that became locked, and loses `unlock` for each that came open. It gets
    `shaped` times the metres by which it came nearer to its target: the nearest unlocked object, or the first in their
    order; when all are locked, and it is to return, where it began. When a target is locked, what was left of the way
    is paid; when another one takes its place by coming open, the way to that is taken. In steps in which all are
    locked, and the agent is back if it is to return, it gets `success`. Episodes go on to the horizon.

    Args:
        env: environment to wrap, of one agent.
        kind: of the objects.
        in_order: whether the target is the first in the order of numbers instead of the nearest.
        and_return: whether the agent is to return.
        lock: reward for a lock in points, not negative.
        unlock: what opening one costs in points, not negative.
        success: reward of every step at which the task is done, in points, not negative.
        shaped: points for a metre.
        radius: metres from where the agent began that count as back.
        from_corners: whether distances are from the agent's lower corner to those of cubes of half a metre, as in the
            published code: 0.1 m on each axis beside the one between centres.
        action_name: of the locks.

    Raises:
        ValueError: more than one agent, no such locks, or a number out of its range.
    """

    name = "lock_task"
    precedes = (PreparationPhase, LockInOrder, LockTogether)

    def __init__(
        self,
        env: Environment,
        kind: str = "box",
        in_order: bool = False,
        and_return: bool = False,
        lock: float = 5.0,
        unlock: float = 5.0,
        shaped: float = 0.5,
        success: float = 1.0,
        radius: float = 0.1,
        from_corners: bool = True,
        action_name: str = "lock",
    ):
        super().__init__(env)
        if env.n_agents != 1:
            raise ValueError(f"env: got one with {env.n_agents} agents; LockTask takes one agent")
        self.kind = kind
        self._locks, self._ids = locks_of(self, action_name, kind)
        self.in_order, self.and_return = check_bool("in_order", in_order), check_bool("and_return", and_return)
        points = {"lock": lock, "unlock": unlock, "shaped": shaped, "success": success}
        self._points = {name: float(check_value(name, value, NonNegative)) for name, value in points.items()}
        self.radius = float(check_value("radius", radius, Positive))
        self._offset = CORNERS if check_bool("from_corners", from_corners) else 0.0
        self.module = next(m for m in self.base.movables if m.kind == kind)

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        state = self.env.begin(key, params)
        return self.remember(state, self._progress(state, self._agent(state)))

    def transition(self, state: State, action: dict[str, Any]) -> State:
        was: Progress = state.mechanics[self.name]
        locked_before = self._locked(state)
        state = self.env.advance(state, action)
        now, locked = self._progress(state, was.spawn), self._locked(state)
        points = self._points
        reward = points["lock"] * (locked & ~locked_before).sum() - points["unlock"] * (locked_before & ~locked).sum()
        reward += points["shaped"] * self._nearer(was, now, locked)
        reward += points["success"] * self._is_done(now)
        return self.remember(state.replace(reward=state.reward + reward), now)

    def is_done(self, state: State) -> jax.Array:
        """Whether everything is locked, and the agent is back if it is to return: () bool."""
        return self._is_done(state.mechanics[self.name])

    def _is_done(self, progress: Progress) -> jax.Array:
        return (progress.target == NOTHING) & (~jnp.asarray(self.and_return) | (progress.home <= self.radius))

    def _nearer(self, was: Progress, now: Progress, locked: jax.Array) -> jax.Array:
        """Metres by which the agent came nearer to what it is to do next."""
        had, has = was.target != NOTHING, now.target != NOTHING
        other = jnp.where(locked[was.target], was.gap, -now.gap)
        home = was.home - now.home if self.and_return else 0.0
        with_target = jnp.where(had & (was.target == now.target), was.gap - now.gap, jnp.where(had, other, -now.gap))
        return jnp.where(had | has, with_target, home)

    def _progress(self, state: State, spawn: jax.Array) -> Progress:
        agent = self._agent(state)
        unlocked = state.world.active[self.kind] & ~self._locked(state)
        objects = state.data.qpos[self.module.qpos_ids[:, :2]]
        gaps = jnp.linalg.norm(agent - objects + self._offset, axis=1)
        first = jnp.argmax(unlocked) if self.in_order else jnp.argmin(jnp.where(unlocked, gaps, jnp.inf))
        there = unlocked.any()
        target = jnp.where(there, first, NOTHING).astype(jnp.int32)
        return Progress(spawn, target, jnp.where(there, gaps[first], 0.0), jnp.linalg.norm(agent - spawn))

    def _agent(self, state: State) -> jax.Array:
        return state.data.qpos[self.base.agents.qpos_ids[0, :2]]

    def _locked(self, state: State) -> jax.Array:
        return state.mechanics[self._locks.name].locked[self._ids] & state.world.active[self.kind]
