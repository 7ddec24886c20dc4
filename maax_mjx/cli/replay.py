"""`maax-mjx replay`: a page or film of a saved rollout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro
from PIL import Image

import maax_mjx as maax
from maax_mjx.cli.options import check_out, make_folder, names, report
from maax_mjx.cli.saved import load
from maax_mjx.common.whole import whole
from maax_mjx.viewer.render import VIEWS

KINDS = (".html", ".mp4", ".gif", ".png")


@dataclass
class Replay:
    """Makes a page (.html), a film (.mp4, .gif) or a picture of the last moment (.png) of a saved rollout."""

    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE")]]
    """The rollout.npz that maax-mjx rollout wrote, or a fault of --keep-faults, faults/0.npz."""
    out: Path | None = None
    """File to write, whose ending decides the kind; by default the input's name with .html."""
    worlds: tuple[int, ...] = ()
    """Indices of the worlds to show, side by side; all by default."""
    speed: float = 1.0
    """Factor of the speed; 1 is real time."""
    size: tuple[int, int] = (640, 480)
    """Size of a film or picture in pixels."""
    view: names(VIEWS) = "auto"  # type: ignore[valid-type]
    """View of a film or picture: 3d (needs OpenGL), plan (needs none) or auto."""
    vision: bool = False
    """Whether to show what agents see; needs LineOfSight in the environment."""
    lidar: bool = False
    """Whether to show the lidar's rays; needs Lidar in the environment."""
    json: bool = False
    """Whether to print the result as JSON."""


def replay(args: Replay) -> None:
    """Runs the command.

    Raises:
        ValueError: another ending, a file that is no rollout, or options that the pictures refuse.
        MissingLibraryError: a library that the kind of picture needs is missing.
    """
    if args.file.is_dir():
        raise ValueError(f"file: got {args.file}, which is a folder; takes a rollout.npz of maax-mjx rollout")
    out = args.file.with_suffix(".html") if args.out is None else args.out
    check_out(out, KINDS)
    kind = out.suffix.lower()
    env, recording = load(args.file)
    worlds = list(args.worlds) or None
    n_frames, n_worlds = recording.states.step.shape
    if worlds and not all(-n_worlds <= world < n_worlds for world in worlds):
        raise ValueError(
            f"worlds: got {worlds}; takes numbers below {n_worlds}, of the worlds in {args.file}; "
            "maax-mjx rollout --show keeps more of them"
        )
    make_folder(out.parent)
    senses: Any = {"vision": args.vision, "lidar": args.lidar}
    with whole(out, "out") as part:
        if kind == ".html":
            maax.replay(env, recording, part, worlds=worlds, speed=args.speed, **senses)
        elif kind == ".png":
            last = jax.tree.map(lambda x: x[-1], recording.states)
            shown = worlds or list(range(len(last.step)))
            picture = maax.render(env, last, worlds=shown, size=args.size, view=args.view, **senses)
            Image.fromarray(picture).save(part)
        else:
            maax.video(env, recording, part, worlds=worlds, speed=args.speed, size=args.size, view=args.view, **senses)
    n_bytes = out.stat().st_size
    result = {"file": str(out), "frames": n_frames, "worlds": len(worlds or range(n_worlds)), "bytes": n_bytes}
    report(result, args.json, f"wrote {out}: {n_frames} frames, {n_bytes / 1e6:.2f} MB")
