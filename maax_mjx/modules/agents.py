"""The agents."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.checks import check_count, check_count_range
from maax_mjx.common.keys import named_keys
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, PlacementFn, World, uniform_placement
from maax_mjx.modules.entities import Entities
from maax_mjx.modules.placed import Places
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Fields, Overlay
from maax_mjx.worldgen import Obj, ObjFromXML

DIAMETER = 0.3
MOTORS = ("x", "y", "yaw")
GEAR, DAMPING = 100.0, 10.0


class Agents(Entities):
    """Spheres of 0.15 m and 1 kg that slide along x, y, z and turn about z.

    Motors push along the world's x and y and turn about z. An agent faces -y at yaw 0, where its two hands are.

    Args:
        n_agents: how many; or by team, how many or (low, high), drawn per world: `{"hiders": (1, 3), "seekers": 2}`.
            The slots of the first team come first. Absent agents are masked (`agent_mask`), parked and deaf to actions.
        placement_fn: one function for all, or a list with one per slot.
        colors: RGBA per slot; None is grey for all.
        random_yaw: whether agents start facing anywhere; else all face -y.
        friction: sliding friction, or a range, the parameter `agent_friction`; None keeps MuJoCo's default of 1.
        damping: of x, y (N s/m) and yaw (Nm s/rad), or a range, the parameter `agent_damping`; z keeps 1.
        gear: force along x and y in N, and torque in Nm, at full control, or a range, the parameter `agent_gear`.
        per_object: whether every agent draws its own from the ranges, or all of a world share one draw.
        polar_obs: whether `agent_qpos_qvel` has cos and sin of the yaw, or the yaw itself.

    Raises:
        ValueError: no agent at all, or a list of the wrong length.
    """

    name = "agents"
    kind = "agent"
    count_name = "n_agents"
    friction_name = "agent_friction"
    rest_depth = 3.67e-4
    contacts_each = 4.5
    is_round = True

    def __init__(
        self,
        n_agents: int | Mapping[str, int | tuple[int, int]],
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        colors: Sequence[Sequence[float]] | None = None,
        random_yaw: bool = False,
        *,
        friction: float | tuple[float, float] | None = None,
        damping: float | tuple[float, float] = DAMPING,
        gear: float | tuple[float, float] = GEAR,
        per_object: bool = True,
        polar_obs: bool = False,
    ):
        self.teams, self._fixed = _check_teams(n_agents), not isinstance(n_agents, Mapping)
        super().__init__(
            sum(high for _, high in self.teams.values()),
            (DIAMETER, DIAMETER, DIAMETER),
            placement_fn,
            friction=friction,
            random_yaw=random_yaw,
            per_object=per_object,
            minimum=1,
        )
        self.damping = Ranged("agent_damping", damping, argument="damping")
        self.gear = Ranged("agent_gear", gear, above=True, argument="gear")
        self.polar_obs = polar_obs
        colors = [(0.5, 0.5, 0.5, 1.0)] * self.n_max if colors is None else colors
        try:
            self.colors = np.asarray(colors, float)
        except (TypeError, ValueError):
            self.colors = np.zeros(0)
        if self.colors.shape != (self.n_max, 4) or not ((self.colors >= 0) & (self.colors <= 1)).all():
            raise ValueError(f"colors: got {colors!r}; takes {self.n_max} colours of four numbers in [0, 1], one each")

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        return self.teams

    @property
    def team_index(self) -> np.ndarray:
        """(n_max,) the team of every slot."""
        return np.repeat(np.arange(len(self.teams)), [high for _, high in self.teams.values()])

    @property
    def ranges(self) -> list[Ranged]:
        return [*super().ranges, self.damping, self.gear]

    @property
    def parameters(self) -> list[Parameter]:
        # One team of a fixed number is all that is known of it: none of the agents can be absent.
        counts = [Parameter(name, pair, pair if self._fixed else (0, pair[1])) for name, pair in self.teams.items()]
        return counts + [p for ranged in self.ranges for p in ranged.parameters]

    @property
    def overlay(self) -> Overlay:
        overlay = super().overlay
        if self.damping.varies:
            overlay["dof_damping"] = self.driven_dofs.reshape(-1)
        if self.gear.varies:
            overlay["actuator_gear"] = self.ctrl_ids.reshape(-1)
        return overlay

    def make(self, name: str) -> Obj:
        return ObjFromXML("agent", name, rgba=self.colors[int(name.removeprefix(self.kind))])

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        super().spec_step(spec)
        for name in self.names:
            for motor in MOTORS:
                spec.joint(f"{name}:{motor}").damping[0] = self.damping.high
                spec.actuator(f"{name}:{motor}").gear[0] = self.gear.high

    def cache_step(self, model: mujoco.MjModel) -> None:
        super().cache_step(model)
        names = [[f"{name}:{motor}" for motor in MOTORS] for name in self.names]
        self.ctrl_ids = np.array([[model.actuator(n).id for n in row] for row in names], int)
        self.driven_dofs = np.array([[model.joint(n).dofadr[0] for n in row] for row in names], int)

    def seeds(self, key: jax.Array, layout: Layout) -> jax.Array:
        return self._by_team(key, layout.seeds)

    def draw(self, ranged: Ranged, key: jax.Array, params: DomainParams) -> jax.Array:
        if not self.per_object:
            return super().draw(ranged, key, params)
        return self._by_team(key, lambda own_key, n: ranged.draw(own_key, params, n))

    def _by_team(self, key: jax.Array, draw: Callable[[jax.Array, int], jax.Array]) -> jax.Array:
        """(n_max, ...) of `draw(key, n)`, every team's from its own key: another's maximum does not move it."""
        sizes = [high for _, high in self.teams.values()]
        drawn = jax.vmap(draw, (0, None))(named_keys(key, self.teams), max(sizes))
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

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """`agent_qpos_qvel` (n, 8): x, y, z, yaw and their velocities, (n, 9) with `polar_obs`; `agent_pos` (n, 3);
        `agent_angle` (n, 1): heading, yaw - pi/2 wrapped to [-pi, pi); `agent_mask` (n,). Absent ones are zero.
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


def _check_teams(n_agents: int | Mapping[str, int | tuple[int, int]]) -> dict[str, tuple[int, int]]:
    """By parameter name ("n_hiders"), the smallest and the largest number of every team."""
    if not isinstance(n_agents, Mapping):
        n = check_count("n_agents", n_agents, minimum=1)
        return {"n_agents": (n, n)}
    for name in n_agents:
        if not isinstance(name, str) or not name.isidentifier():
            raise ValueError(f"n_agents: got a team named {name!r}; takes names that are Python identifiers")
    teams = {f"n_{name}": check_count_range(f"n_agents[{name!r}]", count) for name, count in n_agents.items()}
    if not sum(high for _, high in teams.values()):
        raise ValueError(f"n_agents: got {n_agents!r}; takes at least one agent in all")
    return {name: pair for name, pair in teams.items() if pair[1]}
