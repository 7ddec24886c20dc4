"""Games with something taken away from one team: what shows that it is the cause of what was learnt."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.arrays import null_rows
from maax_mjx.common.checks import check_choice
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.tasks import config_of
from maax_mjx.tasks.config import field_names
from maax_mjx.training.policy import check_trained
from maax_mjx.training.trained import TrainedPolicy
from maax_mjx.wrappers.grabs.rules import NOTHING
from maax_mjx.wrappers.grabs.wrapper import GrabObjects
from maax_mjx.wrappers.locks.wrapper import LockObjects
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.teams import HIDERS, SEEKERS, TeamMembership
from maax_mjx.wrappers.wrapper import ActionWrapper, StateWrapper, Wrapper, find, find_all

TOOLS = ("grab", "lock")
RAMP = "ramp"


class OfTeam(Wrapper):
    """What is taken away from one team.

    Args:
        env: environment to wrap.
        team: name of the team.
    """

    requires = (TeamMembership,)

    def __init__(self, env: Environment, team: str):
        super().__init__(env)
        self._who = jnp.asarray(self.inner(TeamMembership).of(team))


class WithoutTools(OfTeam, ActionWrapper):
    """Lets a team neither grab nor lock; the arguments are those of `OfTeam`."""

    name = "without_tools"

    def action(self, state: State, action: Any) -> Any:
        tools = {name: jnp.asarray(part) for name, part in action.items() if name in TOOLS}
        return {**action, **null_rows(tools, self._who)}


class Blinded(OfTeam, StateWrapper):
    """Zeroes what a team senses, as `PreparationPhase(blind=True)` does while it waits.

    The arguments are those of `OfTeam`.
    """

    name = "blinded"

    def __init__(self, env: Environment, team: str):
        super().__init__(env, team)
        self._senses = [layer for layer in env.layers if layer.senses]

    def observe(self, state: State) -> State:
        for sense in self._senses:
            state = sense.blind(state, self._who)
        return state


class WithoutRamps(Wrapper):
    """Draws worlds without ramps; the game's number of ramps is a range that begins with 0."""

    name = "without_ramps"

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        return self.env.begin(key, params.replace(n_ramps=0))

    def transition(self, state: State, action: Any) -> State:
        return self.env.advance(state, action)


class RampsBack(StateWrapper):
    """Puts the ramps back to where they began, at the end of preparation; whoever holds something lets go of it.

    Args:
        env: environment to wrap, in which ramps cannot be locked.

    Raises:
        ValueError: ramps that can be locked: a lock would hold them where they were.
    """

    name = "ramps_back"
    requires = (PreparationPhase,)

    def __init__(self, env: Environment):
        super().__init__(env)
        self._end = self.inner(PreparationPhase).n_steps
        if any(module.kind == RAMP for locks in find_all(env, LockObjects) for module in locks.modules):
            raise ValueError("ramps_put_back: got a game in which ramps can be locked; takes one in which they cannot")
        self._grabs = find(env, GrabObjects) is not None
        self._ids = self.base.modules[RAMP].qpos_ids  # type: ignore[attr-defined]

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        state = self.env.begin(key, params)
        return self.remember(state, state.data.qpos[self._ids])

    def observe(self, state: State) -> State:
        ends, data = state.step == self._end, state.data
        there = state.world.active[RAMP][:, None]
        back = jnp.where(there & ends, state.mechanics[self.name], data.qpos[self._ids])
        put = self.base.engine.pose(state.world.fields, data.replace(qpos=data.qpos.at[self._ids].set(back)))
        state = state.replace(data=jax.tree.map(lambda a, b: jnp.where(ends, a, b), put, data))
        if not self._grabs:
            return state
        grabs = state.mechanics[GrabObjects.name]
        free = grabs.replace(held=jnp.where(ends, NOTHING, grabs.held))
        return state.replace(mechanics=state.mechanics | {GrabObjects.name: free})


INTERVENTIONS: dict[str, tuple[str, Callable[..., Environment]]] = {
    "hiders_without_tools": ("outside", partial(WithoutTools, team=HIDERS)),
    "seekers_blind": ("outside", partial(Blinded, team=SEEKERS)),
    "no_ramps": ("outside", WithoutRamps),
    "ramps_put_back": ("inside", RampsBack),
}
"""By name, on which side of `TrackTools` a wrapper goes, and the wrapper."""


def intervened(policy: TrainedPolicy, name: str, **overrides: Any) -> Environment:
    """Makes the game that a policy learnt, of hiders and seekers, with something taken away; it counts as with `tools`.

    Example:
        ```python
        blind = intervened(policy, "seekers_blind")
        print(evaluate(policy, ["self"], env=blind).of("seekers", "self").metrics["seen"])
        ```

    Args:
        policy: a policy of `hide_and_seek_quadrant`, or of another game with `tools`.
        name: one of `INTERVENTIONS`.
        **overrides: fields of the game's config to change.

    Raises:
        ValueError: an unknown name, or a policy of another game.
    """
    side, wrap = INTERVENTIONS[check_choice("name", name, INTERVENTIONS)]
    game = check_trained(policy).game
    if game is None or "tools" not in field_names(config_of(game["game"])):
        got = "an environment of one's own" if game is None else game["game"]
        raise ValueError(f"name: got {name!r} for a policy of {got}; takes a policy of a game with the field 'tools'")
    if not overrides.get("tools", True):
        raise ValueError("tools: got False; takes True, since interventions are beside what tools are tracked by")
    fields: dict[str, Any] = {**overrides, "tools": True}
    if name == "no_ramps":
        made = check_trained(policy).make_env(**overrides).made_from
        ramps = int(np.max(made.config.n_ramps if made else 1))
        if ramps == 0:
            raise ValueError("name: got 'no_ramps' for a game with n_ramps=0; takes one with ramps")
        fields["n_ramps"] = (0, ramps)
    return policy.make_env(**{**fields, side: {**(fields.get(side) or {}), "TrackTools": wrap}})
