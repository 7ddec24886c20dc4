"""`Environment`, the interface of all environments, and `Base`, the one that is made of modules."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces

from maax_mjx.common.arrays import with_rows
from maax_mjx.common.checks import check_bool, check_key, described
from maax_mjx.common.observed import Observed, resolved
from maax_mjx.common.params import DomainParams
from maax_mjx.common.recorded import Recorded, differing, short
from maax_mjx.common.spaces import check_action, check_space, sample, space_of
from maax_mjx.core.composition import Composition
from maax_mjx.core.copies import copied, reduced
from maax_mjx.core.describe import Description, describe
from maax_mjx.core.faults import contain, find_fault
from maax_mjx.core.generation import draw_layout
from maax_mjx.core.state import State, check_kept, check_returned, check_state
from maax_mjx.core.teams import Team, agent_names, make_teams
from maax_mjx.layout import World
from maax_mjx.modules import Module
from maax_mjx.modules.from_model import from_model
from maax_mjx.physics import Data
from maax_mjx.worldgen import WorldParams

DOORS = {
    "reset": ("begin(key, params)", "self.env.begin(key, params)"),
    "step": ("transition(state, action)", "self.env.advance(state, action)"),
}
"""Methods that are not overridden: what subclasses implement instead, and how a wrapper calls it."""


class Made(NamedTuple):
    """What a game was made from.

    Attributes:
        make: `make(name, config)`, which makes it again.
        name: the game's name.
        config: its config.
    """

    make: Callable[[str, Any], Environment]
    name: str
    config: Any

    def __str__(self) -> str:
        fields = differing(self.config)
        return f"{self.name}({', '.join(f'{name}={short(value)}' for name, value in fields.items())})"


class Environment(Recorded, ABC):
    """A multi-agent environment of one world. `reset` and `step` are pure: jit, vmap and scan them freely.

    They are the doors, which check what they get once and are compiled when they are called outside of traced code.
    Subclasses implement what happens inside: `begin` and `transition`.

    Attributes:
        n_agents: number of slots for agents.
        made: what it was made from, if `maax.make` made it.
        made_with: the arguments of its construction.
    """

    n_agents: int
    made: Made | None = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for door, (inside, inner) in DOORS.items():
            if door in vars(cls):
                raise ValueError(
                    f"{door}: {cls.__name__} overrides it; takes `{inside}` instead, which `{door}` calls with checked "
                    f"arguments; in it, {inner} is that of a wrapped environment"
                )

    @property
    @abstractmethod
    def base(self) -> Base:
        """The environment under all wrappers, which owns the model, the modules and the engine."""

    @property
    @abstractmethod
    def layers(self) -> tuple[Any, ...]:
        """The wrappers, each a `Wrapper`, the outermost first."""

    @property
    def made_from(self) -> Made | None:
        """What the game in it was made from, if `maax.make` made it; further wrappers may be around it."""
        return next((env.made for env in (*self.layers, self.base) if env.made), None)

    @property
    @abstractmethod
    def action_space(self) -> spaces.Dict:
        """The space of one world's action."""

    @property
    def acts_on(self) -> dict[str, tuple[tuple[str, int], ...]]:
        """Kinds and numbers of the entities that an action's columns are about, by the action's name.

        An action with a column for every box and then every ramp has (("box", n_boxes), ("ramp", n_ramps)).
        """
        return {}

    @property
    @abstractmethod
    def teams(self) -> dict[str, Team]:
        """The teams by name."""

    @abstractmethod
    def begin(self, key: jax.Array, params: DomainParams) -> State:
        """Draws a world and puts it at rest. Subclasses implement it; `reset` calls it with checked arguments.

        A wrapper calls `self.env.begin(key, params)` for the beginning of what it wraps.
        """

    @abstractmethod
    def transition(self, state: State, action: Any) -> State:
        """Advances a world by one env step. Subclasses implement it; `step` calls it with a checked action.

        A wrapper calls `self.env.advance(state, action)` for the step of what it wraps.
        """

    @abstractmethod
    def declared(self) -> dict[str, Observed]:
        """Returns the declarations of observations, without the masks that `observed` finds by name."""

    def reset(self, key: jax.Array, params: DomainParams | None = None) -> State:
        """Draws a world and puts it at rest.

        Args:
            key: a typed key; it determines the world.
            params: ranges to draw from; None uses `default_params`.

        Raises:
            ValueError: no typed key, several keys, or params outside their bounds.
        """
        check_key("key", key)
        params = self.default_params if params is None else params
        self.base.check_params(params)
        return self.begun(key, params)

    def step(self, state: State, action: Any) -> State:
        """Advances a world by one env step, `n_frames` physics steps.

        Args:
            state: from `reset` or `step`.
            action: in `action_space`.

        Raises:
            ValueError: a state of another environment or of many worlds; an action whose names, shapes or dtypes
                differ from the space's; outside traced code also values out of range.
        """
        check_state(state, self.state_shape)
        check_action(self.action_space, action)
        return self._traced_advance(state, action)

    def begun(self, key: jax.Array, params: DomainParams) -> State:
        """What `begin` gives, without checks; its Python runs once, whoever asks."""
        return self._traced_begin(key, jax.tree.map(jnp.asarray, params))

    # Python that runs once for all programs that have it in them saves half of their compilation. Called operation by
    # operation, hundreds of programs would be compiled.
    @from_model
    def _traced_begin(self) -> Any:
        return jax.jit(lambda key, params: check_returned("begin", self, self.begin(key, params)))

    @from_model
    def _traced_advance(self) -> Any:
        return jax.jit(lambda state, action: check_kept(self, state, self.advance(state, action)))

    def advance(self, state: State, action: Any) -> State:
        """Steps without checks, under this class's name, so that profiles can tell layers apart."""
        with jax.named_scope(type(self).__name__):
            return check_returned("transition", self, self.transition(state, action))

    @property
    def build(self) -> object:
        """The token of the composition that `from_model` properties belong to."""
        return self.base.build

    @property
    def agent_names(self) -> tuple[str, ...]:
        """The agents' names by slot, such as "hider_0" and "seeker_1"."""
        return agent_names(self.teams)

    @property
    def observed(self) -> dict[str, Observed]:
        """The declarations of all observations: axes, columns and who sees them."""
        return resolved(self.declared())

    def describe(self) -> Description:
        """A table of the observations: name, axes, shape, columns with units, who sees it. Print it."""
        return describe(self.observed, self.observation_space)

    @from_model
    def state_shape(self) -> State:
        """A state of one world whose leaves have shapes and dtypes instead of values."""
        return self._traced_begin.eval_shape(jax.random.key(0), jax.tree.map(jnp.asarray, self.default_params))

    @from_model
    def observation_space(self) -> spaces.Dict:
        """The space of one world's observations."""
        return space_of(self.state_shape.obs)

    @property
    def default_params(self) -> DomainParams:
        """The ranges that the environment was built with."""
        return self.base.default_params

    def sample_action(self, key: jax.Array) -> dict[str, jax.Array]:
        """Draws a uniform random action; traceable."""
        check_key("key", key)
        return sample(self.action_space, key)

    def __repr__(self) -> str:
        layers = ", ".join(type(layer).__name__ for layer in reversed(self.layers))
        parts = [
            f"{self.n_agents} agent{'s' * (self.n_agents != 1)}",
            f"modules {', '.join(self.base.modules)}",
            f"engine {self.base.impl}",
        ]
        parts += [f"layers {layers}"] if layers else []
        return f"<{self.made_from or type(self.base).__name__}: {'; '.join(parts)}>"

    def __reduce__(self) -> Any:
        if self.made is not None:
            return reduced(self, self.made.make, self.made.name, self.made.config)
        modules = list(self.base.modules.values()) if self is self.base else []
        return reduced(self, _again, type(self), *self.made_with, modules)

    def __deepcopy__(self, memo: dict[int, Any]) -> Environment:
        """Copies the whole chain, with its own modules and a model that is not built yet."""
        return copied(self, memo)


class Base(Composition, Environment):
    """An environment made of modules, without game mechanics: agents move, rewards are zero.

    Add modules in the order in which they draw (walls first), then reset. The model is built once, at the largest
    number of everything; every reset draws a new layout on the device.

    Args:
        n_agents: number of agents, as in its `Agents` module.
        n_frames: physics steps per env step.
        grid_size: cells per side of the placement grid.
        floor_size: edge of the floor in metres, or (low, high), drawn per world; the grid's cells grow with it.
        horizon: env steps until an episode is truncated; None for an endless game, whose episodes end by its rules or a
            physics fault alone.
        impl: "jax", "warp", "c", or "auto": `warp` on NVIDIA where it is installed, `jax` on other accelerators, `c` on
            a bare CPU.
        world_params: time step, gravity and solver iterations.
        contacts_per_world: contact points of a world that `jax` and `warp` make room for; None derives them from the
            entities. More cost time; too few are reported as `metrics["contact_overflow"]`. `c` has no such limit.
        may_leave: whether agents and objects may be outside of a closed arena, below the floor or above it; otherwise a
            world in which one is astray is cut off, `metrics["physics_fault"]`.
        placement_tries: how many places are tried for an object before the whole world is drawn anew, with other counts
            of everything; as published, with 10. None finds a place wherever one is free, and counts are kept.

    Raises:
        ValueError: an argument out of its range.
        MissingLibraryError: an engine whose library is not installed; the message names the extra that brings it.
    """

    def __init__(
        self,
        n_agents: int,
        n_frames: int = 1,
        grid_size: int = 30,
        floor_size: float | tuple[float, float] = 6.0,
        horizon: int | None = 1000,
        impl: str = "auto",
        world_params: WorldParams | None = None,
        contacts_per_world: int | None = None,
        may_leave: bool = False,
        placement_tries: int | None = None,
    ):
        super().__init__(
            n_agents, n_frames, grid_size, floor_size, horizon, impl, world_params, contacts_per_world, placement_tries
        )  # fmt: skip
        self.may_leave = check_bool("may_leave", may_leave)

    @property
    def base(self) -> Base:
        return self

    @property
    def layers(self) -> tuple[Any, ...]:
        return ()

    def add_module(self, module: Module) -> None:
        super().add_module(module)
        # With another module it is not the registered world any more.
        self.made = None

    @property
    def teams(self) -> dict[str, Team]:
        agents = self.agents
        return make_teams(list(agents.team_sizes), agents.team_index, agents.colours.tolist())

    @cached_property
    def action_space(self) -> spaces.Dict:
        return spaces.Dict({"move": spaces.Box(-1.0, 1.0, (self.n_agents, 3), np.float32)})

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        layout_key, state_key = jax.random.split(key)
        layout = draw_layout(self, layout_key, params)
        fields = {name: layout.fields[name][ids] for name, ids in self.overlay.items()}
        world = World(fields, layout.active, layout.extents, layout.sites, layout.plan, layout.valid)
        data = self.engine.init(world.fields, layout.qpos)
        world = self.bounded(world, data)
        no = jnp.zeros((), bool)
        return State(
            data=data,
            world=world,
            params=params,
            obs=self.module_observations(world, data),
            reward=jnp.zeros(self.n_agents),
            terminated=no,
            truncated=no,
            can_act=world.active[self.agents.kind],
            step=jnp.zeros((), jnp.int32),
            key=state_key,
            metrics={"physics_fault": no, "layout_invalid": ~world.valid, "contact_overflow": no},
            mechanics={},
        )

    def transition(self, state: State, action: dict[str, Any]) -> State:
        """Moves the agents.

        `action["move"]` (n_agents, 3) is the share of full force along the world's x and y and of full torque about
        z. MuJoCo clamps controls to [-1, 1]. Under jit, where values cannot be checked, NaN becomes a physics fault.
        """
        engine = self.engine
        move = jnp.asarray(action["move"], state.data.ctrl.dtype)
        move = jnp.where(state.world.active[self.agents.kind][:, None], move, 0.0)
        ctrl = with_rows(state.data.ctrl, self.agents.ctrl_ids, move)
        before = state.data.replace(ctrl=jnp.nan_to_num(ctrl))
        world, after, overflow = self._advance_physics(state.world, before)
        fault = self._fault(world, after) | jnp.isnan(ctrl).any()
        after = contain(fault, before, after.replace(engine=engine.renew(after.engine, fault)))
        world = self.bounded(world, after)
        data = engine.pose(world.fields, after)
        step = state.step + 1
        return state.replace(
            data=data,
            world=world,
            obs=self.module_observations(world, data),
            reward=jnp.zeros_like(state.reward),
            terminated=jnp.zeros((), bool),
            truncated=fault if self.horizon is None else fault | (step >= self.horizon),
            can_act=world.active[self.agents.kind],
            step=step,
            metrics={
                "physics_fault": fault,
                "layout_invalid": ~world.valid,
                "contact_overflow": overflow & ~fault,
            },
        )

    def _advance_physics(self, world: World, data: Data) -> tuple[World, Data, jax.Array]:
        """Runs the physics steps of one env step, and updates the arena's limits after each, since boxes turn."""
        if not self.is_limited or self.n_frames == 1:
            return world, *self.engine.advance(world.fields, data, self.n_frames)

        def frame(carry: tuple[World, Data], _: None) -> tuple[tuple[World, Data], jax.Array]:
            world, data = carry
            data, overflow = self.engine.advance(world.fields, data, 1)
            return (self.bounded(world, data), data), overflow

        (world, data), overflow = jax.lax.scan(frame, (world, data), length=self.n_frames)
        return world, data, overflow.any()

    def _fault(self, world: World, data: Data) -> jax.Array:
        active = jnp.concatenate([world.active[m.kind] for m in self.movables])
        position = data.qpos[self.position_ids]
        return find_fault(data, world.plan, position, active, self.is_agent, self.may_leave)


def _again(kind: type[Environment], args: tuple[Any, ...], kwargs: dict[str, Any], modules: list[Any]) -> Environment:
    """Makes an environment anew, from the arguments and modules that it was made of; for pickle."""
    env = kind(*args, **kwargs)
    for module in modules:
        # A subclass may have added its own.
        if module.name not in env.base.modules:
            env.base.add_module(module)
    return env


def check_environment(env: Any) -> Environment:
    """Returns `env` if it is an environment.

    Raises:
        ValueError: `env` is not an environment, or has actions that `check_space` refuses.
    """
    if not isinstance(env, Environment):
        raise ValueError(f"env: got {described(env)}; takes an environment, as maax.make(...) gives it")
    check_space(env.action_space)
    return env
