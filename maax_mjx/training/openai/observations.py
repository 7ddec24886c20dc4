"""What a published policy observes, from the split observations of a game here, and what it does as actions here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces

from maax_mjx.core.env import Environment
from maax_mjx.modules.agents import DIAMETER
from maax_mjx.training.openai.network import ACTIONS, KINDS, MASKS, OpenAINetwork
from maax_mjx.wrappers import Lidar
from maax_mjx.wrappers.wrapper import find

NO_HIT = 6.0
"""Metres that a published ray reads where it meets nothing."""
POSE = ("x", "y", "z", "cos yaw", "sin yaw", "vx", "vy", "vz", "spin")
OWN = ("x", "y", "z", "yaw", "vx", "vy", "vz", "spin")
SIZE = ("size x", "size y", "size z")
LOCK = ("you_lock", "team_lock", "obj_lock")
PARTS = dict(zip(("move", "grab", "lock"), ACTIONS, strict=True))
"""Actions here, and what they are called there."""
SIGHT = dict(zip(MASKS, ("sees_agent", "sees_box", "sees_ramp", "construction_site_mask"), strict=True))
"""Masks there, and what they are called here; construction sites are always seen."""
SITES, SIGHT_OF_SITES = KINDS[-1], MASKS[-1]
TAKES = (
    'takes a hide-and-seek game as published, observations="split", such as policy.make_env(), or a transfer task with '
    "made_up=True"
)


@dataclass(frozen=True)
class Entities:
    """How an array about boxes or ramps becomes the published one.

    Attributes:
        name: of the array, which is the same in both.
        kind: of the entities.
        columns: numbers of the columns that are taken, in their order; -1 is a column of zeros.
        half: (3,) metres from an entity's lower corner to its centre, where it is not observed.
        size: numbers of the columns of the extents; () takes `half`.
    """

    name: str
    kind: str
    columns: tuple[int, ...]
    half: tuple[float, ...]
    size: tuple[int, ...] = ()

    def read(self, obs: Mapping[str, jax.Array]) -> jax.Array:
        """Returns (n_agents, n, columns), zero for entities that are not in play."""
        x = obs[self.name]
        half = x[..., self.size] / 2 if self.size else jnp.asarray(self.half)
        x = jnp.concatenate([x[..., :3] - half, x[..., 3:], jnp.zeros((*x.shape[:-1], 1))], axis=-1)
        return jnp.where(obs[f"{self.kind}_mask"][..., None] > 0, x[..., self.columns], 0.0)


@dataclass(frozen=True)
class Adapter:
    """Reads the published observations from those of an environment.

    Positions are those of lower corners there, and of centres here.

    Attributes:
        n_agents: number of agents.
        lidar_range: metres that rays here read where they meet nothing; there they read `NO_HIT`.
        capped: whether rays here also read that where they meet something further away.
        entities: boxes and ramps.
        told: whether the environment makes up `hider` and `prep_obs`, as the published transfer tasks do.
        masks: names of the masks that the network reads.
    """

    n_agents: int
    lidar_range: float
    capped: bool
    entities: tuple[Entities, ...]
    told: bool = False
    masks: tuple[str, ...] = MASKS[:-1]

    def read(self, obs: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        """Returns the published observations by name, (n_agents, ...) each."""
        prep = obs["prep_obs"] if self.told else 1 - obs["prep_remaining"]
        hider = obs["hider"] if self.told else 1 - obs["agent_team_self"]
        others = obs["agent_qpos_qvel"]
        among = jnp.broadcast_to(prep[:, None], (*others.shape[:2], 1))
        lidar = obs["lidar"]
        read = {
            "observation_self": jnp.concatenate([_cornered(obs["agent_qpos_qvel_self"]), hider, prep], axis=-1),
            # Those that are made up are all zeros.
            "agent_qpos_qvel": jnp.concatenate(
                [others if self.told else _cornered(others), 1 - obs["agent_team"], among], axis=-1
            ),
            "lidar": jnp.where(lidar >= self.lidar_range if self.capped else lidar == self.lidar_range, NO_HIT, lidar),
        }
        read |= {one.name: one.read(obs) for one in self.entities}
        if SIGHT_OF_SITES in self.masks:
            read[SITES] = _sites(obs)
        return {name: jnp.asarray(x, jnp.float32) for name, x in read.items()} | {
            mask: obs[SIGHT[mask]].astype(jnp.float32) for mask in self.masks
        }


def _cornered(x: jax.Array) -> jax.Array:
    """Agents' own numbers, with the places of their lower corners."""
    return jnp.concatenate([x[..., :3] - DIAMETER / 2, x[..., 3:]], axis=-1)


def _sites(obs: Mapping[str, jax.Array]) -> jax.Array:
    """Construction sites (n_agents, n, 15): their middles and their four corners, zero for those not in play."""
    corners = obs["construction_site_corner_pos"]
    x = jnp.concatenate([obs["construction_site_pos"], corners.reshape(*corners.shape[:-2], -1)], axis=-1)
    return jnp.where(obs["construction_site_mask"][..., None] > 0, x, 0.0)


def adapter_of(env: Environment, network: OpenAINetwork) -> Adapter:
    """Returns the adapter of an environment for a network.

    Raises:
        ValueError: an environment that does not observe, or is not acted in, as the published game.
    """
    table, space = env.observed, env.observation_space.spaces
    masks = tuple(network.masks.values())
    sites = ("construction_site_pos", "construction_site_corner_pos") if SIGHT_OF_SITES in masks else ()
    for name in ("agent_qpos_qvel_self", "agent_team", "prep_remaining", "lidar", *sites, *(SIGHT[m] for m in masks)):
        if name not in space:
            raise ValueError(f"policy: it reads {name!r}, and env does not have it; {TAKES}")
    if table["agent_qpos_qvel_self"].names() != OWN or "other" not in table["agent_team"].axes:
        got = table["agent_qpos_qvel_self"].names()
        raise ValueError(f"policy: it reads {OWN} of 'agent_qpos_qvel_self', and env has {got}; {TAKES}")
    lidar = find(env, Lidar)
    rays = (lidar.n_rays, lidar.frame, lidar.compress) if lidar is not None else None
    if lidar is None or rays != (network.n_rays, "world", None):
        raise ValueError(
            f"policy: it reads {network.n_rays} rays in the world's frame, and env has {rays} (number, frame, "
            f"compress); {TAKES}"
        )
    _check_actions(env, network)
    box, ramp = (_entities(env, kind, width) for kind, width in zip(("box", "ramp"), network.widths[2:4], strict=True))
    return Adapter(env.n_agents, lidar.range, lidar.capped, (box, ramp), told="prep_obs" in space, masks=masks)


def _entities(env: Environment, kind: str, width: int) -> Entities:
    """How the array of a kind is read, with as many columns as the network has: with sizes and locks, or without."""
    name = f"{kind}_obs"
    have = {column: i for i, column in enumerate(env.observed[name].names())} if name in env.observed else {}
    zeros = dict.fromkeys(SIZE, -1) if kind == "ramp" else {}
    have = zeros | have
    forms = [columns for columns in (POSE, POSE + LOCK, POSE + SIZE + LOCK) if len(columns) == width]
    if not forms or not set(forms[0]) <= set(have):
        wanted = forms[0] if forms else f"{width} columns"
        raise ValueError(f"policy: it reads {wanted} of {name!r}, and env has {tuple(have)}; {TAKES}")
    largest = env.base.objects([kind])[0].largest
    # Those that are made up are not in play.
    half = tuple((largest[0] / 2).tolist()) if len(largest) else (0.0,) * 3
    size = tuple(have[column] for column in SIZE) if SIZE[0] in have and have[SIZE[0]] >= 0 else ()
    return Entities(name, kind, tuple(have[column] for column in forms[0]), half, size)


def _check_actions(env: Environment, network: OpenAINetwork) -> None:
    wanted: dict[str, spaces.Space] = {
        "move": spaces.MultiDiscrete(np.full((env.n_agents, 3), network.n_bins)),
        "grab": spaces.MultiBinary((env.n_agents,)),
        "lock": spaces.MultiBinary((env.n_agents,)),
    }
    got = env.action_space.spaces
    for name in sorted({*wanted, *got}):
        if name not in wanted or name not in got or wanted[name] != got[name]:
            raise ValueError(
                f"policy: it decides {_words(wanted.get(name))} of {name!r}, and env takes {_words(got.get(name))}; "
                f"{TAKES}"
            )


def _words(space: spaces.Space | None) -> str:
    return "nothing" if space is None else " ".join(str(space).split())
