"""Short scenes played by scripted agents, which show that the games work."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.layout import Layout
from maax_mjx.layout.grid import within
from maax_mjx.layout.placement import requires_quadrant
from maax_mjx.tasks import building, climbing, scripted, sheltering, walking
from maax_mjx.tasks.hide_and_seek import GrabConfig, LockConfig
from maax_mjx.tasks.registry import make

FIRST, SECOND = 0, 1
"""Slots of the hider and the seeker in scenes of one against one."""
MARGIN = 4
"""Cells between a box and the quadrant's walls, so that an agent can get behind it."""


class Scene(NamedTuple):
    """A scene.

    Attributes:
        env: environment of the scene; hiders first.
        reset: function from a key to a state.
        act: function from a state to an action.
        n_steps: length in env steps.
    """

    env: Environment
    reset: Callable[[jax.Array], State]
    act: Callable[[State], dict[str, Any]]
    n_steps: int

    def play(self, state: State) -> tuple[State, State]:
        """Plays the scene and returns the last state, and the states after all steps; traceable.

        Args:
            state: a state from `reset`.
        """

        def step(state: State, _: None) -> tuple[State, State]:
            state = self.env.step(state, self.act(state))
            return state, state

        return jax.lax.scan(step, state, length=self.n_steps)


def catch(impl: str = "auto") -> Scene:
    """A seeker walks towards the nearest of two hiders, who wander about an empty room."""
    env = make(
        "hide_and_seek", impl=impl, scenario="empty", n_hiders=2, n_seekers=1, n_boxes=0, n_ramps=0,
        prep_fraction=0.2, lock=None, horizon=1001, observations="raw",
    )  # fmt: skip
    hiders = jnp.array([True, True, False])

    def act(state: State) -> dict[str, Any]:
        first, second = (jax.random.fold_in(state.key, i) for i in range(2))
        forces = [scripted.wander(first, state.step), scripted.wander(second, state.step)]
        return scripted.to_action(env, jnp.stack([*forces, scripted.chase(state, env, 2, hiders)]))

    return Scene(env, env.reset, act, 1000)


def closed_door(impl: str = "auto", *, close: bool = True) -> Scene:
    """A hider carries a box into the only door of its quadrant and locks it there, before the seeker may move.

    Args:
        impl: name of the engine.
        close: whether the hider does so; otherwise it stands still.
    """
    env = make(
        "hide_and_seek", impl=impl, n_hiders=1, n_seekers=1, n_ramps=0, p_door_dropout=1.0,
        box_placement=_away_from_walls, lock=LockConfig(("box",)), grab=GrabConfig(("box",)), horizon=1001,
        observations="raw",
    )  # fmt: skip

    def act(state: State) -> dict[str, Any]:
        forces, parts = scripted.close_door(state, env, FIRST)
        seeking = scripted.chase(state, env, SECOND, jnp.array([True, False]))
        chosen = {name: jnp.array([1, 0]) * part * close for name, part in parts.items()}
        return scripted.to_action(env, jnp.stack([forces * close, seeking]), **chosen)

    return Scene(env, env.reset, act, 1000)


def over_the_wall(impl: str = "auto") -> Scene:
    """A seeker gets into a quadrant without doors over a ramp, with the constants of Baker et al."""
    env = make(
        "hide_and_seek_quadrant", impl=impl, n_hiders=1, n_seekers=1, n_boxes=0, door_size=0, p_door_dropout=0.0,
        prep_fraction=0.0, lock=None, grab=None, hider_placement="quad", n_bins=None, observations="raw",
    )  # fmt: skip
    base = env.base

    def reset(key: jax.Array) -> State:
        state = env.reset(key)
        wall = scripted.quadrant_rect(state, env)[3]
        ramp, seeker = base.modules["ramp"].qpos_ids[0], base.agents.qpos_ids[SECOND]  # type: ignore[attr-defined]
        x = jax.random.uniform(key, minval=3.8, maxval=5.2)
        qpos = state.data.qpos.at[ramp].set(jnp.stack([x, wall + 0.31, 0.25, 0.0]))
        qpos = qpos.at[seeker].set(jnp.stack([x, wall + 1.5, 0.15, 0.0]))
        return state.replace(data=base.engine.pose(state.world.fields, state.data.replace(qpos=qpos)))

    def act(state: State) -> dict[str, Any]:
        here = state.data.xpos[base.agents.body_ids[SECOND], :2]
        hider = state.data.xpos[base.agents.body_ids[FIRST], :2]
        goal = jnp.where(scripted.in_quadrant(state, env, here), hider, jnp.stack([here[0], 1.0]))
        return scripted.to_action(env, jnp.stack([jnp.zeros(3), scripted.towards(state, env, SECOND, goal)]))

    return Scene(env, reset, act, 60)


def lock_and_return(impl: str = "auto") -> Scene:
    """An agent finds its way through six rooms to the box, locks it, and goes back where it began."""
    return alone("lock_and_return", walking.lock_and_return, impl, 120)


def lock_all(impl: str = "auto") -> Scene:
    """An agent locks both boxes of the quadrant game, the nearer one first."""
    return alone("lock_all", walking.lock_and_return, impl, 80)


def lock_order(impl: str = "auto") -> Scene:
    """An agent locks both boxes in their order, in random rooms."""
    return alone("lock_order", walking.lock_and_return, impl, 80, scenario="random")


def blueprint(impl: str = "auto") -> Scene:
    """An agent carries boxes to construction sites, and locks them there; by forces, not bins."""
    return alone("blueprint", building.blueprint, impl, 150, n_bins=None)


def sequential_lock(impl: str = "auto") -> Scene:
    """An agent locks four boxes in their order, and gets over walls to them by ramps; by forces, not bins."""
    return alone("sequential_lock", climbing.sequential_lock, impl, 120, n_bins=None)


def shelter(impl: str = "auto", horizon: int = 240) -> Scene:
    """An agent puts boxes around a cylinder; by forces, not bins, and by default in the published time.

    Args:
        impl: name of the engine.
        horizon: in env steps.
    """
    return alone("shelter", sheltering.shelter, impl, horizon, n_bins=None)


def object_counting(impl: str = "auto") -> Scene:
    """An agent that cannot move watches boxes that pass behind screens."""

    def watch(state: State, env: Environment) -> tuple[jax.Array, dict[str, Any]]:
        return jnp.zeros(3), {}

    return alone("object_counting", watch, impl, 120)


def alone(game: str, script: scripted.SoloScript, impl: str, horizon: int, **options: Any) -> Scene:
    """A game of one agent that a script plays, up to the step before the last.

    Args:
        game: its name.
        script: what its agent does.
        impl: name of the engine.
        horizon: in env steps.
        **options: other fields of the game's config.
    """
    env = make(game, impl=impl, observations="raw", horizon=horizon, **options)
    return Scene(env, env.reset, lambda state: scripted.act_alone(script, state, env), horizon - 2)


SCENES = {
    "catch": catch,
    "closed_door": closed_door,
    "over_the_wall": over_the_wall,
    "lock_and_return": lock_and_return,
    "lock_all": lock_all,
    "lock_order": lock_order,
    "blueprint": blueprint,
    "sequential_lock": sequential_lock,
    "shelter": shelter,
    "object_counting": object_counting,
}


@requires_quadrant
def _away_from_walls(layout: Layout, cells: jax.Array) -> jax.Array:
    """Restricts to cells in the quadrant with room around them."""
    return within(layout.grid.size, cells, layout.plan.quadrant + MARGIN * jnp.array([1, 1, -1, -1]))
