"""Scripted players by name, for policies to be measured against."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from maax_mjx.common.checks import suggestion
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.tasks import building, climbing, scripted, scripted_players, sheltering, walking
from maax_mjx.wrappers import BlueprintReward, CaptureTheFlag, GrabObjects, LockObjects, LockTask, Tag
from maax_mjx.wrappers.wrapper import Wrapper, find

Script = Callable[[Environment, State, jax.Array], Any]
"""`(env, state, key) -> action` of all agents of one world."""


@dataclass(frozen=True)
class Scripted:
    """A scripted player.

    Attributes:
        name: its name.
        script: what it does, for all agents.
        check: raises a ValueError for environments that it cannot play.
    """

    name: str
    script: Script
    check: Callable[[Environment], None] = lambda env: None

    def on(self, env: Environment) -> ScriptedPlay:
        """Returns it as a player of an environment, as `Worlds.rollout` and `record` take it, too.

        Raises:
            ValueError: an environment that it cannot play.
        """
        self.check(env)
        return ScriptedPlay(self.script, env)


@dataclass(frozen=True)
class ScriptedPlay:
    """A script in an environment, as a function of one world, `(state, key, memory, params) -> (action, memory)`.

    Equal ones compile once. It has no parameters and no memory.
    """

    script: Script
    env: Environment

    params: ClassVar[tuple[()]] = ()

    @property
    def play(self) -> ScriptedPlay:
        """Itself."""
        return self

    def memory(self, n_worlds: int) -> tuple[()]:
        """Nothing."""
        return ()

    def on(self, env: Environment) -> ScriptedPlay:
        """The same script in another environment."""
        return ScriptedPlay(self.script, env)

    def __call__(self, state: State, key: jax.Array, memory: Any, params: Any) -> tuple[Any, Any]:
        return self.script(self.env, state, key), memory


def _random(env: Environment, state: State, key: jax.Array) -> Any:
    return env.sample_action(key)


def _still(env: Environment, state: State, key: jax.Array) -> Any:
    return scripted.to_action(env, jnp.zeros((env.n_agents, 3)))


def _chase(env: Environment, state: State, key: jax.Array) -> Any:
    """Every agent goes to the nearest one of another team."""
    team = jnp.zeros(env.n_agents, int)
    for i, one in enumerate(env.teams.values()):
        team = team.at[jnp.asarray(one.slots)].set(i)
    forces = [scripted.chase(state, env, i, team != team[i]) for i in range(env.n_agents)]
    return scripted.to_action(env, jnp.stack(forces))


def _close_door(env: Environment, state: State, key: jax.Array) -> Any:
    """Every agent carries a box of its own into the quadrant's door, and locks it there."""
    boxes = env.base.modules["box"].n_max  # type: ignore[attr-defined]
    acts = [scripted.close_door(state, env, i, min(i, boxes - 1)) for i in range(env.n_agents)]
    parts = {name: jnp.stack([act[1][name] for act in acts]) for name in ("grab", "lock")}
    return scripted.to_action(env, jnp.stack([act[0] for act in acts]), **parts)


def _alone(script: scripted.SoloScript) -> Script:
    """A script of a game's one agent."""

    def play(env: Environment, state: State, key: jax.Array) -> Any:
        return scripted.act_alone(script, state, env)

    return play


def _tag(env: Environment, state: State, key: jax.Array) -> Any:
    """Who is it chases, the others flee."""
    return scripted.to_action(env, scripted_players.tag(state, env))


def _capture_the_flag(env: Environment, state: State, key: jax.Array) -> Any:
    """Every second agent guards its team's flag, the others fetch the other one."""
    return scripted.to_action(env, scripted_players.capture_the_flag(state, env))


def _has(kind: type[Wrapper], game: str) -> Callable[[Environment], None]:
    """A check that refuses a game without a wrapper; it names a game that has it."""

    def check(env: Environment) -> None:
        walking.task_of(env, kind, game)

    return check


def _can_close_doors(env: Environment) -> None:
    if find(env, GrabObjects) is None or find(env, LockObjects) is None or "box" not in env.base.modules:
        raise ValueError(
            "close_door: got a game without boxes that can be grabbed and locked; takes the quadrant games"
        )


class _Players(dict[str, Scripted]):
    def __missing__(self, name: object) -> Scripted:
        raise KeyError(f"SCRIPTED: got {name!r}{suggestion(name, self)}; takes one of {sorted(self)}")


SCRIPTED: Mapping[str, Scripted] = _Players(
    (player.name, player)
    for player in (
        Scripted("random", _random),
        Scripted("still", _still),
        Scripted("chase", _chase),
        Scripted("lock_and_return", _alone(walking.lock_and_return), _has(LockTask, "lock_and_return")),
        Scripted("sequential_lock", _alone(climbing.sequential_lock), climbing.check_sequential_lock),
        Scripted("blueprint", _alone(building.blueprint), _has(BlueprintReward, "blueprint")),
        Scripted("shelter", _alone(sheltering.shelter), sheltering.check_shelter),
        Scripted("tag", _tag, _has(Tag, "tag")),
        Scripted("capture_the_flag", _capture_the_flag, _has(CaptureTheFlag, "capture_the_flag")),
        Scripted("close_door", _close_door, _can_close_doors),
    )
)
"""Scripted players by name."""
