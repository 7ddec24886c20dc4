"""The agents."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.checks import check_count
from maax_mjx.layout import PlacementFn, uniform_placement
from maax_mjx.modules.entities import Entities
from maax_mjx.params import Parameter
from maax_mjx.physics import Data, World
from maax_mjx.worldgen import Obj, ObjFromXML

DIAMETER = 0.3
MOTORS = ("x", "y", "yaw")


class Agents(Entities):
    """Spheres of 0.15 m and 1 kg that slide along x, y, z and turn about z.

    Motors of gear 100 push along the world's x and y (100 N at full control) and turn about z (100 Nm); damping is 10
    on x, y and yaw and 1 on z. An agent faces -y at yaw 0, where its two hands are.

    Args:
        n_agents: how many.
        placement_fn: one function for all, or a list with one per agent.
        colors: RGBA per agent; None is grey for all.
        random_yaw: whether agents start facing anywhere; else all face -y.

    Raises:
        ValueError: a count below 1, or a list of the wrong length.
    """

    name = "agents"
    kind = "agent"
    count_name = "n_agents"
    rest_depth = 3.67e-4
    contacts_each = 4.5
    is_round = True

    def __init__(
        self,
        n_agents: int,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        colors: Sequence[Sequence[float]] | None = None,
        random_yaw: bool = False,
    ):
        n_agents = check_count("n_agents", n_agents, minimum=1)
        super().__init__(n_agents, (DIAMETER, DIAMETER, DIAMETER), placement_fn, random_yaw=random_yaw, minimum=1)
        colors = [(0.5, 0.5, 0.5, 1.0)] * n_agents if colors is None else colors
        self.colors = np.asarray(colors, float) if isinstance(colors, Sequence) else np.zeros(0)
        if self.colors.shape != (n_agents, 4):
            raise ValueError(f"colors: got {colors!r}; takes {n_agents} colours of four numbers, one per agent")

    @property
    def parameters(self) -> list[Parameter]:
        return [Parameter(self.count_name, self.count, self.count)]

    def make(self, name: str) -> Obj:
        return ObjFromXML("agent", name, rgba=self.colors[int(name.removeprefix(self.kind))])

    def cache_step(self, model: mujoco.MjModel) -> None:
        super().cache_step(model)
        names = [[f"{self.kind}{i}:{motor}" for motor in MOTORS] for i in range(self.n_max)]
        self.ctrl_ids = np.array([[model.actuator(n).id for n in row] for row in names], int)

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """`agent_qpos_qvel` (n, 8): x, y, z, yaw and their velocities; `agent_pos` (n, 3);
        `agent_angle` (n, 1): heading, yaw - pi/2 wrapped to [-pi, pi).
        """
        active = world.active[self.kind][:, None]
        qpos, qvel = data.qpos[self.qpos_ids], data.qvel[self.qvel_ids]
        heading = jnp.mod(qpos[:, 3:] + jnp.pi / 2, 2 * jnp.pi) - jnp.pi
        obs = {
            "agent_qpos_qvel": jnp.concatenate([qpos, qvel], axis=1),
            "agent_pos": qpos[:, :3],
            "agent_angle": heading,
        }
        return {name: jnp.where(active, value, 0.0) for name, value in obs.items()}
