"""What agents do with tools, as numbers: enclosures, doors, ramps, and who carried what."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from maax_mjx.common.arrays import running_mean
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.wrappers.enclosure import Footprints, doors_shut, enclosed
from maax_mjx.wrappers.grabs.wrapper import GrabObjects
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.senses import LineOfSight
from maax_mjx.wrappers.stats import TrackStats
from maax_mjx.wrappers.teams import HIDERS, SEEKERS, TeamMembership
from maax_mjx.wrappers.wrapper import StateWrapper, find

HIGH = 0.45
"""Metres of an agent's centre above the floor from which on it is on top of something."""


class Tools(struct.PyTreeNode):
    """The memory from which numbers are computed.

    Attributes:
        before: (n_objects, 2) metres, where objects were after the previous step.
        held: (n_agents,) int32, what agents held after the previous step, -1 for nothing.
        played: () int32, steps after preparation so far; fewer than `state.step` says in an episode that began later.
        totals: metrics of the episode so far, by name.
    """

    before: jax.Array
    held: jax.Array
    played: jax.Array
    totals: dict[str, jax.Array]


class TrackTools(StateWrapper):
    """Adds to `state.metrics` what teams do with objects, as the stages of Baker et al. are told by.

    After preparation:

    - `elevated`: whether a seeker has been on top of something, 1 or 0.
    - `seen`: share of the steps in which a seeker sees a hider; with `LineOfSight` inside.
    - `breach`: whether hiders who were enclosed at the end of preparation were seen later; likewise.

    At every step, and as `<name>_prep` at the end of preparation, zero before:

    - `enclosed`: whether no seeker can reach any hider along the floor, between walls and boxes as they stand.
    - `doors_blocked`: share of the doors without a free way of 0.3 m.
    - `ramp_inside`: share of the ramps in the quadrant; in worlds without one, in a room.

    With `GrabObjects` inside, in the episode so far and as `<name>_prep`:

    - `hiders_carried_box`, `seekers_carried_ramp`, ...: metres that objects of a kind went while the team held them.

    It looks at every cell of the floor in every step, and is meant for evaluation.

    Args:
        env: environment of hiders and seekers, with `TeamMembership` and `PreparationPhase` inside.
    """

    name = "tools"
    requires = (TeamMembership, PreparationPhase)
    follows = (GrabObjects, LineOfSight, TrackStats)

    def __init__(self, env: Environment):
        super().__init__(env)
        base = self.base
        teams = self.inner(TeamMembership)
        self._teams = {name: np.asarray(teams.of(name)) for name in (HIDERS, SEEKERS)}
        self._prep_steps = self.inner(PreparationPhase).n_steps
        movable: list[Entities] = [m for m in base.movables if m is not base.agents and m.n_max]
        # Ramps do not enclose: agents get over them.
        self._blocking = [m for m in movable if m.kind != "ramp"]
        self._ramps = next((m for m in movable if m.kind == "ramp"), None)
        self._sight = find(env, LineOfSight) is not None
        self._grabs = find(env, GrabObjects)
        self._carried = [m for m in self._grabs.modules if m.n_max] if self._grabs else []
        self._radius = float(base.agents.extent[0]) / 2

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        return self.started(self.env.begin(key, params))

    def started(self, state: State) -> State:
        """Returns the state of the inner environment at the beginning of an episode with the numbers added."""
        now = self.moment(state)
        totals = {name: jnp.zeros(()) for name in ("elevated", *(("seen", "breach") if self._sight else ()))}
        for module in self._carried:
            totals |= {f"{team}_carried_{module.kind}": jnp.zeros(()) for team in self._teams}
        totals |= {f"{name}_prep": jnp.zeros(()) for name in (*now, *self._carrying(totals))}
        if not self._prep_steps:
            totals |= {f"{name}_prep": value for name, value in now.items()}
        return self._noted(state, Tools(self._places(state), self._held(state), jnp.zeros((), jnp.int32), totals), now)

    def observe(self, state: State) -> State:
        tools: Tools = state.mechanics[self.name]
        now, here, held = self.moment(state), self._places(state), self._held(state)
        totals = dict(tools.totals)
        way = jnp.linalg.norm(here - tools.before, axis=-1)
        for team, mine in self._teams.items():
            # Held before and after the step: an object that is let go slides on by itself.
            holds = jnp.where(mine & (held == tools.held), held, -1)
            carried = (holds[:, None] == jnp.arange(way.shape[0])).any(axis=0)
            for module, rows in self._rows():
                totals[f"{team}_carried_{module.kind}"] += jnp.where(carried[rows], way[rows], 0.0).sum()
        ends = state.step == self._prep_steps
        for name, value in (now | self._carrying(totals)).items():
            totals[f"{name}_prep"] = jnp.where(ends, value, totals[f"{name}_prep"])
        playing = state.step > self._prep_steps
        played = tools.played + playing
        hiders, seekers = self._teams[HIDERS], self._teams[SEEKERS]
        if self._sight:
            sees = state.mechanics[LineOfSight.name]["sees_agent"]
            seen = (sees & seekers[:, None] & hiders).any()
            totals["seen"] = running_mean(totals["seen"], seen, playing, played)
            totals["breach"] = totals["enclosed_prep"] * (totals["seen"] > 0)
        agents = self.base.agents
        there = state.world.active[agents.kind]
        up = (state.data.xpos[agents.body_ids, 2] > HIGH) & seekers & there
        totals["elevated"] = jnp.maximum(totals["elevated"], up.any() & playing)
        return self._noted(state, Tools(here, held, played, totals), now)

    def _noted(self, state: State, tools: Tools, now: dict[str, jax.Array]) -> State:
        return self.remember(state, tools).replace(metrics=state.metrics | now | tools.totals)

    def moment(self, state: State) -> dict[str, jax.Array]:
        """Returns the numbers that say how things stand in a state: `enclosed`, `doors_blocked`, `ramp_inside`."""
        world, plan, agents = state.world, state.world.plan, self.base.agents
        things = self._footprints(state)
        xy, there = state.data.xpos[agents.body_ids, :2], world.active[agents.kind]
        hiders, seekers = (jnp.column_stack([xy, there & mine]) for mine in self._teams.values())
        now = {"enclosed": enclosed(plan, things, self._radius, seekers, hiders).astype(jnp.float32)}
        if plan.doors.shape[0]:
            n_doors = jnp.maximum(plan.door_mask.sum(), 1)
            now["doors_blocked"] = doors_shut(plan, things).sum() / n_doors
        if self._ramps is not None:
            ramps = state.data.xpos[self._ramps.body_ids, :2]
            cell = plan.floor_size / self.base.grid_size
            has = (plan.quadrant[2:] > plan.quadrant[:2]).all()
            rooms = jnp.where(has, jnp.zeros_like(plan.rooms).at[:1].set(plan.quadrant), plan.rooms) * cell
            inside = (ramps[:, None] > rooms[:, :2]) & (ramps[:, None] < rooms[:, 2:])
            active = world.active[self._ramps.kind]
            now["ramp_inside"] = (inside.all(-1).any(-1) & active).sum() / jnp.maximum(active.sum(), 1)
        return now

    def _footprints(self, state: State) -> Footprints:
        """Returns those of boxes, and of all else that stands on the floor and can be moved."""
        parts = [Footprints(jnp.zeros((0, 2)), jnp.zeros((0, 2)), jnp.zeros((0, 2)))]
        for module in self._blocking:
            quat = state.data.xquat[module.body_ids]
            yaw = 2 * jnp.arctan2(quat[:, 3], quat[:, 0])
            half = jnp.where(state.world.active[module.kind][:, None], module.extents_of(state.world)[:, :2] / 2, 0.0)
            turn = jnp.column_stack([jnp.cos(yaw), jnp.sin(yaw)])
            parts.append(Footprints(state.data.xpos[module.body_ids, :2], half, turn))
        return Footprints(*(jnp.concatenate(x) for x in zip(*parts, strict=True)))

    def _places(self, state: State) -> jax.Array:
        bodies = [m.body_ids for m in self._carried]
        return state.data.xpos[np.concatenate(bodies), :2] if bodies else jnp.zeros((0, 2))

    def _held(self, state: State) -> jax.Array:
        none = jnp.full(self.base.n_agents, -1, jnp.int32)
        return state.mechanics[GrabObjects.name].held if self._grabs else none

    def _rows(self) -> list[tuple[Entities, slice]]:
        """Returns the modules that can be carried, and the rows of their objects."""
        ends = np.cumsum([m.n_max for m in self._carried])
        return [(m, slice(int(end) - m.n_max, int(end))) for m, end in zip(self._carried, ends, strict=True)]

    def _carrying(self, totals: dict[str, jax.Array]) -> dict[str, jax.Array]:
        return {name: x for name, x in totals.items() if "_carried_" in name and not name.endswith("_prep")}
