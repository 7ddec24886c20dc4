"""The command line, `maax-mjx`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import jax
import tyro
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx.env import Environment
from maax_mjx.export import world_of
from maax_mjx.parallel import Worlds, WorldsState
from maax_mjx.viewer import contact_sheet, gif

SHEET = 12
HOLD = 20
FRAME_EVERY = 5


@dataclass
class Rollout:
    """Builds the standard environment, rolls out a batch of worlds with random actions, and draws them.

    Writes worlds.png (12 worlds from above), rollout.gif (world 0 moving) and world.xml (that world, for plain MuJoCo).
    """

    worlds: int = 256
    """Worlds stepped together, each in a layout of its own."""
    steps: int = 500
    """Env steps, one physics step of 5 ms each."""
    seed: int = 0
    """Of the worlds and the actions."""
    impl: str = "auto"
    """Physics engine: auto, c, jax or warp."""
    scenario: str = "quad"
    """Room scenario: quad or empty."""
    n_hiders: int = 2
    """Agents that start inside the quadrant."""
    n_seekers: int = 2
    """Agents that start outside it."""
    n_boxes: tuple[int, ...] = (1,)
    """Boxes per world: one number, or LOW HIGH for a range."""
    n_ramps: tuple[int, ...] = (1,)
    """Ramps per world: one number, or LOW HIGH for a range."""
    out: Path = field(default_factory=lambda: Path("maax-out"))
    """Folder for the pictures and the MJCF."""


def rollout(args: Rollout) -> None:
    """Runs `maax-mjx rollout`."""
    if args.worlds < 1 or args.steps < 1:
        raise ValueError(f"worlds, steps: got {args.worlds}, {args.steps}; take at least 1 each")
    env = maax.make(
        "standard",
        scenario=args.scenario,
        n_hiders=args.n_hiders,
        n_seekers=args.n_seekers,
        n_boxes=_count("n_boxes", args.n_boxes),
        n_ramps=_count("n_ramps", args.n_ramps),
        impl=args.impl,
    )
    args.out.mkdir(parents=True, exist_ok=True)
    worlds = Worlds(env, args.worlds)
    key = jax.random.key(args.seed)
    print(f"compiling for {env.base.engine.impl} on {jax.devices()[0].device_kind} ...", flush=True)
    start = time.perf_counter()
    states = worlds.reset(key, stagger=True)
    first = [world_of(states, i) for i in range(min(SHEET, args.worlds))]
    advance = _advance(worlds)
    states = jax.block_until_ready(advance(states, jax.random.fold_in(key, 0)))
    compiled = time.perf_counter() - start
    frames = [world_of(states, 0)]
    done, spent = FRAME_EVERY, 0.0
    total = max(args.steps, FRAME_EVERY)
    try:
        with tqdm(total=total, initial=done, unit="step", desc=f"{args.worlds} worlds", mininterval=0.5) as bar:
            while done < total:
                start = time.perf_counter()
                states = jax.block_until_ready(advance(states, jax.random.fold_in(key, done // HOLD)))
                spent += time.perf_counter() - start
                done += FRAME_EVERY
                bar.update(FRAME_EVERY)
                bar.set_postfix_str(f"{(done - FRAME_EVERY) * args.worlds / spent:,.0f} env-steps/s")
                frames.append(world_of(states, 0))
    except KeyboardInterrupt:
        print("interrupted: writing what was done")
    _summary(env, states, args.worlds, done - FRAME_EVERY, spent, compiled)
    print(f"drawing into {args.out}/ ...", flush=True)
    contact_sheet(env, first, args.out / "worlds.png", [f"world {i}" for i in range(len(first))])
    (args.out / "world.xml").write_text(maax.to_mjcf(env, states, world=0))
    gif(env, tqdm(frames, desc="rollout.gif", unit="frame", mininterval=0.5), args.out / "rollout.gif")
    print(f"wrote {args.out}/worlds.png, {args.out}/rollout.gif, {args.out}/world.xml")


def _count(name: str, values: tuple[int, ...]) -> int | tuple[int, int]:
    if len(values) == 1:
        return values[0]
    if len(values) == 2:
        return values[0], values[1]
    raise ValueError(f"{name}: got {values}; takes one number, or LOW HIGH")


def _advance(worlds: Worlds) -> Callable[[WorldsState, jax.Array], WorldsState]:
    """`FRAME_EVERY` steps under one random action of every world."""

    def advance(states: WorldsState, key: jax.Array) -> WorldsState:
        action = worlds.sample_action(key)
        return jax.lax.scan(lambda s, _: (worlds.step_fn(s, action), None), states, length=FRAME_EVERY)[0]

    return jax.jit(advance, donate_argnums=0)


def _summary(env: Environment, states: WorldsState, n: int, steps: int, spent: float, compiled: float) -> None:
    counts = {name: int(value.sum()) for name, value in states.counts.items()}
    rate = n * steps / spent if spent else 0.0
    base = env.base
    rows = {
        "engine": f"{base.engine.impl} on {jax.devices()[0].device_kind}",
        "worlds": f"{n:,} ({base.n_agents} agents each), random actions held for {HOLD} steps",
        "env-steps/s": f"{rate:,.0f}",
        "physics steps/s": f"{rate * base.n_frames:,.0f}",
        "agent-steps/s": f"{rate * base.n_agents:,.0f}",
        "compile time": f"{compiled:.1f} s",
        "episodes ended": f"{counts['episodes']:,}",
        "invalid layouts": f"{counts['layout_invalid']:,}",
        "contact overflow": f"{counts['contact_overflow']:,} steps",
        "physics faults": f"{counts['physics_fault']:,}",
    }
    for name, value in rows.items():
        print(f"  {name:17} {value}")


def main() -> None:
    """The entry point: parses the command line and runs the command; a user's mistake exits with 2."""
    app = tyro.extras.SubcommandApp()
    app.command(name="rollout")(_rollout)
    try:
        app.cli(description="maax_mjx: procedurally generated multi-agent worlds on MuJoCo MJX.")
    except (ValueError, maax.MissingLibraryError) as error:
        print(f"maax-mjx: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def _rollout(args: tyro.conf.OmitArgPrefixes[Rollout]) -> None:
    rollout(args)


_rollout.__doc__ = Rollout.__doc__
