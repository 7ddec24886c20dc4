"""Env steps per second, and what they cost over bare engine steps.

Both step the same model in the same batch, in turns within one run, under the same forces. Bare is the engine alone:
a loop of `mujoco.batch.Batch.step` for `c`, a scanned, vmapped engine step that carries its mjx.Data for `jax` and
`warp`. An env step adds the overlay, fault containment, poses, observations and automatic resets with new layouts; it
is scanned too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import Annotated, Any

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Impl, Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.stepping import Roll, bare_roll, draw_actions, env_roll
from maax_mjx.common.annotated import OneOf, PositiveCount
from maax_mjx.common.checks import check_positive
from maax_mjx.common.progress import progress
from maax_mjx.tasks.standard import MAAX, OURS

ROUNDS = 8
"""Turns of env steps and bare steps in one measurement."""
EPISODES = 2.5
"""Episodes that a measurement holds at least."""
LOCKSTEP, STAGGERED = "lockstep", "staggered"


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: environments to time, by name.
        impl: engines to time.
        worlds: batch sizes.
        steps: env steps per measurement, in turns of an eighth each.
        max_world_steps: fewer steps are taken of large batches, so that worlds x steps stays below this.
        horizon: env steps per episode; at most so many that the steps hold two and a half episodes, so that every world
            is reset twice, the second time from a layout drawn on the way.
        held: for how many steps an action is held; 1 redraws it every step.
        contacts_per_world: room for contact points; the environment's own choice if left out.
        preset: bodies of `standard`: "ours", or "maax" for those of the thesis's code; other games have only "ours".
    """

    env: tuple[str, ...] = ("standard",)
    impl: tuple[Impl, ...] = ("c", "jax")
    worlds: tuple[PositiveCount, ...] = (256,)
    steps: PositiveCount = 1200
    max_world_steps: float = 2e7
    horizon: PositiveCount = 1000
    held: tuple[PositiveCount, ...] = (1, 20)
    contacts_per_world: PositiveCount | None = None
    preset: tuple[Annotated[str, OneOf((OURS, MAAX))], ...] = (OURS,)

    def check(self) -> None:
        super().check()
        check_positive("max_world_steps", self.max_world_steps)


@dataclass(frozen=True)
class Case:
    """One measurement; with `episodes` "lockstep" all worlds are reset at once, "staggered" all along."""

    env: str
    impl: str
    worlds: int
    held: int
    episodes: str
    steps: int
    horizon: int
    preset: str = field(default=OURS, kw_only=True)


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case in env-steps per second, all worlds added.

    Attributes:
        n_frames: physics steps per env step.
        contacts_per_world: room for contact points.
        env_steps_per_s: of the environment.
        bare_steps_per_s: of the engine alone, `n_frames` physics steps each.
        ratio: the former over the latter.
        compile_s: compilation of both, and the first reset.
        episodes_ended, physics_faults, contact_overflows, layouts_invalid: counts over all worlds and env steps.
        peak_bytes: the most that JAX's pool ever had in use; None where the device does not count.
    """

    n_frames: int
    contacts_per_world: int
    env_steps_per_s: float
    bare_steps_per_s: float
    ratio: float
    compile_s: float
    episodes_ended: int
    physics_faults: int
    contact_overflows: int
    layouts_invalid: int
    peak_bytes: int | None


@dataclass(frozen=True)
class Batch:
    """Pieces that all protocols of a batch share.

    Attributes:
        worlds: the environment's batch.
        start_bare: from the states of `worlds` to what "bare" starts from.
        rolls: compiled rollouts, "env" and "bare".
        compile_s: seconds to compile them.
    """

    worlds: maax.Worlds
    start_bare: Callable[[Any], Any]
    rolls: dict[str, Roll]
    compile_s: float


def cases(config: Config) -> Iterator[Case]:
    """Cases; the protocols of a batch follow one another, since they compile once."""
    for env, impl, n_worlds, preset in product(config.env, config.impl, config.worlds, config.preset):
        steps = max(ROUNDS, min(config.steps, int(config.max_world_steps) // n_worlds) // ROUNDS * ROUNDS)
        horizon = max(1, min(config.horizon, int(steps / EPISODES)))
        for held, episodes in product(config.held, (LOCKSTEP, STAGGERED)):
            yield Case(env, impl, n_worlds, held, episodes, steps, horizon, preset=preset)


@lru_cache(maxsize=1)
def compiled(
    env: str, impl: str, n_worlds: int, steps: int, horizon: int, contacts_per_world: int | None, preset: str
) -> Batch:
    """A batch whose rollouts of `steps` env steps are compiled."""
    # Only what is asked for: a game of one's own may have no such fields.
    fields: dict[str, Any] = {} if preset == OURS else {"preset": preset}
    if contacts_per_world is not None:
        fields["contacts_per_world"] = contacts_per_world
    made = maax.make(env, impl=impl, horizon=horizon, **fields)
    worlds = maax.Worlds(made, n_worlds)
    begun = time.perf_counter()
    states = jax.block_until_ready(worlds.reset(jax.random.key(0)))
    start_bare, roll_bare = bare_roll(made.base)
    rolls = {"env": env_roll(worlds), "bare": roll_bare}
    actions = draw_actions(made, n_worlds, 1)
    latest = {"bare": start_bare(states), "env": states}
    for which, roll in rolls.items():
        jax.block_until_ready(roll(latest[which], actions, jnp.arange(steps // ROUNDS), 1))
    return Batch(worlds, start_bare, rolls, time.perf_counter() - begun)


def measure(case: Case, config: Config) -> Row:
    """Times env steps and bare steps in turns."""
    room = config.contacts_per_world
    batch = compiled(case.env, case.impl, case.worlds, case.steps, case.horizon, room, case.preset)
    worlds, base = batch.worlds, batch.worlds.env.base
    actions = draw_actions(worlds.env, case.worlds, case.held)
    states = worlds.reset(jax.random.key(0), stagger=case.episodes == STAGGERED)
    latest = {"bare": jax.block_until_ready(batch.start_bare(states)), "env": states}
    # The rollout that is given them frees them.
    del states
    spent = {"env": 0.0, "bare": 0.0}
    named = f"{case.env} {case.preset} {case.impl} {case.worlds} {case.episodes} held {case.held}"
    for steps in progress(jnp.arange(case.steps).reshape(ROUNDS, -1), desc=named, unit="turn", leave=False):
        for which, roll in batch.rolls.items():
            begun = time.perf_counter()
            latest[which] = jax.block_until_ready(roll(latest[which], actions, steps, case.held))
            spent[which] += time.perf_counter() - begun
    counts = latest["env"].totals()
    total = case.worlds * case.steps
    return Row(
        **vars(case),
        n_frames=base.n_frames,
        contacts_per_world=base.contacts_per_world,
        env_steps_per_s=round(total / spent["env"]),
        bare_steps_per_s=round(total / spent["bare"]),
        ratio=round(spent["bare"] / spent["env"], 3),
        compile_s=round(batch.compile_s, 1),
        episodes_ended=counts["episodes"],
        physics_faults=counts["physics_fault"],
        contact_overflows=counts["contact_overflow"],
        layouts_invalid=counts["layout_invalid"],
        peak_bytes=(jax.local_devices()[0].memory_stats() or {}).get("peak_bytes_in_use"),
    )


HEADER = "env                    impl   worlds   episodes  held       env/s      bare/s  ratio faults overflow"


def line(row: Row) -> str:
    """A row of the table."""
    named = row.env if row.preset == OURS else f"{row.env} ({row.preset})"
    return (
        f"{named:22} {row.impl:5} {row.worlds:7} {row.episodes:>10} {row.held:5} {row.env_steps_per_s:11,.0f} "
        f"{row.bare_steps_per_s:11,.0f} {row.ratio:6.2f} {row.physics_faults:6} {row.contact_overflows:8}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
