"""`Composition`: modules, and the model that is made of them."""

from __future__ import annotations

import gc
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Annotated, Any, cast
from weakref import WeakSet

import jax
import mujoco
import numpy as np

from maax_mjx.common.annotated import Bounds, PositiveCount, check_value
from maax_mjx.common.checks import check_choice, check_count
from maax_mjx.common.observed import Observed
from maax_mjx.common.params import DomainParams, Parameter, check_params, default_params
from maax_mjx.core.arena_limits import ArenaLimits
from maax_mjx.core.capacity import check_module, contact_capacity
from maax_mjx.core.hooks import check_names, checked_observations, checked_overlay, declared_names
from maax_mjx.core.named import Named
from maax_mjx.layout import World
from maax_mjx.modules import Agents, Entities, Module, Sites
from maax_mjx.modules.from_model import from_model
from maax_mjx.modules.placed import MOST
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Engine, Overlay, check_impl, make_engine, union
from maax_mjx.physics.watched import Watch, Watched
from maax_mjx.worldgen import Floor, WorldBuilder, WorldParams
from maax_mjx.worldgen.default_pose import with_default_poses

GridSize = Annotated[int, Bounds(8, 1000)]
FloorSize = Annotated[
    float | tuple[float, float], Bounds(0, 1000, above=True, takes="a positive number of metres, up to 1000")
]
Contacts = Annotated[int, Bounds(1, 1_000_000)]
USUAL = ("box", "ramp")
"""Modules of objects that mechanics are about where none are named."""


class Around(WeakSet):
    """The wrappers around an environment, which its copies do not have."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Around:
        return Around()


class Composition:
    """Modules, and what is made of them on the host: the model, the overlay and the engine.

    Derived properties are computed when they are first read, and again after another module was added. The arguments
    are those of `Base`.

    Attributes:
        watch: what is shown every physics step of single worlds; set it before anything is read. See `diagnose`.
    """

    watch: Watch | None = None

    def __init__(
        self,
        n_agents: int,
        n_frames: int,
        grid_size: int,
        floor_size: float | tuple[float, float],
        horizon: int | None,
        impl: str,
        world_params: WorldParams | None,
        contacts_per_world: int | None,
        placement_tries: int | None = None,
    ):
        self.n_agents = check_count("n_agents", n_agents, 1, MOST)
        self.n_frames = check_count("n_frames", n_frames, minimum=1)
        self.grid_size = int(check_value("grid_size", grid_size, GridSize))
        self.floor_range = Ranged("floor_size", check_value("floor_size", floor_size, FloorSize))
        check_value("horizon", horizon, PositiveCount | None)
        self.horizon = None if horizon is None else int(horizon)
        self.impl = check_impl(impl)
        self.world_params = WorldParams() if world_params is None else world_params
        if not isinstance(self.world_params, WorldParams):
            raise ValueError(f"world_params: got {world_params!r}; takes a WorldParams")
        if self.world_params.placement_margin:
            raise ValueError(
                f"world_params.placement_margin: got {self.world_params.placement_margin:g}; takes 0 here: layouts are "
                "drawn on the device, by placement functions, such as maax.separation_placement(radius)"
            )
        self._contacts_per_world = check_value("contacts_per_world", contacts_per_world, Contacts | None)
        self.placement_tries = check_value("placement_tries", placement_tries, PositiveCount | None)
        self._modules: Named[Module] = Named("modules")
        self._build = object()
        self.around = Around()

    # --- modules -----------------------------------------------------------------------------------------------

    def add_module(self, module: Module) -> None:
        """Adds a module; modules draw in the order in which they were added.

        States made before do not fit the environment any more: add all modules first, then reset.

        Raises:
            ValueError: a module that does not fit the environment or the modules before it; an environment that has
                wrappers, which would not know the module.
        """
        if self.around:
            # Wrappers that nobody has any more may wait for the collector, since their compiled functions know them.
            gc.collect()
        if self.around:
            layers = ", ".join(sorted({type(layer).__name__ for layer in self.around}))
            raise ValueError(
                f"module: got {module!r} for an environment that {layers} wraps; takes modules before wrappers: "
                "maax.make(name, modules=[...]) for a game, or maax.extended(env, modules=[...])"
            )
        self.attach(module)

    def attach(self, module: Module) -> None:
        """Adds a module below wrappers: for a wrapper that adds one to its own copy of an environment.

        Raises:
            ValueError: as `add_module`.
        """
        if not isinstance(module, Module):
            raise ValueError(f"module: got {module!r}; takes a Module")
        if module._owner not in (None, self):
            raise ValueError(f"module: this {type(module).__name__} belongs to another environment; make a new one")
        floor_sizes = self.floor_range.low, self.floor_range.high
        check_module(module, list(self._modules.values()), self.n_agents, self.grid_size, floor_sizes)
        names = declared_names(module)
        for other in self._modules.values():
            check_names(module, names, other, declared_names(other))
        module._owner = self
        self._modules[module.name] = module
        self._build = object()

    @property
    def build(self) -> object:
        """A token of this composition, replaced when a module is added."""
        return self._build

    @property
    def modules(self) -> Mapping[str, Module]:
        """The modules by name."""
        return self._modules

    @property
    def movables(self) -> list[Entities]:
        """The modules whose entities can move, if they have any."""
        return [m for m in self._modules.values() if isinstance(m, Entities) and m.n_max]

    def objects(self, names: Sequence[str] | None = None) -> list[Entities]:
        """Returns the modules of these names, whose objects can move; None is boxes and ramps, if there are any.

        Raises:
            ValueError: an unknown name, a module whose objects cannot move, a name given twice, or the agents.
        """
        known = {m.name: m for m in self._modules.values() if _is_object(m)}
        return _named([name for name in USUAL if name in known] if names is None else names, known)

    def objects_and_sites(self, names: Sequence[str] | None = None) -> list[Entities | Sites]:
        """Returns the modules of these names, of objects that can move or of marks on the floor; None as of `objects`.

        Raises:
            ValueError: an unknown name, another module, a name given twice, or the agents.
        """
        if names is None:
            return [*self.objects()]
        return _named(names, {m.name: m for m in self._modules.values() if _is_object(m) or isinstance(m, Sites)})

    @property
    def sites(self) -> dict[str, Sites]:
        """The modules of marks on the floor, by kind."""
        return {m.kind: m for m in self._modules.values() if isinstance(m, Sites) and m.n_max}

    @property
    def agents(self) -> Agents:
        """The agents' module.

        Raises:
            RuntimeError: the environment has no agents.
        """
        agents = self._modules.get(Agents.kind)
        if not isinstance(agents, Agents):
            raise RuntimeError(f"Base: got no agents; add_module(Agents({self.n_agents}, ...)) before its first use")
        return agents

    # --- the model ---------------------------------------------------------------------------------------------

    @from_model
    def spec(self) -> mujoco.MjSpec:
        """The MuJoCo spec, with the maximum number of every kind."""
        _ = self.agents
        builder = WorldBuilder(self.world_params)
        builder.append(self._floor)
        spec = builder.to_spec()
        # Modules may change how long qpos is: default poses are in `qpos_start`.
        for key in list(spec.keys):
            spec.delete(key)
        for module in self._modules.values():
            module.spec_step(spec)
        if self._limits is not None:
            self._limits.edit(spec)
        # Bodies that can be absent float where they are parked; the overlay gives them weight when they are in play.
        for body in spec.bodies[1:]:
            body.gravcomp = 1.0
        # Two geoms without friction touch in one row; three would be so stiff that float32 cannot solve for them.
        for geom in spec.geoms:
            if geom.condim == 3 and geom.friction[0] == 0:
                geom.condim = 1
        # Not max_geom_pairs: MJX keeps the pairs whose bounding spheres overlap most, and those of long walls overlap
        # everything, so that it would leave out true contacts.
        spec.add_numeric(name="max_contact_points", data=[self.contacts_per_world], size=1)
        return spec

    @from_model
    def _floor(self) -> Floor:
        """The object tree: the floor, with the objects of all modules.

        Raises:
            ValueError: two modules that give objects the same name.
        """
        floor = Floor(self.floor_size)
        named_by: dict[str, str] = {}
        for module in self._modules.values():
            built = len(floor.children)
            module.build_step(floor, self.grid_size)
            for name in {name for child in floor.children[built:] for name in child.obj.given_names()}:
                if name in named_by:
                    raise ValueError(
                        f"modules: got {named_by[name]!r} and {module.name!r}, which both name an object {name!r}; "
                        "takes names of their own"
                    )
                named_by[name] = module.name
        return floor

    @from_model
    def model(self) -> mujoco.MjModel:
        """The compiled MuJoCo model."""
        return self.spec.compile()

    @from_model
    def qpos_start(self) -> np.ndarray:
        """The qpos (nq,) from which layouts begin: parked, in default poses."""
        _ = self.spec  # It names the objects.
        return with_default_poses(self.model, self._floor.default_poses())

    @from_model
    def overlay(self) -> Overlay:
        """The rows of model fields in which worlds differ."""
        rows = [checked_overlay(module, self.model) for module in self._modules.values()]
        if self.floor_range.varies:
            rows.append(dict.fromkeys(("geom_pos", "geom_size"), self.floor_id))
        if self._limits is not None:
            rows.append({"jnt_range": self._limits.joint_ids(self.model)})
        return union(rows)

    @from_model
    def engine(self) -> Engine:
        """The physics engine, made when it is first read, because it needs a JAX backend."""
        n_equalities = self.model.neq - sum(module.idle_equalities for module in self._modules.values())
        engine = make_engine(self.impl, self.model, self.overlay, self.contacts_per_world, n_equalities)
        return engine if self.watch is None else cast(Engine, Watched(engine, self.watch))

    @from_model
    def position_ids(self) -> np.ndarray:
        """The coordinates of the positions of all that moves, in the order of `movables`: (n, 3)."""
        # The first three coordinates are the position, for slides and for free joints.
        return np.concatenate([m.qpos_ids[:, :3] for m in self.movables])

    @from_model
    def velocity_ids(self) -> np.ndarray:
        """The degrees of freedom of their translations, (n, 3)."""
        return np.concatenate([m.qvel_ids[:, :3] for m in self.movables])

    @from_model
    def is_agent(self) -> np.ndarray:
        """Which of all that moves is an agent: (n,) bool."""
        return np.concatenate([np.full(m.n_max, m is self.agents) for m in self.movables])

    @from_model
    def parameters(self) -> dict[str, Parameter]:
        """The parameters that can be randomised, by name, with defaults and bounds."""
        parameters = self.floor_range.parameters + [p for module in self._modules.values() for p in module.parameters]
        return {p.name: p for p in parameters}

    @from_model
    def floor_id(self) -> np.ndarray:
        """Geom id of the floor, (1,)."""
        return np.array([self.model.geom("floor").id])

    @property
    def floor_size(self) -> float:
        """Largest edge of the floor in metres; a world's own is `state.world.plan.floor_size`."""
        return self.floor_range.high

    @property
    def contacts_per_world(self) -> int:
        """Contact points per world that the `jax` and `warp` engines make room for."""
        return self._contacts_per_world or contact_capacity(self._modules.values())

    @property
    def dt(self) -> float:
        """Seconds of one env step."""
        return self.n_frames * self.world_params.timestep

    # --- what environments read of it --------------------------------------------------------------------------

    @property
    def default_params(self) -> DomainParams:
        """The ranges that the modules were built with."""
        return default_params(self.parameters)

    def check_params(self, params: DomainParams) -> None:
        """Refuses params outside the environment's bounds.

        Raises:
            ValueError: a range outside its bound; the message names the parameter, its value and its bound.
        """
        check_params(params, self.parameters)

    def declared(self) -> dict[str, Observed]:
        """Returns what the modules declare about their observations."""
        return {name: one for module in self._modules.values() for name, one in module.declared().items()}

    def bounded(self, world: World, data: Data) -> World:
        """Returns the world with joint ranges that end at the edge of the arena, where it uses them. Pure."""
        return world if self._limits is None else self._limits.write(world, data, self.overlay, self.model)

    @jax.named_scope("observations")
    def module_observations(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Returns all modules' observations by name. Pure.

        Raises:
            ValueError: two modules observe the same name.
        """
        parts = [(module, checked_observations(module, world, data)) for module in self._modules.values()]
        for (module, new), (other, old) in combinations(reversed(parts), 2):
            check_names(module, new, other, old)
        return {name: x for _, part in parts for name, x in part.items()}

    @property
    def is_limited(self) -> bool:
        """Whether joint ranges close the arena."""
        return self._limits is not None

    @from_model
    def _limits(self) -> ArenaLimits | None:
        limited = any(module.limits_arena for module in self._modules.values())
        return ArenaLimits(self.movables, self.world_params.timestep) if limited else None


def _is_object(module: Module) -> bool:
    """Whether it has objects that can move, other than agents."""
    return isinstance(module, Entities) and not isinstance(module, Agents)


def _named(names: Sequence[str], known: Mapping[str, Any]) -> list[Any]:
    if isinstance(names, str) or len(set(names)) < len(names):
        raise ValueError(f"objects: got {names!r}; takes a list of different names of {sorted(known)}")
    return [known[check_choice("objects", name, known)] for name in names]
