"""The command line, `maax-mjx`."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import tyro
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx.checks import check_choice
from maax_mjx.env import Environment
from maax_mjx.export import world_of
from maax_mjx.layout import PlacementFn
from maax_mjx.parallel import Worlds, WorldsState
from maax_mjx.physics import World
from maax_mjx.viewer import contact_sheet, gif

SHEET = 12
HOLD = 24
FRAME_EVERY = 8
"""Env steps per frame of the gif: 40 ms, for which it is shown."""
MAX_FRAMES = 250
"""Of the gif, which shows the first ten seconds of a longer rollout."""


Outer = Literal["walls", "limits", "none"]


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
    scenario: tuple[str, ...] = ("quad",)
    """Room scenario: empty, half, quad, var_quad, tri or random; of several, every world draws one."""
    n_hiders: tuple[int, ...] = (2,)
    """Agents that start inside the quadrant: one number, or LOW HIGH for a range."""
    n_seekers: tuple[int, ...] = (2,)
    """Agents that start outside it: one number, or LOW HIGH for a range."""
    n_boxes: tuple[int, ...] = (1,)
    """Boxes per world: one number, or LOW HIGH for a range."""
    n_ramps: tuple[int, ...] = (1,)
    """Ramps per world: one number, or LOW HIGH for a range."""
    outer: Outer = "walls"
    """What closes the arena: walls, joint limits, or nothing."""
    out: Path = field(default_factory=lambda: Path("maax-out"))
    """Folder for the pictures and the MJCF."""


def rollout(args: Rollout) -> None:
    """Runs `maax-mjx rollout`."""
    if args.worlds < 1 or args.steps < 1:
        raise ValueError(f"worlds, steps: got {args.worlds}, {args.steps}; take at least 1 each")
    if not 0 <= args.seed < 2**63:
        raise ValueError(f"seed: got {args.seed}; takes 0 to 2**63 - 1")
    env = maax.make(
        "standard",
        scenario=args.scenario,
        n_hiders=_count("n_hiders", args.n_hiders),
        n_seekers=_count("n_seekers", args.n_seekers),
        outer=args.outer,
        n_boxes=_count("n_boxes", args.n_boxes),
        n_ramps=_count("n_ramps", args.n_ramps),
        impl=args.impl,
    )
    args.out.mkdir(parents=True, exist_ok=True)
    worlds = Worlds(env, args.worlds)
    world_key, action_key = jax.random.split(jax.random.key(args.seed))
    print(f"compiling for {env.base.engine.impl} on {jax.devices()[0].device_kind} ...", flush=True)
    start = time.perf_counter()
    states = worlds.reset(world_key, stagger=True)
    first = [world_of(states, i) for i in range(min(SHEET, args.worlds))]
    advance = _advance(worlds).lower(states, action_key, 1).compile()
    compiled = time.perf_counter() - start
    frames, done, spent = [world_of(states, 0)], 0, 0.0
    with (
        _Interrupt() as interrupt,
        tqdm(total=args.steps, unit="step", desc=f"{args.worlds} worlds", mininterval=0.5) as bar,
    ):
        while done < args.steps and not interrupt.asked:
            n = min(FRAME_EVERY, args.steps - done)
            start = time.perf_counter()
            key = jax.random.fold_in(action_key, done // HOLD)
            states = jax.block_until_ready(advance(states, key, jnp.asarray(n)))
            spent += time.perf_counter() - start
            done += n
            bar.update(n)
            bar.set_postfix_str(f"{done * args.worlds / spent:,.0f} env-steps/s")
            if len(frames) < MAX_FRAMES:
                frames.append(world_of(states, 0))
    if interrupt.asked:
        print("interrupted: writing what was done")
    _summary(env, states, args.worlds, done, spent, compiled)
    print(f"drawing into {args.out}/ ...", flush=True)
    contact_sheet(env, first, args.out / "worlds.png", [f"world {i}" for i in range(len(first))])
    (args.out / "world.xml").write_text(maax.to_mjcf(env, states, world=0))
    gif(env, tqdm(frames, desc="rollout.gif", unit="frame", mininterval=0.5), args.out / "rollout.gif")
    print(f"wrote {args.out}/worlds.png, {args.out}/rollout.gif, {args.out}/world.xml (its keyframe 0 is this state)")


@dataclass
class Sheet:
    """Draws worlds from above: a contact sheet of layouts, nothing is stepped."""

    scenario: tuple[str, ...] = ("empty", "half", "quad", "var_quad", "tri", "random")
    """Room scenarios; of several, every world draws one."""
    placement: tuple[str, ...] = ("uniform",)
    """Where the agents go, each placement in worlds of its own: uniform, centre, quad, outside_quad,
    middle:FRACTION, separation:RADIUS,
    proximity:RADIUS:OBJECT (such as proximity:1:box0), room:INDEX."""
    n: int = 12
    """How many worlds for each placement."""
    outer: Outer = "walls"
    """What closes the arena: walls, joint limits, or nothing."""
    n_agents: int = 4
    """Agents per world."""
    n_boxes: tuple[int, ...] = (1,)
    """Boxes per world: one number, or LOW HIGH for a range."""
    n_elongated_boxes: tuple[int, ...] = (0,)
    """Elongated ones among the boxes: one number, or LOW HIGH for a range."""
    n_ramps: tuple[int, ...] = (1,)
    """Ramps per world: one number, or LOW HIGH for a range."""
    seed: int = 0
    """Of the worlds."""
    out: Path = field(default_factory=lambda: Path("maax-out") / "sheet.png")
    """The picture."""


def sheet(args: Sheet) -> None:
    """Runs `maax-mjx worlds`."""
    if args.n < 1:
        raise ValueError(f"n: got {args.n}; takes at least 1")
    drawn = []
    for placement in args.placement:
        env = maax.Base(args.n_agents)
        env.add_module(maax.WallScenarios(args.scenario, outer=args.outer))
        boxes, elongated = _count("n_boxes", args.n_boxes), _count("n_elongated_boxes", args.n_elongated_boxes)
        env.add_module(maax.Boxes(boxes, n_elongated_boxes=elongated))
        env.add_module(maax.Agents(args.n_agents, parse_placement(placement)))
        env.add_module(maax.Ramps(_count("n_ramps", args.n_ramps)))
        states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(args.seed), args.n))
        drawn += [(env, world_of(states, i), placement) for i in range(args.n)]
    titles = [_title(args, state.world, placement) for _, state, placement in drawn]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    contact_sheet([env for env, *_ in drawn], [state for _, state, _ in drawn], args.out, titles)
    invalid = sum(not state.world.valid for _, state, _ in drawn)
    print(f"wrote {args.out}: {len(drawn)} worlds, {invalid} invalid")


def _title(args: Sheet, world: World, placement: str) -> str:
    parts = [args.scenario[int(world.plan.scenario)]] if len(args.scenario) > 1 else []
    parts += [placement] if len(args.placement) > 1 else []
    return ", ".join(parts or [placement]) + ("" if world.valid else " (invalid)")


def parse_placement(text: str) -> PlacementFn:
    """The placement function that a text such as "middle:0.5" names.

    Raises:
        ValueError: an unknown name, or arguments that it does not take.
    """
    name, *values = text.split(":")
    plain = {
        "uniform": maax.uniform_placement,
        "centre": maax.centre_placement,
        "quad": maax.quad_placement,
        "outside_quad": maax.outside_quad_placement,
    }
    made: dict[str, Callable[..., PlacementFn]] = {
        "middle": lambda fraction: maax.middle_placement(float(fraction)),
        "separation": lambda radius: maax.separation_placement(float(radius)),
        "proximity": lambda radius, to: maax.proximity_placement(float(radius), to),
        "room": lambda index: maax.room_placement(int(index)),
    }
    check_choice("placement", name, [*plain, *made])
    if name in plain and not values:
        return plain[name]
    try:
        return made[name](*values)
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"placement: got {text!r}; see maax-mjx worlds --help for what {name!r} takes") from None


class _Interrupt:
    """Notes Ctrl-C instead of raising it, which would tear down the physics in the middle of a step.

    A second one raises.
    """

    def __enter__(self) -> _Interrupt:
        self.asked = False
        self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _note(self, *_: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


def _count(name: str, values: tuple[int, ...]) -> int | tuple[int, int]:
    if len(values) == 1:
        return values[0]
    if len(values) == 2:
        return values[0], values[1]
    raise ValueError(f"{name}: got {values}; takes one number, or LOW HIGH")


def _advance(worlds: Worlds) -> jax.stages.Wrapped:
    """`(states, key, n)`: n steps under one random action of every world."""

    def advance(states: WorldsState, key: jax.Array, n: jax.Array) -> WorldsState:
        action = worlds.sample_action(key)
        return jax.lax.fori_loop(0, n, lambda _, s: worlds.step_fn(s, action), states)

    return jax.jit(advance, donate_argnums=0)


def _summary(env: Environment, states: WorldsState, n: int, steps: int, spent: float, compiled: float) -> None:
    counts = states.totals()
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


BENCHMARKS = (
    "breakdown", "devices", "engines", "fidelity", "gradients", "grabs", "hostile", "layouts", "load", "memory",
    "objects", "outer", "plots", "profile", "sampling", "scaling", "scenes", "soak", "step",
)  # fmt: skip


def bench(args: list[str]) -> None:
    """Runs `maax-mjx bench NAME`: a module of `maax_mjx.benchmarks` with its own options."""
    listed = "\n  ".join(BENCHMARKS)
    if not args or args[0] in ("-h", "--help"):
        print(f"usage: maax-mjx bench NAME [OPTIONS]; maax-mjx bench NAME --help lists them.\n\nNAME:\n  {listed}")
        return
    name = check_choice("bench", args[0], BENCHMARKS)
    module = import_module(f"maax_mjx.benchmarks.{name}")
    module.main(tyro.cli(module.Config, args=args[1:], prog=f"maax-mjx bench {name}", description=module.__doc__))


def main() -> None:
    """The entry point: parses the command line and runs the command; a user's mistake exits with 2."""
    app = tyro.extras.SubcommandApp()
    app.command(name="rollout")(_rollout)
    app.command(name="worlds")(_sheet)
    app.command(name="bench")(_bench)
    try:
        if sys.argv[1:2] == ["bench"]:
            bench(sys.argv[2:])
        else:
            app.cli(description="maax_mjx: procedurally generated multi-agent worlds on MuJoCo MJX.")
    except (ValueError, OSError, maax.MissingLibraryError) as error:
        print(f"maax-mjx: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("maax-mjx: interrupted", file=sys.stderr)
        raise SystemExit(130) from None


def _rollout(args: tyro.conf.OmitArgPrefixes[Rollout]) -> None:
    rollout(args)


def _sheet(args: tyro.conf.OmitArgPrefixes[Sheet]) -> None:
    sheet(args)


def _bench() -> None:
    """Times things: `maax-mjx bench` lists what, `maax-mjx bench NAME --help` the options."""


_rollout.__doc__ = Rollout.__doc__
_sheet.__doc__ = Sheet.__doc__
