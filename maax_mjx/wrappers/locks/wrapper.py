"""Locking objects in place."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from gymnasium import spaces

from maax_mjx.common.checks import check_bool, check_choice, check_positive
from maax_mjx.common.keys import draw_one
from maax_mjx.common.observed import Observed, flag
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.handled import by_kind, check_new_action, declared_by_kind
from maax_mjx.wrappers.locks.rules import LOCK_TYPES, lock_rule
from maax_mjx.wrappers.locks.slots import METHODS, LockSlots
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.reach import Reach
from maax_mjx.wrappers.teams import TeamMembership
from maax_mjx.wrappers.wrapper import Wrapper, find_all

LOCK, COLUMNS = "lock", flag("you_lock", "team_lock", "obj_lock")


class Locks(struct.PyTreeNode):
    """The current locks.

    Attributes:
        locked: (n_lockable,) bool, whether an object is locked.
        owner: (n_lockable,) int32, the agent that locked it; -1 for an unlocked object.
        last_owner: (n_lockable,) int32, the agent that locked it last, also once it is unlocked; 0 if nobody did.
        pose: (n_lockable, 7) the qpos at which it was locked, padded with zeros; more columns where objects have joints
            inside.
    """

    locked: jax.Array
    owner: jax.Array
    last_owner: jax.Array
    pose: jax.Array


class LockObjects(Wrapper):
    """Lets agents lock objects in place while they are near (Baker et al.; thesis 5.2.1).

    Every agent near an object either wants it locked or wants it unlocked; with nobody near nothing changes. The lock
    type decides:

    - "any": locked if anybody near wants it; unlocked if somebody is near and nobody near wants it locked.
    - "all": locked if everybody near wants it; unlocked if anybody near does not.
    - "any_specific": locked as in "any"; unlocked only by the agent that locked it.
    - "team": locked and unlocked as in "all", but only members of the team that locked it last can object.

    The owner of a new lock is drawn from the agents that wanted it. Adds `action["lock"]` (n_agents, n_lockable), or
    (n_agents,) without `per_object`; and for every kind of object `<kind>_lock` (n_agents, n, 3): locked by oneself, by
    one's team, by anybody. Several wrappers, for different objects and with different names, give each
    its own rules.

    Args:
        env: environment to wrap; a copy of it gets the constraints of the locks.
        objects: names of the modules whose objects can be locked: "box", "ramp", "cylinder", or your own; None is
            boxes and ramps, if there are any.
        lock_type: one of the lock types above.
        radius: metres from an agent's centre to the object's surface, as an oriented box.
        method: "equality" holds the pose, and joints inside of objects, with equality constraints, "joint_range" with
            closed joint ranges, which give ten times as much.
        per_object: whether agents choose objects by index; otherwise all within reach at once.
        in_vision_only: whether only agents that saw an object after the previous step count; needs `LineOfSight`.
        soft: whether locks are as soft as MuJoCo's constraints are by default, as in the published code: they give 4 mm
            and more under 200 N, instead of 0.2 mm.
        action_name: name of the action; the struct in `state.mechanics` has it with an s: "locks".

    Raises:
        ValueError: an unknown module, lock type or method, joint ranges of free joints or of objects with joints
            inside, vision without `LineOfSight`, objects that another wrapper locks already, or a name that is taken.
    """

    requires = (TeamMembership,)
    precedes = (PreparationPhase,)

    def __init__(
        self,
        env: Environment,
        objects: Sequence[str] | None = None,
        lock_type: str = "team",
        radius: float = 0.25,
        method: str = "equality",
        per_object: bool = True,
        in_vision_only: bool = False,
        action_name: str = "lock",
        soft: bool = False,
    ):
        self.action_name = check_new_action(env, action_name)
        self.name = f"{action_name}s"
        super().__init__(deepcopy(env))
        self.lock_type = check_choice("lock_type", lock_type, LOCK_TYPES)
        check_choice("method", method, METHODS)
        self._reach = Reach(self, objects, check_positive("radius", radius), in_vision_only)
        self.modules, self.n_lockable = self._reach.modules, self._reach.n
        self.per_object = check_bool("per_object", per_object)
        for other in find_all(env, LockObjects):
            if shared := {m.name for m in self.modules} & {m.name for m in other.modules}:
                raise ValueError(f"objects: got {sorted(shared)}, locked by {other.name!r} already; takes others")
        self._slots = LockSlots(f"{self.name}_slots", self.modules, method, check_bool("soft", soft))
        self.base.attach(self._slots)
        self._team = self.inner(TeamMembership).team_index

    @property
    def action_space(self) -> spaces.Dict:
        n = self.base.n_agents
        shape = (n, self.n_lockable) if self.per_object else (n,)
        return spaces.Dict({**self.env.action_space.spaces, self.action_name: spaces.MultiBinary(shape)})

    @property
    def acts_on(self) -> dict[str, tuple[tuple[str, int], ...]]:
        mine = {self.action_name: tuple((m.kind, m.n_max) for m in self.modules)} if self.per_object else {}
        return self.env.acts_on | mine

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        nobody = jnp.full(self.n_lockable, -1, jnp.int32)
        free = jnp.zeros(self.n_lockable, bool)
        locks = Locks(free, nobody, jnp.zeros_like(nobody), jnp.zeros((self.n_lockable, self._slots.n_pose)))
        return self._observe(self.remember(self.env.begin(key, params), locks))

    def transition(self, state: State, action: dict[str, Any]) -> State:
        wants = jnp.asarray(action[self.action_name]) > 0
        wants = wants if self.per_object else jnp.broadcast_to(wants[:, None], (len(wants), self.n_lockable))
        locks = self._decide(state, wants)
        state = self.remember(state, locks)
        state = self._slots.hold(state, locks.locked, locks.pose, self.base.overlay)
        if self._slots.method == "joint_range":
            # Unlocked objects get the joint ranges back that end at the edge of the arena, where the arena uses them.
            state = state.replace(world=self.base.bounded(state.world, state.data))
        inner = {name: part for name, part in action.items() if name != self.action_name}
        return self._observe(self.env.advance(state, inner))

    def _decide(self, state: State, wants: jax.Array) -> Locks:
        locks: Locks = state.mechanics[self.name]
        _, near = self._reach(state)
        lock, unlock = lock_rule(self.lock_type, wants, near, locks.locked, locks.last_owner, self._team)
        kept = locks.locked & ~unlock
        new = lock & ~kept
        drawn = draw_one(state.key, state.step, wants & near)
        locked, last = kept | new, jnp.where(new, drawn, locks.last_owner)
        pose = jnp.where(new[:, None], self._slots.pose(state.data), locks.pose)
        return Locks(locked, jnp.where(locked, last, -1), last, pose)

    def _observe(self, state: State) -> State:
        locks: Locks = state.mechanics[self.name]
        mine = locks.locked & (locks.owner == jnp.arange(self.base.n_agents)[:, None])
        ours = locks.locked & (jnp.asarray(self._team)[locks.last_owner] == self._team[:, None])
        agents = self.playing(state)[:, None]
        columns = [mine & agents, ours & agents, jnp.broadcast_to(locks.locked, mine.shape)]
        return state.replace(obs=state.obs | by_kind(self.modules, columns, LOCK))

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | declared_by_kind(self.modules, LOCK, COLUMNS)
