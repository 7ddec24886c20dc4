"""`maax-mjx train`: agents that learn a game against each other, in a folder that a later call goes on in."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.cli.interrupt import Interrupt
from maax_mjx.cli.options import Seed, is_game, names, report, values_of
from maax_mjx.common.annotated import Positive, PositiveCount, check_fields
from maax_mjx.common.options import value_of
from maax_mjx.common.whole import whole
from maax_mjx.tasks import short_name
from maax_mjx.training.begin import KEPT, begun
from maax_mjx.training.folder import BOARD, CURVES, METRICS, PAST, POLICY, RUN, SAVES, SMALL, is_run
from maax_mjx.training.learner import RETURN, WHOLE, counted_by
from maax_mjx.training.policy import policy_of

REPLAY = "replay.html"
DEFAULT_MINUTES = 10.0
FILES = (RUN, METRICS, CURVES, POLICY, f"{PAST}/", f"{SAVES}/", f"{SMALL}/", f"{BOARD}/", REPLAY)
"""What a folder may have, as the result names it."""
RECENT = 20
"""Iterations, at the end of a call, over whose episodes the result's means are: those of a single one are noise."""
CAUGHT = "episode_caught"
SHOWN, ENDLESS = 2, 240
"""Worlds in the replay, and its frames of a game without a horizon."""


@dataclass
class Train:
    """Trains agents of all teams of a game against each other (PPO), and writes everything to a folder.

    The same command goes on where the run was; so does `maax-mjx train FOLDER`. Fields of the game's config are set as
    in --env.n_boxes 2, settings of the training as in --ppo.lr 3e-4 --net.core gru --league.share 0.1; `maax-mjx info
    GAME` and `maax-mjx info PRESET` list them. In the folder: run.json, metrics.jsonl, curves.png, policy (the newest
    one), past/, saves/, learner/, and replay.html (with the extra "viewer").
    """

    game: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="GAME")]]
    """Name of a game, one in a file of your own, my_game.py:football, or the folder of a run to go on with."""
    preset: names(training.PRESETS) | None = None  # type: ignore[valid-type]
    """Settings to start from, see `maax-mjx info PRESET`; by default the run's, or "laptop" on a CPU, else "gpu"."""
    worlds: PositiveCount | None = None
    """Number of worlds on all devices together; by default the preset's or run's."""
    minutes: Positive | None = None
    """Minutes of training in this call, compilation not included; 10 without --steps."""
    steps: PositiveCount | None = None
    """Env steps of the whole run, which ends with the iteration that reaches them."""
    out: Path | None = None
    """Folder of the run; by default runs/ and the name of the game."""
    seed: Seed = 0
    """Seed of the worlds, the networks and all draws."""
    begin_from: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """A policy that a new run begins with, also of another game with the same columns."""
    transfer: bool = False
    """Whether that policy may be of a game with other observations and actions: what both have is taken over."""
    devices: str = "all"
    """How many devices, or all."""
    save_minutes: Positive | None = None
    """Minutes between saves; by default as the preset or run."""
    save_worlds: bool | None = None
    """Whether saves have the worlds as well, so that the run goes on bit for bit; by default as the preset or run."""
    tensorboard: bool | None = None
    """Whether metrics are written for TensorBoard as well (extra "tensorboard"); by default as the run, or not."""
    keep_faults: Path | None = None
    """Folder for the last moments of worlds with faults (for `maax-mjx info` and `replay`)."""
    json: bool = False
    """Whether to print the result as JSON; progress goes to stderr."""
    settings: tyro.conf.Suppress[dict[str, str]] = field(default_factory=dict)


def train(args: Train, env: Mapping[str, str]) -> None:
    """Runs the command.

    Args:
        args: the options.
        env: values of the game's config fields, as texts.

    Raises:
        ValueError: what `training.train` refuses.
        KeyboardInterrupt: after Ctrl-C, once everything is written.
    """
    check_fields(args)
    if not args.devices.isdigit() and args.devices != "all":
        raise ValueError(f"devices: got {args.devices}; takes a number, or all")
    args, fields = _went_on(args, env)
    minutes = args.minutes or (None if args.steps else DEFAULT_MINUTES)
    with Interrupt() as interrupt:
        trainer = training.Trainer(
            args.game,
            args.out or Path("runs") / short_name(args.game),
            args.preset,
            args.worlds,
            devices=int(args.devices) if args.devices.isdigit() else args.devices,
            seed=args.seed,
            begin_from=None if args.begin_from is None else policy_of(args.begin_from, "from"),
            env=fields,
            keep_faults=args.keep_faults,
            transfer=args.transfer,
            **{name: value_of(text) for name, text in args.settings.items()},
            **{name: getattr(args, name) for name in KEPT if getattr(args, name) is not None},
        )
        made: list[training.Progress] = []
        recent: deque[training.Progress] = deque(maxlen=RECENT)

        def on_iteration(now: training.Progress) -> bool:
            interrupt.keep()
            made[1:] = [now]
            recent.append(now)
            return not interrupt.asked

        if trainer.has(args.steps):
            print(f"maax-mjx: {trainer.nothing_to_do}", file=sys.stderr)
            run = training.Run(trainer.folder.path, trainer.policy, None)
        else:
            for sentence in trainer.news:
                print(f"maax-mjx: {sentence}", file=sys.stderr)
            with training.Bar(minutes, args.steps) as bar:
                run = trainer.run(minutes, args.steps, bar.of(trainer, on_iteration))
            _replay(trainer, run)
    result = _result(run, made, recent)
    report(result, args.json, "\n".join(f"  {name:15} {value}" for name, value in _rows(result).items()))
    if interrupt.asked:
        raise KeyboardInterrupt


def _went_on(args: Train, env: Mapping[str, str]) -> tuple[Train, dict[str, Any]]:
    """Returns the options and the game's fields, which are those of the run where a folder is given.

    Raises:
        ValueError: neither a game nor the folder of a run, or what a run has already with its folder.
    """
    folder = Path(args.game)
    if is_game(args.game) or not is_run(folder):
        if not is_game(args.game) and ("/" in args.game or folder.is_dir()):
            raise ValueError(
                f"game: got {args.game}, where no run is; takes a game, my_game.py:football, or a run's folder; a "
                "policy to begin with is --from"
            )
        return args, values_of(args.game, env)
    was = begun(folder)
    others = {
        "out": args.out is not None and args.out.resolve() != folder.resolve(),
        "from": args.begin_from,
        "transfer": args.transfer,
    }
    was.refuse(args.preset, args.seed, others, env, "--")
    kept: dict[str, Any] = {
        name: was.settings.get(name) if getattr(args, name) is None else getattr(args, name) for name in KEPT
    }
    gone_on = replace(
        args,
        game=was.game,
        out=folder,
        seed=was.seed,
        preset=was.preset,
        worlds=args.worlds or was.worlds,
        settings={name: str(value) for name, value in was.settings.items() if name not in KEPT} | args.settings,
        **kept,
    )
    return gone_on, was.env | values_of(was.game, env)


def _replay(trainer: training.Trainer, run: training.Run) -> None:
    """Writes a page of the latest play; nothing without the extra."""
    env = trainer.env
    worlds = maax.Worlds(env, SHOWN)
    states = worlds.reset(jax.random.key(trainer.steps))
    n_steps = (env.base.horizon or ENDLESS) - 1
    _, recording = maax.record(worlds, states, run.policy, n_steps, show=list(range(SHOWN)))
    try:
        with whole(run.folder / REPLAY) as part:
            maax.replay(env, recording, part)
    except maax.MissingLibraryError:
        return
    except ValueError as error:  # of marks of one's own; the run is saved, and its result still to be told
        print(f"maax-mjx: no {REPLAY}: {error}", file=sys.stderr)


def _result(
    run: training.Run, made: Sequence[training.Progress], recent: Sequence[training.Progress]
) -> dict[str, Any]:
    """Collects how a call went.

    Args:
        run: the run at its end.
        made: the first and the last iteration of this call, or less.
        recent: its last iterations.
    """
    now, files = run.progress, ", ".join(name for name in FILES if (run.folder / name).exists())
    if now is None:
        return {"folder": str(run.folder), "steps": run.policy.steps, "files": files}
    # From the end of the first iteration, which compiles and counts as no time.
    steps, seconds = made[-1].steps - made[0].steps, made[-1].seconds - made[0].seconds
    names = [name for name in now.metrics if name.startswith((RETURN, CAUGHT))]
    return {
        "folder": str(run.folder),
        "iterations": now.iteration,
        "steps": now.steps,
        "minutes": round(now.seconds / 60, 2),
        "env_steps_per_s": round(steps / seconds) if seconds else None,
        "recent_iterations": len(recent),
        "recent_episodes": round(sum(p.metrics[WHOLE] for p in recent)),
        "broken_updates": sum(p.metrics["broken"] for p in recent) / len(recent),
        **{name: _mean(recent, name) for name in names},
        "files": files,
    }


def _mean(recent: Sequence[training.Progress], name: str) -> float | None:
    """The mean of a number over what counted for it; None if nothing did, or if it is not finite."""
    by = counted_by(name)
    told = [(p.metrics[name], p.metrics[by]) for p in recent if p.metrics[by]]
    mean = sum(x * n for x, n in told) / sum(n for _, n in told) if told else math.nan
    return round(mean, 3) if math.isfinite(mean) else None


def _rows(result: Mapping[str, Any]) -> dict[str, str]:
    """The result in words, with units."""
    if "iterations" not in result:
        return {"folder": result["folder"], "env steps": f"{result['steps']:,}", "files": result["files"]}
    speed = result["env_steps_per_s"]
    rows = {
        "folder": result["folder"],
        "iterations": f"{result['iterations']:,}",
        "env steps": f"{result['steps']:,}",
        "training": f"{result['minutes']:g} min of the run, without compilation",
        "speed": "not measured: one iteration, which compiled"
        if speed is None
        else f"{speed:,} env steps/s in this call",
    }
    n, recent = result["recent_episodes"], result["recent_iterations"]
    over = "the last iteration" if recent == 1 else f"the last {recent} iterations"
    if n:
        found = {key.removeprefix(RETURN): x for key, x in result.items() if key.startswith(RETURN)}
        returns = [f"{team} none" if x is None else f"{team} {x + 0.0:+g}" for team, x in found.items()]
        ended = "the one episode" if n == 1 else f"the {n:,} episodes"
        rows["mean return"] = f"{', '.join(returns)} for each agent, of {ended} that ended in {over}"
        if result.get(CAUGHT) is not None:
            rows["caught"] = f"in {result[CAUGHT]:g} of the steps after preparation, in these episodes"
    else:
        rows["mean return"] = f"none: no whole episode ended in {over}"
    if result["broken_updates"]:
        rows["skipped"] = f"{result['broken_updates']:.2g} of the updates in {over}: not finite, as of NaN in a reward"
    return rows | {"files": result["files"]}
