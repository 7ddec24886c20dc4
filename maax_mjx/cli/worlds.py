"""`maax-mjx worlds`: pictures of layouts from above."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

import jax
import tyro

import maax_mjx as maax
from maax_mjx.cli.options import Seed, apart, check_out, count_of, game_names, make_env, make_folder, report
from maax_mjx.common.annotated import PositiveCount, check_fields
from maax_mjx.common.checks import check_choice
from maax_mjx.common.runtime import quick_on_cpu
from maax_mjx.common.whole import whole
from maax_mjx.core.blame import blame
from maax_mjx.core.env import Environment
from maax_mjx.core.export import world_of
from maax_mjx.layout import PlacementFn, World, placement_by_name
from maax_mjx.tasks import short_name
from maax_mjx.viewer import contact_sheet

Outer = Literal["walls", "limits", "none"]
KINDS = (".png", ".jpg", ".pdf", ".svg")
MOST = 500
"""Worlds in one picture."""
COUNTS = ("n_boxes", "n_elongated_boxes", "n_ramps")
"""Options that are a number, or two."""
OF_GAMES = ("env", "n", "seed", "out", "json")
"""Options that games take as well."""


@dataclass
class Sheet:
    """Draws worlds from above, as a sheet of layouts, without stepping them.

    With a game, its worlds, whose fields are set as in --env.n_boxes 2,6; without one, worlds of the other options.
    Says how many layouts are invalid and which placements are to blame. Placements are uniform, centre, middle, quad,
    outside_quad, rooms_in_turn, those of OpenAI's code (published_uniform and so on), room0, room1, ..., at:X:Y,
    middle:FRACTION, separation:RADIUS, room:INDEX, proximity:RADIUS:OBJECT (such as proximity:1:box0).
    """

    env: tyro.conf.Positional[game_names()] = ""  # type: ignore[valid-type]
    """Name of an environment, or a game in a file of your own, my_game.py:football."""
    scenario: tuple[str, ...] = ("empty", "half", "quad", "var_quad", "tri", "random")
    """Room scenarios; each world draws one of several."""
    placement: tuple[str, ...] = ("uniform",)
    """Placements of the agents, each in separate worlds."""
    n: PositiveCount = 12
    """Number of worlds for each placement."""
    outer: Outer = "walls"
    """How the arena is closed: walls, joint limits, or not at all (none)."""
    n_agents: PositiveCount = 4
    """Number of agents per world."""
    n_boxes: tuple[int, ...] = (1,)
    """Number of boxes per world, or LOW HIGH for a range."""
    n_elongated_boxes: tuple[int, ...] = (0,)
    """Number of elongated boxes, or LOW HIGH for a range."""
    n_ramps: tuple[int, ...] = (1,)
    """Number of ramps per world, or LOW HIGH for a range."""
    seed: Seed = 0
    """Seed of the worlds."""
    out: Path = field(default_factory=lambda: Path("maax-out") / "sheet.png")
    """File of the picture: .png, .jpg, .pdf or .svg."""
    json: bool = False
    """Whether to print the result as JSON."""


def sheet(args: Sheet, overrides: Mapping[str, str]) -> None:
    """Runs `maax-mjx worlds`.

    Args:
        args: the options.
        overrides: values of the game's config fields, as texts.

    Raises:
        ValueError: an option out of its range, arguments that the modules refuse, or a game with options of worlds
            without one.
    """
    for name in COUNTS:
        setattr(args, name, apart(getattr(args, name)))
    check_fields(args)
    if args.env:
        for option in fields(args):
            if option.name not in OF_GAMES and getattr(args, option.name) != option.default:
                raise ValueError(f"{option.name}: got it with {args.env}; takes it without a game")
    for name in ("scenario", "placement"):
        if not getattr(args, name):
            raise ValueError(f"{name}: got no value; takes one or more names")
    if args.n * len(args.placement) > MOST:
        raise ValueError(
            f"n: got {args.n} for each of {len(args.placement)} placements; takes up to {MOST} worlds in one picture"
        )
    check_out(args.out, KINDS)
    games = list(_games(args, overrides))
    make_folder(args.out.parent)
    drawn, blamed = [], []
    for placement, env in games:
        reset = jax.jit(jax.vmap(env.reset), compiler_options=quick_on_cpu(0))
        states = reset(jax.random.split(jax.random.key(args.seed), args.n))
        drawn += [(env, world_of(states, i), placement) for i in range(args.n)]
        if why := blame(env.base, *jax.device_get((states.world.valid, states.params))):
            blamed.append(f"{placement}: {why}")
    titles = [_title(args, state.world, placement) for _, state, placement in drawn]
    with whole(args.out, "out") as part:
        contact_sheet([env for env, *_ in drawn], [state for _, state, _ in drawn], part, titles)
    invalid = sum(not state.world.valid for _, state, _ in drawn)
    result = {"file": str(args.out), "worlds": len(drawn), "invalid": invalid, "blamed": blamed}
    report(result, args.json, "\n".join([f"wrote {args.out}: {len(drawn)} worlds, {invalid} invalid", *blamed]))


def _games(args: Sheet, overrides: Mapping[str, str]) -> Iterator[tuple[str, Environment]]:
    """Yields what is drawn, with its name: a game, or the worlds of each placement."""
    if args.env:
        # Nothing is stepped; the C engine is the first to be ready.
        yield short_name(args.env), make_env(args.env, "c", overrides)
        return
    for placement in args.placement:
        env = maax.Base(args.n_agents)
        env.add_module(maax.WallScenarios(args.scenario, outer=args.outer))
        boxes, elongated = count_of("n_boxes", args.n_boxes), count_of("n_elongated_boxes", args.n_elongated_boxes)
        env.add_module(maax.Boxes(boxes, n_elongated_boxes=elongated))
        env.add_module(maax.Agents(args.n_agents, parse_placement(placement)))
        env.add_module(maax.Ramps(count_of("n_ramps", args.n_ramps)))
        yield placement, env


def _title(args: Sheet, world: World, name: str) -> str:
    parts = [args.scenario[int(world.plan.scenario)]] if not args.env and len(args.scenario) > 1 else []
    parts += [name] if len(args.placement) > 1 else []
    return ", ".join(parts or [name]) + ("" if world.valid else " (invalid)")


PLACED: dict[str, tuple[str, Callable[..., PlacementFn]]] = {
    "at": ("at:X:Y", lambda x, y: maax.at_placement(float(x), float(y))),
    "middle": ("middle:FRACTION", lambda fraction: maax.middle_placement(float(fraction))),
    "separation": ("separation:RADIUS", lambda radius: maax.separation_placement(float(radius))),
    "proximity": ("proximity:RADIUS:OBJECT", lambda radius, to: maax.proximity_placement(float(radius), to)),
    "room": ("room:INDEX", lambda index: maax.room_placement(int(index))),
}
"""Placements with arguments: how they are written, and how they are made."""


def parse_placement(text: str) -> PlacementFn:
    """Returns the placement function that a text such as "middle:0.5" names.

    Raises:
        ValueError: an unknown name, or arguments that the placement does not take.
    """
    name, *values = text.split(":")
    if not values:
        return placement_by_name(name, also=[form for form, _ in PLACED.values()])
    check_choice("placement", name, PLACED)
    form, make = PLACED[name]
    try:
        return make(*values)
    except (TypeError, ValueError) as error:
        why = f" ({error})" if "; takes" in str(error) else ""
        raise ValueError(f"placement: got {text!r}; takes {form}{why}") from None
