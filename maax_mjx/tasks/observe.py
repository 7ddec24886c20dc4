"""What agents of the games observe, each for itself."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from maax_mjx.common.checks import check_choice
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.wrappers import (
    FlattenObservations,
    GrabObjects,
    LineOfSight,
    LockObjects,
    ObservationWrapper,
    SplitObservations,
    find,
)

OWN = ("agent_qpos_qvel", "agent_team", "agent_mask")
MATRICES = ("contact_mask", "sees_agents")
LOCKS = ("you_lock", "team_lock", "obj_lock")
PULLS = ("you_pull", "obj_pull")
COPIES = ("prep_remaining", "team_size", "lidar", "you_lock", "team_lock", "you_pull")
LEFT_OUT = ("agent_pos", "agent_angle")
"""What `agent_qpos_qvel` says already."""


def observed_by_agents(
    env: Environment, observations: str, observe: str = "self", own: Sequence[str] = ()
) -> Environment:
    """Gives every agent observations of its own, as Baker et al.'s policies get them.

    Args:
        env: the game.
        observations: "raw" leaves the game's; "split" gives arrays whose first axis is the agents': of oneself
            `<name>_self`, of others in circulant order, of objects with the columns of the locks and holds on them;
            "flat" joins these to one vector, in which what an agent does not see is zero, where there is vision.
        observe: see `FlattenObservations`.
        own: what agents know of themselves and of others, (n_agents, d), besides the usual.

    Raises:
        ValueError: an unknown word, or privileged observations that are not flat.
    """
    check_choice("observations", observations, ("raw", "split", "flat"))
    if observe != "self" and observations != "flat":
        raise ValueError(f"observe: got {observe!r} with observations={observations!r}; takes 'self' there")
    if observations == "raw":
        return env
    observed = env.observation_space.spaces
    sight = find(env, LineOfSight)
    sees = {m.kind: f"sees_{m.name}" for m in sight.modules} if sight else {}

    def present(names: Sequence[str]) -> list[str]:
        return [name for name in names if name in observed]

    personal, matrices = present([*OWN, *own]), present(MATRICES)
    copies = [name for name in present([*COPIES, *sees.values()]) if name not in MATRICES]
    used = {*personal, *matrices, *copies, *LEFT_OUT}
    env = SplitObservations(env, personal, matrices, copies, [name for name in observed if name not in used])
    if find(env, LockObjects) or find(env, GrabObjects):
        env = _HandledObjects(env)
    if observations == "split":
        return env
    hidden = {f"{kind}_obs": mask for kind, mask in sees.items() if f"{kind}_obs" in observed}
    return FlattenObservations(env, observe, hidden | ({"agent_qpos_qvel": "sees_agents"} if sees else {}))


class _HandledObjects(ObservationWrapper):
    """Puts locks and holds into `<kind>_obs` (n_agents, n, ...) of the objects that they are of.

    The columns are: locked by oneself, by one's team, by anybody; held by oneself, by anybody.
    """

    def __init__(self, env: Environment):
        super().__init__(env)
        locks, grabs = find(env, LockObjects), find(env, GrabObjects)
        self._handled: list[tuple[tuple[str, ...], list[Entities]]] = []
        if locks:
            self._handled.append((LOCKS, locks.modules))
        if grabs:
            self._handled.append((PULLS, grabs.modules))

    def observation(self, state: State) -> dict[str, jax.Array]:
        obs = dict(state.obs)
        for names, modules in self._handled:
            columns = jnp.concatenate([obs.pop(name) for name in names], axis=-1)
            first = 0
            for module in modules:
                if module.n_max:
                    key = f"{module.kind}_obs"
                    obs[key] = jnp.concatenate([obs[key], columns[:, first : first + module.n_max]], axis=-1)
                first += module.n_max
        return obs
