"""Training in one call."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from typing import Any, cast

from maax_mjx.common.checks import check_bool, described
from maax_mjx.core.env import Environment
from maax_mjx.parallel.shards import Devices
from maax_mjx.training.bar import Bar
from maax_mjx.training.begin import begun, check_words, game_fields, preset_in
from maax_mjx.training.config import preset as preset_of
from maax_mjx.training.folder import is_run
from maax_mjx.training.policy import Policy
from maax_mjx.training.run import Progress, Run, Trainer, check_end


def train(
    game: str | Path | Environment,
    folder: str | Path | None = None,
    preset: str | None = None,
    worlds: int | None = None,
    devices: Devices = "all",
    minutes: float | None = None,
    steps: int | None = None,
    seed: int = 0,
    on_iteration: Callable[[Progress], Any] | None = None,
    begin_from: Policy | str | Path | None = None,
    env: Mapping[str, Any] | None = None,
    keep_faults: str | Path | None = None,
    bar: bool = True,
    transfer: bool = False,
    **overrides: Any,
) -> Run:
    """Trains policies for all teams of a game, against each other.

    A folder with a run in it goes on: bit for bit on `c` and `jax`, with as many worlds on as many devices. Given
    alone, as the game, it goes on with its own game and settings.

    Example:
        ```python
        run = train("hide_and_seek_quadrant", "runs/quad", preset="gpu", minutes=30, **{"ppo.lr": 1e-4})
        run.policy.save("quad.policy")
        train("runs/quad", minutes=30)  # goes on
        ```

    Args:
        game: name of a game, or an environment whose agents observe for themselves; or the folder of a run.
        folder: where everything is written; None where `game` is the folder of a run.
        preset: settings to start from, see `maax_mjx.training.config`; None is that of the folder's run, in a new run
            "laptop" on a CPU and "gpu" elsewhere.
        worlds: number of worlds; None is that of the preset.
        devices: see `Worlds`.
        minutes: minutes of training at most in this call, compilation not included.
        steps: env steps of the whole run; it ends with the iteration that reaches them.
        seed: of the worlds, the weights and all draws.
        on_iteration: called after every iteration; a run ends after it returns False.
        begin_from: a policy that a new run begins with, or its file, the folder of its run, or the name of one of
            `training.policies()`; also of another game with the same columns. Given again with a run that began so, it
            changes nothing.
        env: fields of the game's config to change, such as {"n_boxes": 1}; only with a name.
        keep_faults: folder for the last moments of worlds with faults, see `Worlds`.
        bar: whether stderr shows the progress.
        transfer: whether `begin_from` may be of a game with other observations and actions: what both games have is
            taken over by its name, and the last layers and the norms before them start at random, as where Baker et al.
            fine-tune.
        **overrides: settings by dotted name, such as "ppo.lr"; "env.n_boxes" is a field of the game, as in `env`.

    Returns:
        The run's folder and its policy.

    Warns:
        UserWarning: a run that goes on with other settings than it had, of which `run.json` keeps a list, or in new
            worlds.

    Raises:
        ValueError: an unknown preset or setting, a folder with another run, one that began from another policy or one
            that another process trains, minibatches that do not divide, or an environment that networks cannot read.
        FloatingPointError: ten updates in a row that were not finite; the last good save stays.
        MemoryError: more worlds than fit.
    """
    check_bool("bar", bar)
    if folder is None:
        if not is_run(game):
            raise ValueError(
                f"folder: got none for {described(game)}; takes one, or the folder of a run as the game alone"
            )
        was = begun(cast("str | Path", game))
        overrides, fields = game_fields(overrides, env)
        was.refuse(preset, seed, {"begin_from": begin_from, "transfer": transfer}, fields or {})
        game, folder, preset, seed, env = was.game, Path(str(game)), was.preset, was.seed, {**was.env, **(fields or {})}
        worlds, overrides = was.worlds if worlds is None else worlds, was.settings | overrides
    preset = preset or preset_in(folder)
    # A mistyped setting before what is missing: "steps" may be what was meant.
    settings, _ = game_fields(overrides, env)
    check_words(settings, [name for name in signature(train).parameters if name != "overrides"], game)
    preset_of(preset, settings)
    check_end(minutes, steps, on_iteration)
    game = cast("str | Environment", game)
    trainer = Trainer(
        game, folder, preset, worlds, devices, seed, begin_from, env, keep_faults, transfer, **overrides
    )  # fmt: skip
    is_over = trainer.has(steps)
    for sentence in [trainer.nothing_to_do] if is_over else trainer.news:
        warnings.warn(f"train: {sentence}", stacklevel=2)
    if not bar or is_over:
        return trainer.run(minutes, steps, on_iteration)
    with Bar(minutes, steps) as shown:
        return trainer.run(minutes, steps, shown.of(trainer, on_iteration))
