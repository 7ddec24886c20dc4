"""`maax-mjx rollout`: a batch of worlds under random actions or a policy, with its speed, pictures and files."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import tyro
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx.cli.ended import Ended
from maax_mjx.cli.interrupt import Interrupt
from maax_mjx.cli.options import Seed, as_learnt, game_names, make_env, make_folder, names, report
from maax_mjx.cli.saved import save
from maax_mjx.common.annotated import PositiveCount, check_fields
from maax_mjx.common.progress import progress
from maax_mjx.common.whole import whole
from maax_mjx.core.env import Environment
from maax_mjx.core.export import world_of
from maax_mjx.parallel import Recording, Worlds, WorldsState
from maax_mjx.parallel.memory import check_memory
from maax_mjx.physics import impls
from maax_mjx.training.evaluate import player_of
from maax_mjx.training.opponents import Scripted
from maax_mjx.training.trained import TrainedPolicy
from maax_mjx.viewer import contact_sheet
from maax_mjx.viewer.film import select_worlds

SHEET = 12
"""Worlds in worlds.png."""
HOLD = 24
"""Env steps for which a random action is held."""
FPS = 25
MAX_FRAMES = 250
"""Frames of the film at most, which shows the first ten seconds of a longer rollout."""


@dataclass
class Rollout:
    """Builds an environment, rolls out a batch of worlds with random actions or a policy, and draws them.

    Fields of the environment's config, which `maax-mjx info ENV` lists, are set as in --env.n_boxes 2,6 --env.grab True
    --env.lock.radius 0.3. Writes worlds.png (12 worlds from above), rollout.gif (world 0 moving), rollout.npz (for
    `maax-mjx replay`), replay.html (an interactive page; needs the extra "viewer") and world.xml (world 0 for plain
    MuJoCo). Scripts are random, still, chase, close_door and others; random actions are each held for 24 steps.
    """

    env: tyro.conf.Positional[game_names()] = "standard"  # type: ignore[valid-type]
    """Name of the environment, or a game in a file of your own, my_game.py:football."""
    worlds: PositiveCount = 256
    """Number of worlds stepped together, each in its own layout."""
    steps: PositiveCount = 1000
    """Number of env steps."""
    seed: Seed = 0
    """Seed of the worlds and the actions."""
    impl: names(impls()) = "auto"  # type: ignore[valid-type]
    """Physics engine."""
    policy: Path | None = None
    """A policy (file, run's folder, runs/x@50M, name), its game as it was learnt, or a script; else random play."""
    show: PositiveCount = 1
    """Number of worlds in rollout.npz and replay.html."""
    out: Path = field(default_factory=lambda: Path("maax-out"))
    """Folder for the files."""
    keep_faults: Path | None = None
    """Folder for the last moments of worlds with faults (for `maax-mjx info` and `replay`)."""
    json: bool = False
    """Whether to print the result as JSON; progress goes to stderr."""


def rollout(args: Rollout, overrides: Mapping[str, str]) -> None:
    """Runs the command.

    Args:
        args: the options.
        overrides: values of the environment's config fields, as texts.

    Raises:
        ValueError: an option out of its range, more worlds than fit into memory, or arguments that `maax.make` refuses.
        KeyboardInterrupt: after Ctrl-C, once everything is written.
    """
    check_fields(args)
    if args.show > args.worlds:
        raise ValueError(f"show: got {args.show}; takes at most the number of worlds, {args.worlds}")
    player = None if args.policy is None else player_of("policy", str(args.policy))
    if isinstance(player, TrainedPolicy):
        overrides = as_learnt(args.env, player) | dict(overrides)
    with Interrupt() as interrupt:
        result = _rollout(args, overrides, player, interrupt)
    report(result, args.json, _summary(result))
    if interrupt.asked:
        raise KeyboardInterrupt


def _rollout(
    args: Rollout, overrides: Mapping[str, str], player: TrainedPolicy | Scripted | None, interrupt: Interrupt
) -> dict[str, Any]:
    env = make_env(args.env, args.impl, overrides)
    if player is not None:
        player.on(env)  # which refuses a game that it cannot play
    check_memory("worlds", env, args.worlds, jax.devices()[:1])
    make_folder(args.out)
    worlds = Worlds(env, args.worlds, keep_faults=args.keep_faults)
    world_key, action_key = jax.random.split(jax.random.key(args.seed))
    bar = progress(total=args.steps, unit="steps", desc=f"compiling for {env.base.engine.impl}", mininterval=0.5)
    start, has_ends = time.perf_counter(), env.base.horizon is not None
    states = worlds.reset(world_key, stagger=has_ends)
    first = [world_of(states, i) for i in range(min(SHEET, args.worlds))]
    advance = _advance(worlds, action_key) if player is None else _play(worlds, player, action_key)
    every = min(args.steps, max(1, round(1 / (FPS * env.base.dt))))
    for n in {every, args.steps % every} - {0}:  # a policy's rollout is compiled for a number of steps
        states, _ = advance(states, 0, n)
    states = worlds.reset(world_key, stagger=has_ends)
    compiled = time.perf_counter() - start
    shown = list(range(args.show))
    frames, done, spent = [select_worlds(states, shown)], 0, 0.0
    ended = Ended.none(env.base.n_agents)
    # Named before it is drawn again, or a log had the line of the compilation twice.
    bar.set_description_str(f"{args.worlds} worlds", refresh=False)
    bar.reset()
    interrupt.keep()
    with bar:
        while done < args.steps and not interrupt.asked:
            n = min(every, args.steps - done)
            start = time.perf_counter()
            states, more = jax.block_until_ready(advance(states, done, n))
            spent += time.perf_counter() - start
            ended = ended.plus(more)
            done += n
            bar.update(n)
            bar.set_postfix_str(f"{done * args.worlds / spent:,.0f} env-steps/s")
            if len(frames) < MAX_FRAMES:
                frames.append(select_worlds(states, shown))
    recording = Recording.of(frames)
    files = _write(args, overrides, env, states, first, recording)
    return _result(args, env, states, done, spent, compiled, ended) | {"files": files, "interrupted": interrupt.asked}


Advance = Callable[[WorldsState, int, int], tuple[WorldsState, Ended]]
"""`(states, done, n) -> (states, ended)`: n more steps after those that are done, and what episodes ended in them."""
KEPT = ("terminated", "truncated", "active", "episode_return", "episode_length")
"""What a policy's rollout keeps of every step."""
_sums = jax.jit(Ended.of)


def _advance(worlds: Worlds, key: jax.Array) -> Advance:
    """Steps under random actions, each held for some steps."""

    def hold(states: WorldsState, key: jax.Array, n: jax.Array) -> tuple[WorldsState, Ended]:
        action = worlds.sample_action(key)

        def step(_: jax.Array, carry: tuple[WorldsState, Ended]) -> tuple[WorldsState, Ended]:
            before, sums = carry
            after = worlds.step_fn(before, action)
            more = Ended.of(after.done, before.active, after.episode_return, after.episode_length)
            return after, jax.tree.map(jnp.add, sums, more)

        none = Ended.of(jnp.zeros_like(states.done), states.active, states.episode_return, states.episode_length)
        return jax.lax.fori_loop(0, n, step, (states, none))

    compiled = jax.jit(hold, donate_argnums=0)
    return lambda states, done, n: compiled(states, jax.random.fold_in(key, done // HOLD), jnp.asarray(n))


def _play(worlds: Worlds, player: TrainedPolicy | Scripted, key: jax.Array) -> Advance:
    """Steps under a player, whose memory goes on from call to call."""
    memory: list[Any] = [None]

    def advance(states: WorldsState, done: int, n: int) -> tuple[WorldsState, Ended]:
        now = None if done == 0 else memory[0]
        states, kept = worlds.rollout(states, player, n, key=jax.random.fold_in(key, done), keep=KEPT, memory=now)
        memory[0] = kept.get("memory")
        return states, _sums(kept["terminated"] | kept["truncated"], *(kept[name] for name in KEPT[2:]))

    return advance


def _write(
    args: Rollout,
    overrides: Mapping[str, str],
    env: Environment,
    states: WorldsState,
    first: list[maax.State],
    recording: Recording,
) -> list[str]:
    """Writes the files, the quick ones first."""
    out = args.out
    save(out / "rollout.npz", args.env, overrides, recording, env.made_from)
    with whole(out / "world.xml") as part:
        part.write_text(maax.to_mjcf(env, states, world=0))
    pictures: dict[str, Callable[[Path], Any]] = {
        "worlds.png": lambda path: contact_sheet(env, first, path, [f"world {i}" for i in range(len(first))]),
        "replay.html": lambda path: maax.replay(env, recording, path),
        "rollout.gif": lambda path: maax.video(env, recording, path, worlds=0),
    }
    written = ["rollout.npz", "world.xml"]
    for name, draw in pictures.items():
        try:
            with whole(out / name) as part:
                draw(part)
            written.append(name)
        except (maax.MissingLibraryError, ValueError) as error:  # also of marks of one's own
            tqdm.write(f"no {name}: {error}", file=sys.stderr)
    return [str(out / name) for name in written]


def _result(
    args: Rollout, env: Environment, states: WorldsState, steps: int, spent: float, compiled: float, ended: Ended
) -> dict[str, Any]:
    base, rate = env.base, args.worlds * steps / spent if spent else 0.0
    return {
        "env": args.env,
        "engine": base.engine.impl,
        "device": jax.devices()[0].device_kind,
        "policy": f"random actions held for {HOLD} steps" if args.policy is None else str(args.policy),
        "worlds": args.worlds,
        "agents": base.n_agents,
        "steps": steps,
        "env_steps_per_s": round(rate),
        "physics_steps_per_s": round(rate * base.n_frames),
        "agent_steps_per_s": round(rate * base.n_agents),
        "compile_s": round(compiled, 1),
        **states.totals(),
        "mean_return": ended.mean_return(env.agent_names),
        "mean_length": ended.mean_length,
    }


def _summary(result: Mapping[str, Any]) -> str:
    agents = f"{result['agents']} agent{'s' * (result['agents'] != 1)}"
    rows = {
        "engine": f"{result['engine']} on {result['device']}",
        "worlds": f"{result['worlds']:,} ({agents} each), {result['policy']}",
        "env-steps/s": f"{result['env_steps_per_s']:,}",
        "physics steps/s": f"{result['physics_steps_per_s']:,}",
        "agent-steps/s": f"{result['agent_steps_per_s']:,}",
        "compile time": f"{result['compile_s']} s",
        "episodes ended": f"{result['episodes']:,}" + _lengths(result["mean_length"]),
        "mean return": _returns(result),
        "invalid layouts": f"{result['layout_invalid']:,}",
        "contact overflow": f"{result['contact_overflow']:,} steps",
        "physics faults": f"{result['physics_fault']:,}",
        "wrote": ", ".join(result["files"]),
    }
    return "\n".join(f"  {name:17} {value}" for name, value in rows.items())


def _lengths(mean: float | None) -> str:
    return "" if mean is None else f", after {mean:g} steps on average"


def _returns(result: Mapping[str, Any]) -> str:
    if result["mean_return"] is None:
        return "none: no episode ended"
    n = result["episodes"]
    which = "the episode" if n == 1 else f"the {n:,} episodes"
    shown = ", ".join(f"{name} {value + 0.0:+g}" for name, value in result["mean_return"].items())
    return f"of {which} that ended: {shown}"
