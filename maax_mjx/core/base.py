"""`Base`: modules composed into an environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from gymnasium import spaces

from maax_mjx.common.arrays import with_rows
from maax_mjx.common.checks import check_choice, check_count, check_key
from maax_mjx.common.params import DomainParams, Parameter, check_params, default_params
from maax_mjx.common.spaces import check_action
from maax_mjx.core.arena_limits import ArenaLimits
from maax_mjx.core.capacity import contact_capacity
from maax_mjx.core.composition import check_module
from maax_mjx.core.env import Environment
from maax_mjx.core.faults import contain, find_fault
from maax_mjx.core.generation import draw_layout
from maax_mjx.core.state import State
from maax_mjx.layout import Layout, World
from maax_mjx.modules import Agents, Entities, Module, Sites
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Engine, Overlay, check_impl, make_engine, union
from maax_mjx.worldgen import Floor, WorldBuilder, WorldParams


class Base(Environment):
    """An environment made of modules, without game mechanics: agents move, rewards are zero.

    Add modules in the order in which they draw (walls first), then reset. The model is built once, at the largest
    number of everything; every reset draws a new layout on the device.

    Args:
        n_agents: how many agents its `Agents` module has.
        n_frames: physics steps per env step.
        grid_size: cells per side of the placement grid.
        floor_size: edge of the floor in metres, or (low, high), drawn per world; the grid's cells grow with it.
        horizon: env steps until an episode is truncated.
        impl: "jax", "warp", "c", or "auto": `warp` on NVIDIA where it is installed, `jax` on other accelerators, `c` on
            a bare CPU.
        world_params: time step, gravity and solver iterations.
        contacts_per_world: contact points of a world that `jax` and `warp` make room for; None derives them from the
            entities. More cost time; too few are reported as `metrics["contact_overflow"]`. `c` has no such limit.

    Raises:
        ValueError: an argument out of its range; the message names it.
        MissingLibraryError: an engine whose library is not installed; the message names the extra that brings it.
    """

    def __init__(
        self,
        n_agents: int,
        n_frames: int = 1,
        grid_size: int = 30,
        floor_size: float | tuple[float, float] = 6.0,
        horizon: int = 1000,
        impl: str = "auto",
        world_params: WorldParams | None = None,
        contacts_per_world: int | None = None,
    ):
        self.n_agents = check_count("n_agents", n_agents, minimum=1)
        self.n_frames = check_count("n_frames", n_frames, minimum=1)
        self.grid_size = check_count("grid_size", grid_size, minimum=8)
        self.floor_range = Ranged("floor_size", floor_size, above=True)
        self.horizon = check_count("horizon", horizon, minimum=1)
        self.impl = check_impl(impl)
        self.world_params = WorldParams() if world_params is None else world_params
        if not isinstance(self.world_params, WorldParams):
            raise ValueError(f"world_params: got {world_params!r}; takes a WorldParams")
        if contacts_per_world is not None:
            check_count("contacts_per_world", contacts_per_world, minimum=1)
        self._contacts_per_world = contacts_per_world
        self._modules: dict[str, Module] = {}

    # --- composition -------------------------------------------------------------------------------------------

    def add_module(self, module: Module) -> None:
        """Adds a module; those added first draw first.

        Raises:
            ValueError: a module that does not fit the environment or what was added before it.
            RuntimeError: the environment was built already.
        """
        if "spec" in self.__dict__:
            raise RuntimeError("add_module: the environment is built already; add all modules before its first use")
        if not isinstance(module, Module):
            raise ValueError(f"module: got {module!r}; takes a Module")
        if getattr(module, "_owner", self) is not self:
            raise ValueError(f"module: this {type(module).__name__} belongs to another environment; make a new one")
        check_module(module, list(self._modules.values()), self.n_agents, self.grid_size, self.floor_range.low)
        module._owner = self  # type: ignore[attr-defined]
        self._modules[module.name] = module

    @property
    def modules(self) -> Mapping[str, Module]:
        """The modules by name."""
        return self._modules

    @property
    def floor_size(self) -> float:
        """The largest edge of the floor in metres; a world's own is `state.world.plan.floor_size`."""
        return self.floor_range.high

    @property
    def movables(self) -> list[Entities]:
        """The modules of what can move, if they hold anything."""
        return [m for m in self._modules.values() if isinstance(m, Entities) and m.n_max and not m.static]

    def objects(self, names: Sequence[str]) -> list[Entities]:
        """The modules of those names, whose objects can move.

        Raises:
            ValueError: one that there is not, whose objects cannot move, that is given twice, or the agents.
        """
        there = {m.name: m for m in self._modules.values() if isinstance(m, Entities) and not m.static}
        there.pop(Agents.name, None)
        if isinstance(names, str) or len(set(names)) < len(names):
            raise ValueError(f"objects: got {names!r}; takes a list of different names of {sorted(there)}")
        return [there[check_choice("objects", name, there)] for name in names]

    @property
    def sites(self) -> dict[str, Sites]:
        """The modules of marks on the floor, by kind."""
        return {m.kind: m for m in self._modules.values() if isinstance(m, Sites) and m.n_max}

    @property
    def agents(self) -> Agents:
        """The agents' module.

        Raises:
            RuntimeError: there is none.
        """
        agents = self._modules.get(Agents.name)
        if not isinstance(agents, Agents):
            raise RuntimeError(f"Base: got no agents; add_module(Agents({self.n_agents}, ...)) before its first use")
        return agents

    # --- host: built once, at first use ------------------------------------------------------------------------

    @cached_property
    def spec(self) -> mujoco.MjSpec:
        """The MuJoCo spec, the largest number of everything in it."""
        _ = self.agents
        builder = WorldBuilder(self.world_params)
        floor = Floor(self.floor_size)
        builder.append(floor)
        for module in self._modules.values():
            module.build_step(floor, self.grid_size)
        spec = builder.to_spec()
        for module in self._modules.values():
            module.spec_step(spec)
        if self._limits is not None:
            self._limits.edit(spec)
        # What can be absent floats where it is parked; the overlay gives it its weight when it is in play.
        for body in spec.bodies[1:]:
            body.gravcomp = 1.0
        # Not max_geom_pairs: MJX keeps the pairs whose bounding spheres overlap most, and those of long walls overlap
        # everything, so that it would leave out true contacts.
        spec.add_numeric(name="max_contact_points", data=[self.contacts_per_world], size=1)
        return spec

    @property
    def contacts_per_world(self) -> int:
        """Contact points that the accelerators' engines make room for."""
        return self._contacts_per_world or contact_capacity(self._modules.values())

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled MuJoCo model."""
        model = self.spec.compile()
        for module in self._modules.values():
            module.cache_step(model)
        return model

    @cached_property
    def overlay(self) -> Overlay:
        """The rows of model fields in which worlds differ."""
        _ = self.model  # gives the modules their ids
        rows = [module.overlay for module in self._modules.values()]
        if self.floor_range.varies:
            rows.append(dict.fromkeys(("geom_pos", "geom_size"), self.floor_id))
        if self._limits is not None:
            rows.append({"jnt_range": self._limits.joint_ids(self.model)})
        return union(rows)

    @cached_property
    def _limits(self) -> ArenaLimits | None:
        limited = any(module.limits_arena for module in self._modules.values())
        return ArenaLimits(self.movables, self.world_params.timestep) if limited else None

    @cached_property
    def floor_id(self) -> np.ndarray:
        """(1,) the floor's geom id."""
        return np.array([self.model.geom("floor").id])

    @cached_property
    def engine(self) -> Engine:
        """The physics engine. Made at first use, because it needs a JAX backend."""
        n_equalities = self.model.neq - sum(module.idle_equalities for module in self._modules.values())
        return make_engine(self.impl, self.model, self.overlay, self.contacts_per_world, n_equalities)

    @cached_property
    def _draw_layout(self) -> Callable[[jax.Array, DomainParams], Layout]:
        """Compiled even where a reset is called eagerly, which would otherwise compile its loop at every call."""
        return jax.jit(partial(draw_layout, self))

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """What can be randomised, by name, with defaults and bounds."""
        parameters = self.floor_range.parameters + [p for module in self._modules.values() for p in module.parameters]
        return {p.name: p for p in parameters}

    @property
    def base(self) -> Base:
        return self

    @property
    def dt(self) -> float:
        """Seconds of one env step."""
        return self.n_frames * self.world_params.timestep

    @property
    def default_params(self) -> DomainParams:
        return default_params(self.parameters)

    @cached_property
    def action_space(self) -> spaces.Dict:
        return spaces.Dict({"move": spaces.Box(-1.0, 1.0, (self.n_agents, 3), np.float32)})

    def check_params(self, params: DomainParams) -> None:
        """Refuses params outside the bounds that the environment was built with.

        Raises:
            ValueError: naming the parameter, its value and its bound.
        """
        check_params(params, self.parameters)

    # --- device ------------------------------------------------------------------------------------------------

    def reset(self, key: jax.Array, params: DomainParams | None = None) -> State:
        check_key("key", key)
        params = self.default_params if params is None else params
        self.check_params(params)
        params = jax.tree.map(jnp.asarray, params)
        layout_key, state_key = jax.random.split(key)
        layout = self._draw_layout(layout_key, params)
        fields = {name: layout.fields[name][ids] for name, ids in self.overlay.items()}
        world = World(fields, layout.active, layout.extents, layout.sites, layout.plan, layout.valid)
        data = self.engine.init(world.fields, layout.qpos)
        world = self.bounded(world, data)
        no = jnp.zeros((), bool)
        return State(
            data=data,
            world=world,
            params=params,
            obs=self._observe(world, data),
            reward=jnp.zeros(self.n_agents),
            terminated=no,
            truncated=no,
            step=jnp.zeros((), jnp.int32),
            key=state_key,
            metrics={"physics_fault": no, "layout_invalid": ~world.valid, "contact_overflow": no},
            mechanics={},
        )

    def step(self, state: State, action: dict[str, jax.Array]) -> State:
        """Moves the agents.

        `action["move"]` (n_agents, 3) is the share of full force along the world's x and y and of full torque about
        z. MuJoCo clamps controls to [-1, 1]. Under jit, where values cannot be looked at, NaN is a physics fault.
        """
        check_action(self.action_space, action)
        engine = self.engine  # gives the modules their ids, where nothing was reset yet
        move = jnp.asarray(action["move"], state.data.ctrl.dtype)
        move = jnp.where(state.world.active[self.agents.kind][:, None], move, 0.0)
        ctrl = with_rows(state.data.ctrl, self.agents.ctrl_ids, move)
        before = state.data.replace(ctrl=jnp.nan_to_num(ctrl))
        world, after, overflow = self._advance(state.world, before)
        fault = self._fault(world, after) | jnp.isnan(ctrl).any()
        after = contain(fault, before, after.replace(engine=engine.renew(after.engine, fault)))
        world = self.bounded(world, after)
        data = engine.pose(world.fields, after)
        step = state.step + 1
        return state.replace(
            data=data,
            world=world,
            obs=self._observe(world, data),
            reward=jnp.zeros_like(state.reward),
            terminated=jnp.zeros((), bool),
            truncated=fault | (step >= self.horizon),
            step=step,
            metrics={
                "physics_fault": fault,
                "layout_invalid": ~world.valid,
                "contact_overflow": overflow & ~fault,
            },
        )

    def bounded(self, world: World, data: Data) -> World:
        """The world with the joint ranges that end at the edge of the arena, where it has any."""
        return world if self._limits is None else self._limits.write(world, data, self.overlay)

    def _advance(self, world: World, data: Data) -> tuple[World, Data, jax.Array]:
        """All physics steps of an env step; the arena's limits follow every one, since boxes turn."""
        if self._limits is None or self.n_frames == 1:
            return world, *self.engine.advance(world.fields, data, self.n_frames)

        def frame(carry: tuple[World, Data], _: None) -> tuple[tuple[World, Data], jax.Array]:
            world, data = carry
            data, overflow = self.engine.advance(world.fields, data, 1)
            return (self.bounded(world, data), data), overflow

        (world, data), overflow = jax.lax.scan(frame, (world, data), length=self.n_frames)
        return world, data, overflow.any()

    @jax.named_scope("observations")
    def _observe(self, world: World, data: Data) -> dict[str, jax.Array]:
        obs: dict[str, jax.Array] = {}
        for module in self._modules.values():
            obs |= module.observation_step(world, data)
        return obs

    def _fault(self, world: World, data: Data) -> jax.Array:
        entities = self.movables
        # Of slides and free joints alike, the first three coordinates are the position itself.
        position = data.qpos[np.concatenate([m.qpos_ids[:, :3] for m in entities])]
        active = jnp.concatenate([world.active[m.kind] for m in entities])
        is_agent = np.concatenate([np.full(m.n_max, m is self.agents) for m in entities])
        return find_fault(data, world.plan, position, active, is_agent)
