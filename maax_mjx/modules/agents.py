"""The agents."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.checks import check_bool, check_choice, check_count, check_count_range
from maax_mjx.common.colours import GREY, team_colour
from maax_mjx.common.keys import named_keys
from maax_mjx.common.observed import AGENT, POSITION, SPIN, TURN, VELOCITY, YAW, Column, Observed
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, PlacementFn, World, uniform_placement
from maax_mjx.modules.entities import Entities
from maax_mjx.modules.from_model import from_model
from maax_mjx.modules.placed import MOST, Places
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Fields, Overlay
from maax_mjx.worldgen import Obj, ObjFromXML

DIAMETER = 0.3
"""Metres."""
MOTORS = ("x", "y", "yaw")
GEAR, DAMPING = 100.0, 10.0
"""Newtons at full control, and N s/m, along x and y; Nm and Nm s/rad about z."""


ARM = (0.13, -0.075, -0.05)
"""Metres from an agent's centre to the middle of its left arm in the published code, a sphere of 0.05 m."""
CONTACTS_WITH_ARMS = 9.0
"""Contact points per agent with arms that collide: each of its three spheres may touch what one alone may."""


class Agents(Entities):
    """Spheres of 0.15 m and 1 kg that slide along x, y, z and turn about z.

    Motors push along the world's x and y and turn about z. An agent faces -y at yaw 0, where its two hands are.

    Args:
        n_agents: number of agents; or by team, a number or (low, high), drawn per world:
            `{"hiders": (1, 3), "seekers": 2}`. The slots of the first team come first. Absent agents are masked
            (`agent_mask`), parked and ignore actions.
        placement_fn: one function for all, or a list with one per slot.
        colours: RGBA by team, `{"reds": (0.8, 0.1, 0.1, 1)}`, or per slot. Teams that have none get one by their order,
            blue first and orange second; a single team is grey.
        random_yaw: whether agents start facing anywhere; else all face -y.
        friction: sliding friction, or a range, the parameter `agent_friction`; None keeps MuJoCo's default of 1.
        damping: damping along x, y (N s/m) and of yaw (Nm s/rad), or a range, the parameter `agent_damping`; z keeps 1.
        gear: force along x and y in N, and torque in Nm, at full control, or a range, the parameter `agent_gear`.
        per_object: whether every agent draws its own value from a range; otherwise all agents of a world share one.
        arms: whether their hands are the published arms, which collide and make agents 0.36 m wide; otherwise hands
            only show where an agent faces, and stop rays.
        polar_obs: whether `agent_qpos_qvel` has cos and sin of the yaw instead of the yaw itself.

    Raises:
        ValueError: no agents, a team without agents, or a list of the wrong length.
    """

    kind = "agent"
    rest_depth = 3.67e-4
    contacts_each = 4.5
    is_round = True

    def __init__(
        self,
        n_agents: int | Mapping[str, int | tuple[int, int]],
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        colours: Mapping[str, Sequence[float]] | Sequence[Sequence[float]] | None = None,
        random_yaw: bool = False,
        *,
        friction: float | tuple[float, float] | None = None,
        damping: float | tuple[float, float] = DAMPING,
        gear: float | tuple[float, float] = GEAR,
        per_object: bool = True,
        polar_obs: bool = False,
        arms: bool = False,
    ):
        self.team_sizes, self._fixed = _check_teams(n_agents), not isinstance(n_agents, Mapping)
        super().__init__(
            sum(high for _, high in self.team_sizes.values()),
            (DIAMETER, DIAMETER, DIAMETER),
            placement_fn,
            friction=friction,
            random_yaw=random_yaw,
            per_object=per_object,
            minimum=1,
        )
        self.damping = Ranged("agent_damping", damping, argument="damping")
        self.gear = Ranged("agent_gear", gear, above=True, argument="gear")
        self.polar_obs = check_bool("polar_obs", polar_obs)
        self.arms = check_bool("arms", arms)
        if self.arms:
            self.contacts_each = CONTACTS_WITH_ARMS
        by_slot = self._by_slot(colours) if colours is None or isinstance(colours, Mapping) else colours
        try:
            self.colours = np.asarray(by_slot, float)
        except (TypeError, ValueError):
            self.colours = np.zeros(0)
        if self.colours.shape != (self.n_max, 4) or not ((self.colours >= 0) & (self.colours <= 1)).all():
            raise ValueError(
                f"colours: got {colours!r}; takes {self.n_max} colours of four numbers in [0, 1], one each, or "
                "one by team"
            )

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        return {f"n_{team}": size for team, size in self.team_sizes.items()}

    @property
    def team_index(self) -> np.ndarray:
        """Team of every slot, (n_max,)."""
        return np.repeat(np.arange(len(self.team_sizes)), [high for _, high in self.team_sizes.values()])

    def _by_slot(self, colours: Mapping[str, Sequence[float]] | None) -> list[Sequence[float]]:
        """Colour of every slot: its team's, or one by the number of the team."""
        given, teams = colours or {}, list(self.team_sizes)
        for team in given:
            check_choice("colours", team, teams)
        default = team_colour if len(teams) > 1 else lambda _: GREY
        return [given.get(teams[number], default(number)) for number in self.team_index]

    @property
    def ranges(self) -> list[Ranged]:
        return [*super().ranges, self.damping, self.gear]

    @property
    def parameters(self) -> list[Parameter]:
        # A single team of a fixed number: none of the agents can be absent.
        counts = [Parameter(name, pair, pair if self._fixed else (0, pair[1])) for name, pair in self.counts.items()]
        return counts + [p for ranged in self.ranges for p in ranged.parameters]

    @property
    def overlay(self) -> Overlay:
        overlay = super().overlay
        if self.damping.varies:
            overlay["dof_damping"] = self.driven_dofs.reshape(-1)
        if self.gear.varies:
            overlay["actuator_gear"] = self.ctrl_ids.reshape(-1)
        return overlay

    def check(self, grid_size: int, floor_size: float) -> None:
        super().check(grid_size, floor_size)
        if self.inner:
            raise ValueError(
                f"make: {type(self).__name__} returned an agent with the joint {self.inner[0].name!r} inside, which no "
                "motor drives and no agent observes; takes bodies without joints inside"
            )

    def make(self, name: str) -> Obj:
        return ObjFromXML("agent", name, rgba=self.colours[int(name.removeprefix(self.kind))])

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        super().spec_step(spec)
        for name in self.names:
            for side, x in (("left", 1), ("right", -1)) if self.arms else ():
                hand = spec.geom(f"{name}:hand_{side}")
                hand.pos, hand.contype, hand.conaffinity = (x * ARM[0], *ARM[1:]), 1, 1
            for motor in MOTORS:
                spec.joint(f"{name}:{motor}").damping[0] = self.damping.high
                spec.actuator(f"{name}:{motor}").gear[0] = self.gear.high

    @from_model
    def ctrl_ids(self) -> np.ndarray:
        """Actuator ids (n_max, 3) of the motors along x and y and about z."""
        return np.array([[self.model.actuator(name).id for name in row] for row in self._motors()], int)

    @from_model
    def driven_dofs(self) -> np.ndarray:
        """Ids (n_max, 3) of the degrees of freedom that the motors drive."""
        return np.array([[self.model.joint(name).dofadr[0] for name in row] for row in self._motors()], int)

    def _motors(self) -> list[list[str]]:
        return [[f"{name}:{motor}" for motor in MOTORS] for name in self.names]

    def seeds(self, key: jax.Array, layout: Layout) -> jax.Array:
        return self._by_team(key, layout.seeds)

    def draw(self, ranged: Ranged, key: jax.Array, params: DomainParams) -> jax.Array:
        if not self.per_object:
            return super().draw(ranged, key, params)
        return self._by_team(key, lambda own_key, n: ranged.draw(own_key, params, n))

    def _by_team(self, key: jax.Array, draw: Callable[[jax.Array, int], jax.Array]) -> jax.Array:
        """Returns draws (n_max, ...) by `draw(key, n)`, with a key per team: other teams' maxima do not matter."""
        sizes = [high for _, high in self.team_sizes.values()]
        drawn = jax.vmap(draw, (0, None))(named_keys(key, self.team_sizes), max(sizes))
        return drawn[self.team_index, np.concatenate([np.arange(n) for n in sizes])]

    def draw_fields(self, key: jax.Array, fields: Fields, params: DomainParams, places: Places) -> Fields:
        fields = super().draw_fields(key, fields, params, places)
        if self.damping.varies:
            damping = self.draw(self.damping, key, params)[:, None]
            fields = fields | {"dof_damping": fields["dof_damping"].at[self.driven_dofs].set(damping)}
        if self.gear.varies:
            gear = self.draw(self.gear, key, params)[:, None]
            fields = fields | {"actuator_gear": fields["actuator_gear"].at[self.ctrl_ids, 0].set(gear)}
        return fields

    def headings(self, data: Data) -> jax.Array:
        """Returns where agents look, in radians from the x axis: (n_agents,), of one world; at yaw 0 they face -y."""
        return data.qpos[self.qpos_ids[:, 3]] - np.pi / 2

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Returns `agent_qpos_qvel` (n, 8): x, y, z, yaw and their velocities, (n, 9) with `polar_obs`;
        `agent_pos` (n, 3); `agent_angle` (n, 1): heading, yaw - pi/2 wrapped to [-pi, pi); `agent_mask` (n,). Absent
        agents are zero.
        """
        active = world.active[self.kind]
        qpos, qvel = data.qpos[self.qpos_ids], data.qvel[self.qvel_ids]
        yaw = qpos[:, 3:]
        turn = jnp.concatenate([jnp.cos(yaw), jnp.sin(yaw)], axis=1) if self.polar_obs else yaw
        obs = {
            "agent_qpos_qvel": jnp.concatenate([qpos[:, :3], turn, qvel], axis=1),
            "agent_pos": qpos[:, :3],
            "agent_angle": jnp.mod(yaw + jnp.pi / 2, 2 * jnp.pi) - jnp.pi,
        }
        return {name: jnp.where(active[:, None], x, 0.0) for name, x in obs.items()} | {"agent_mask": active}

    def declared(self) -> dict[str, Observed]:
        turn = TURN if self.polar_obs else YAW
        return {
            "agent_qpos_qvel": Observed((AGENT,), (*POSITION, *turn, *VELOCITY, *SPIN), private=False),
            "agent_pos": Observed((AGENT,), POSITION, private=False, derived=True),
            "agent_angle": Observed((AGENT,), (Column("heading", "rad", np.pi),), private=False, derived=True),
            "agent_mask": Observed((AGENT,), private=False),
        }


def _check_teams(n_agents: int | Mapping[str, int | tuple[int, int]]) -> dict[str, tuple[int, int]]:
    """Returns the smallest and the largest number of every team, by name."""
    if not isinstance(n_agents, Mapping):
        if isinstance(n_agents, Sequence):
            raise ValueError(
                f"n_agents: got {n_agents!r}; takes a whole number in [1, {MOST}], or numbers by team, "
                "{'reds': 2, 'blues': 1}"
            )
        n = check_count("n_agents", n_agents, 1, MOST)
        return {"agents": (n, n)}
    if not n_agents:
        raise ValueError("n_agents: got no teams; takes at least one")
    for name, count in n_agents.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise ValueError(f"n_agents: got a team named {name!r}; takes names that are Python identifiers")
        if not check_count_range(f"n_agents[{name!r}]", count, 0, MOST)[1]:
            raise ValueError(f"n_agents: got no agents in team {name!r}; takes at least one, or leave the team out")
    return {name: check_count_range(f"n_agents[{name!r}]", count, 0, MOST) for name, count in n_agents.items()}
