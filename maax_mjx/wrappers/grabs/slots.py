"""The constraints by which agents hold objects: built for every pair, switched and aimed through data.

Inactive pairs cost the C engine and Warp nothing; they cost MJX-JAX 4 rows for an upright object, 6 for a free one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.core.state import State
from maax_mjx.modules import Agents, Entities, Module
from maax_mjx.modules.from_model import from_model
from maax_mjx.physics import Data, Overlay
from maax_mjx.physics.rotation import conjugate, multiply, rotate
from maax_mjx.wrappers.equalities import add_equality, connect_data, joint_data, set_equalities, weld_data


class GrabSlots(Module):
    """One possible hold for every pair of an agent and an object.

    An upright object is tied to its agent by its centre and its yaw, a free one by a weld.

    Args:
        agents: the agents' module.
        modules: modules of the objects.
        soft: whether holds are as published: welds of all objects, with MuJoCo's default softness.
    """

    name = "grab_slots"

    def __init__(self, agents: Agents, modules: Sequence[Entities], soft: bool = False):
        self.agents, self.modules, self.soft = agents, list(modules), soft
        objects = [(name, module.free or soft) for module in modules for name in module.names]
        pairs = list(product(range(agents.n_max), range(len(objects))))
        named = [(agent, thing, agents.names[agent], *objects[thing]) for agent, thing in pairs]
        self._centres = [(a, k, f"{agent}:grab:{name}") for a, k, agent, name, free in named if not free]
        self._yaws = [(a, k, f"{agent}:grab:{name}:yaw") for a, k, agent, name, free in named if not free]
        self._welds = [(a, k, f"{agent}:grab:{name}") for a, k, agent, name, free in named if free]

    @property
    def overlay(self) -> Overlay:
        return {"eq_data": self._eq_ids}

    @property
    def idle_equalities(self) -> int:
        # Each agent has at most one active hold: two equalities for an upright object, one weld for a free one.
        at_once = self.agents.n_max * (2 if self._centres else 1)
        return max(0, len(self._centres) + len(self._yaws) + len(self._welds) - at_once)

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        for *_, name in self._centres:
            agent, thing = name.split(":grab:")
            add_equality(spec, name, mujoco.mjtEq.mjEQ_CONNECT, agent, thing)
            add_equality(spec, f"{name}:yaw", mujoco.mjtEq.mjEQ_JOINT, f"{thing}:yaw", f"{agent}:yaw", ratio=1.0)
        for *_, name in self._welds:
            agent, thing = name.split(":grab:")
            add_equality(spec, name, mujoco.mjtEq.mjEQ_WELD, agent, thing, soft=self.soft)

    @property
    def _everything(self) -> list[tuple[int, int, str]]:
        return [*self._centres, *self._yaws, *self._welds]

    @property
    def _parts(self) -> np.ndarray:
        return np.cumsum([len(self._centres), len(self._yaws)])

    @property
    def _agent(self) -> np.ndarray:
        return np.array([agent for agent, *_ in self._everything], int)

    @property
    def _thing(self) -> np.ndarray:
        return np.array([thing for _, thing, _ in self._everything], int)

    @from_model
    def _eq_ids(self) -> np.ndarray:
        return np.array([self.model.eq(name).id for *_, name in self._everything], int)

    @from_model
    def _yaw0(self) -> np.ndarray:
        """Offsets of joint equalities: these count from qpos0, the difference of the two joints' values there."""
        pairs = [name.removesuffix(":yaw").split(":grab:") for *_, name in self._yaws]
        return np.array([self._rest_of(f"{thing}:yaw") - self._rest_of(f"{agent}:yaw") for agent, thing in pairs])

    def _rest_of(self, joint: str) -> float:
        return float(self.model.qpos0[self.model.joint(joint).qposadr[0]])

    def relative(self, data: Data, held: jax.Array) -> jax.Array:
        """Returns the poses (n_agents, 8) of objects in their agents' frames: position, quaternion, difference of yaws.

        Args:
            data: the physics state.
            held: (n_agents,) indices of objects; the row of an agent that holds nothing is arbitrary.
        """
        bodies = np.concatenate([m.body_ids for m in self.modules])
        mine = self.agents.body_ids
        back = conjugate(data.xquat[mine])
        place = rotate(back, data.xpos[bodies][held] - data.xpos[mine])
        turn = multiply(back, data.xquat[bodies][held])
        yaw = jnp.concatenate([data.qpos[m.qpos_ids[:, 3]] for m in self.modules])[held]
        yaw -= data.qpos[self.agents.qpos_ids[:, 3]]
        return jnp.concatenate([place, turn, yaw[:, None]], axis=1)

    def hold(self, state: State, held: jax.Array, relative: jax.Array, overlay: Overlay) -> State:
        """Ties every agent to the object that it holds, and to no other.

        Args:
            state: a state before a step.
            held: (n_agents,) int32, -1 for nothing.
            relative: (n_agents, 8) poses as from `relative`.
            overlay: the environment's overlay.
        """
        of_centre, of_yaw, of_weld = np.split(self._agent, self._parts)
        data = jnp.concatenate(
            [
                connect_data(relative[of_centre, :3]),
                joint_data(relative[of_yaw, 7] - self._yaw0, 1.0),
                weld_data(relative[of_weld, :7]),
            ]
        )
        return set_equalities(state, overlay, self._eq_ids, data, held[self._agent] == self._thing)
