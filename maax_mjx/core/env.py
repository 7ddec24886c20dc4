"""What every environment is: `Base`, and whatever wraps it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property, wraps
from typing import TYPE_CHECKING, Any

import jax
from gymnasium import spaces

from maax_mjx.common.checks import described
from maax_mjx.common.params import DomainParams
from maax_mjx.common.spaces import sample, space_of
from maax_mjx.core.state import State

if TYPE_CHECKING:
    from maax_mjx.core.base import Base


class Environment(ABC):
    """A multi-agent environment of one world. `reset` and `step` are pure: jit, vmap and scan them freely."""

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        if "step" in cls.__dict__:
            cls.step = _named(cls.step)  # type: ignore[method-assign]

    @property
    @abstractmethod
    def base(self) -> Base:
        """The environment under all wrappers, which owns the model, the modules and the engine."""

    @property
    @abstractmethod
    def action_space(self) -> spaces.Dict:
        """The space of one world's action."""

    @cached_property
    def state_shape(self) -> State:
        """A state of one world, with the shapes and types of its arrays instead of their values."""
        return jax.eval_shape(self.reset, jax.random.key(0))

    @cached_property
    def observation_space(self) -> spaces.Dict:
        """The space of one world's observations."""
        return space_of(self.state_shape.obs)

    @abstractmethod
    def reset(self, key: jax.Array, params: DomainParams | None = None) -> State:
        """Draws a world and puts it at rest.

        Args:
            key: a typed key; it determines the world.
            params: ranges to draw from; None is `default_params`.
        """

    @abstractmethod
    def step(self, state: State, action: Any) -> State:
        """Advances a world by one env step, `n_frames` physics steps.

        Args:
            state: from `reset` or `step`.
            action: in `action_space`.
        """

    @property
    def default_params(self) -> DomainParams:
        """The ranges that the environment was constructed with."""
        return self.base.default_params

    def sample_action(self, key: jax.Array) -> dict[str, jax.Array]:
        """A uniform random action; traceable."""
        return sample(self.action_space, key)


def check_environment(env: Any) -> Environment:
    """An environment.

    Raises:
        ValueError: something else.
    """
    if not isinstance(env, Environment):
        raise ValueError(f"env: got {described(env)}; takes an environment, as maax.make(...) gives it")
    return env


def _named(step: Callable) -> Callable:
    """`step`, whose operations carry the name of their environment's class, by which profiles tell layers apart."""

    @wraps(step)
    def named(self: Environment, state: State, action: Any) -> State:
        with jax.named_scope(type(self).__name__):
            return step(self, state, action)

    return named
