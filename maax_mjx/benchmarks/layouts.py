"""Cost of new layouts for a whole batch, in physics steps of that batch.

Both are timed in turns within one run. A reset is `jax.jit(jax.vmap(env.reset))` with a range of parameters for every
world, as `Worlds` resets: layouts, overlay, poses and first observations. A physics step is `env.engine.advance` of one
frame, vmapped and scanned, without resets, poses, observations or checks, under random controls redrawn every step,
which meet fewer contacts than held ones and so make the cheapest steps to be measured against.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.stepping import Actions, at, bare_roll, draw_actions
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.checks import check_choice
from maax_mjx.common.progress import progress
from maax_mjx.core.env import Base
from maax_mjx.core.state import State

SCENES: dict[str, dict[str, Any]] = {
    "M": {},
    "crowded": {"n_boxes": (1, 9), "n_ramps": (0, 2)},
    "rooms": {"scenario": "random", "n_rooms": (2, 6), "n_boxes": (1, 4)},
    "mixed": {"scenario": ("empty", "half", "quad", "var_quad", "tri", "random"), "n_boxes": (1, 4)},
}
"""Fields of `maax.make("standard")`, by scene."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        impl: engines to time.
        scenes: M, crowded (up to 9 boxes and 2 ramps), rooms (2 to 6 random ones, up to 4 boxes), mixed (a batch of all
            room scenarios).
        worlds: batch sizes.
        rounds: turns, of which medians are reported; every round resets once and steps `steps` times.
        steps: physics steps per round.
        bare: whether to time steps of the engine alone as well, as `benchmarks/step.py` does: `mujoco.batch.Batch.step`
            for `c`, a scanned engine step that carries its mjx.Data for `jax` and `warp`.
    """

    impl: tuple[str, ...] = ("c",)
    scenes: tuple[str, ...] = ("M",)
    worlds: tuple[PositiveCount, ...] = (256,)
    rounds: PositiveCount = 9
    steps: PositiveCount = 20
    bare: bool = False

    def check(self) -> None:
        super().check()
        for scene in self.scenes:
            check_choice("scenes", scene, SCENES)


@dataclass(frozen=True)
class Case:
    """One batch; `scene` is one of `SCENES`."""

    impl: str
    scene: str
    worlds: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case; medians over the rounds.

    Attributes:
        contacts_per_world: room for contact points.
        reset_ms: new layouts for all worlds.
        step_ms: one physics step of all worlds.
        ratio: reset over step: how many physics steps the layouts cost.
        bare_ratio: reset over a step of the engine alone; None if that was not timed.
        layouts_per_s: new layouts, all worlds added.
        layouts_invalid: count among all that were drawn.
        compile_s: compilation of everything, the first calls included.
    """

    contacts_per_world: int
    reset_ms: float
    step_ms: float
    ratio: float
    bare_ratio: float | None
    layouts_per_s: int
    layouts_invalid: int
    compile_s: float


def physics_roll(env: Base) -> Callable[[State, jax.Array, jax.Array, int], State]:
    """Compiled `(states, actions, steps, held)` to the states after a physics step for each of the numbers `steps`."""
    advance = env.engine.advance  # builds the model, which gives the agents their ids
    ids = env.agents.ctrl_ids.reshape(-1)

    def roll(states: State, actions: Actions, steps: jax.Array, held: int) -> State:
        def step(data: Any, i: jax.Array) -> tuple[Any, None]:
            move = at(actions, i, held)["move"]
            data = data.replace(ctrl=data.ctrl.at[:, ids].set(move.reshape(len(move), -1)))
            return jax.vmap(lambda fields, data: advance(fields, data, 1)[0])(states.world.fields, data), None

        return states.replace(data=jax.lax.scan(step, states.data, steps)[0])

    return jax.jit(roll, donate_argnums=0)


def cases(config: Config) -> Iterator[Case]:
    """Combinations of the options."""
    return (Case(*case) for case in product(config.impl, config.scenes, config.worlds))


def measure(case: Case, config: Config) -> Row:
    """Times resets and steps of a batch in turns."""
    n_worlds = case.worlds
    env = maax.make("standard", impl=case.impl, **SCENES[case.scene]).base
    reset = jax.jit(jax.vmap(env.reset))
    keys = jax.random.split(jax.random.key(0), (config.rounds + 1, n_worlds))
    params = jax.tree.map(lambda x: jnp.broadcast_to(x, (n_worlds, *x.shape)), env.default_params)
    actions = draw_actions(env, n_worlds, held=1)
    turns = jnp.arange((config.rounds + 1) * config.steps).reshape(-1, config.steps)

    begun = time.perf_counter()
    rolls: dict[str, Callable] = {"step": physics_roll(env)}
    rolling: dict[str, Any] = {}
    if config.bare:
        start, rolls["bare"] = bare_roll(env)
        rolling["bare"] = start(reset(keys[-1], params))
    rolling["step"] = reset(keys[-1], params)
    for name, roll in rolls.items():
        rolling[name] = jax.block_until_ready(roll(rolling[name], actions, turns[-1], 1))
    compile_s = time.perf_counter() - begun

    spent: dict[str, list[float]] = {"reset": [], **{name: [] for name in rolls}}
    invalid = 0
    for i in progress(range(config.rounds), desc=f"{case.impl} {case.scene} {n_worlds}", unit="round", leave=False):
        begun = time.perf_counter()
        states = jax.block_until_ready(reset(keys[i], params))
        spent["reset"].append(time.perf_counter() - begun)
        invalid += int((~states.world.valid).sum())
        del states
        for name, roll in rolls.items():
            begun = time.perf_counter()
            rolling[name] = jax.block_until_ready(roll(rolling[name], actions, turns[i], 1))
            spent[name].append((time.perf_counter() - begun) / config.steps)
    median = {name: statistics.median(times) for name, times in spent.items()}
    return Row(
        **vars(case),
        contacts_per_world=env.contacts_per_world,
        reset_ms=round(median["reset"] * 1e3, 3),
        step_ms=round(median["step"] * 1e3, 4),
        ratio=round(median["reset"] / median["step"], 2),
        bare_ratio=round(median["reset"] / median["bare"], 2) if config.bare else None,
        layouts_per_s=round(n_worlds / median["reset"]),
        layouts_invalid=invalid,
        compile_s=round(compile_s, 1),
    )


HEADER = "impl  scene     worlds   reset ms    step ms    ratio  bare ratio   layouts/s  invalid"


def line(row: Row) -> str:
    """A row of the table."""
    bare = "-" if row.bare_ratio is None else f"{row.bare_ratio:.2f}"
    return (
        f"{row.impl:5} {row.scene:8} {row.worlds:7} {row.reset_ms:10.3f} {row.step_ms:10.4f} {row.ratio:8.2f} "
        f"{bare:>11} {row.layouts_per_s:11,} {row.layouts_invalid:8}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
