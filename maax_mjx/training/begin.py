"""What a run begins with: its game, the weights of another run, and that its folder is its own."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import check_choice, described
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.identity import DEFAULT, OWN, difference, differences
from maax_mjx.tasks import config_of, make, tasks
from maax_mjx.tasks.config import field_names, recorded_fields
from maax_mjx.training.config import GROUPS, TrainConfig
from maax_mjx.training.folder import Folder, is_run
from maax_mjx.training.network import Network, Weights
from maax_mjx.training.policy import Policy, check_fits
from maax_mjx.training.transfer import transferred

ENV = "env."
"""What names of the game's fields begin with, among settings of a training."""
KEPT = ("save_minutes", "save_worlds", "tensorboard")
"""Settings outside of groups that a run keeps when it goes on."""


class Begun(NamedTuple):
    """What a run began with, for a call that goes on with its folder alone.

    Attributes:
        game: name of its game.
        preset, seed, worlds: as `train` takes them.
        env: fields of the game's config.
        settings: by dotted name.
    """

    game: str
    preset: str
    seed: int
    worlds: int
    env: dict[str, Any]
    settings: dict[str, Any]

    def refuse(
        self, preset: str | None, seed: int, others: Mapping[str, Any], fields: Mapping[str, Any], prefix: str = ""
    ) -> None:
        """Refuses what a run has already, where its folder is given alone; the engine may change.

        Args:
            preset, seed: as given; those of the run are no mistake, nor are None and 0.
            others: what only new runs take, by name.
            fields: of the game.
            prefix: of the names in messages.

        Raises:
            ValueError: naming it.
        """
        given = {
            **{f"{ENV}{name}": True for name in fields if name != "impl"},
            "preset": preset not in (None, self.preset),
            "seed": seed not in (0, self.seed),
            **others,
        }
        for name in (name for name, value in given.items() if value):
            raise ValueError(f"{prefix}{name}: got it with the folder of a run; takes it with a new run")


def begun(folder: str | Path) -> Begun:
    """Reads what a run began with.

    Raises:
        ValueError: a run of an environment that was not made by name.
    """
    about = Folder(folder).about()
    game, settings = about["game"], about["settings"]
    if game is None:
        raise ValueError(f"game: got {folder}, a run of an environment of one's own; takes one of a registered game")
    was = {f"{group}.{name}": value for group in GROUPS for name, value in settings.get(group, {}).items()}
    was |= {name: settings[name] for name in KEPT if name in settings}
    fields = recorded_fields(config_of(game["game"]), game)
    return Begun(game["game"], about["preset"], about["seed"], settings["worlds"], fields, was)


def game_fields(
    overrides: Mapping[str, Any], env: Mapping[str, Any] | None
) -> tuple[dict[str, Any], Mapping[str, Any] | None]:
    """Splits settings by dotted name into those of the training, and fields of the game with what `env` has of them.

    "env.n_boxes" is a field of the game, as `--env.n_boxes` is in a shell.

    Raises:
        ValueError: a field that is given both ways.
    """
    fields = {name.removeprefix(ENV): value for name, value in overrides.items() if name.startswith(ENV)}
    settings = {name: value for name, value in overrides.items() if not name.startswith(ENV)}
    twice = sorted(fields.keys() & env.keys()) if isinstance(env, Mapping) else []
    if twice:
        raise ValueError(f"env: got {twice} as 'env.{twice[0]}' as well; takes a field of the game once")
    return settings, {**(env or {}), **fields} if fields and (env is None or isinstance(env, Mapping)) else env


def check_words(overrides: Mapping[str, Any], arguments: Iterable[str], game: Any) -> None:
    """Refuses settings that there are not.

    Args:
        overrides: settings by dotted name.
        arguments: what else the function takes that got them.
        game: the game, a field of which may have been meant.

    Raises:
        ValueError: another name; the message suggests the nearest ones.
    """
    names = {*arguments, *field_names(TrainConfig())}
    for name in overrides:
        try:
            check_choice("train", name.partition(".")[0] if name not in names else name, names | set(GROUPS))
        except ValueError as error:
            is_field = isinstance(game, str) and name in field_names(config_of(game))
            hint = f"; a field of the game is env={{{name!r}: ...}}" if is_field else ""
            raise ValueError(f"{error}{hint}") from None


def environment_of(game: Any, config: TrainConfig, env: Mapping[str, Any] | None) -> Environment:
    """Makes the game with the preset's fields, of those that it has, and the user's.

    Args:
        game: a name, or an environment, which is returned as it is.
        config: the settings of a training, whose `env` has fields of games.
        env: fields of the game by name, which come before those.

    Raises:
        ValueError: fields with an environment, or what `make` refuses.
    """
    if game not in tasks() and is_run(game):
        raise ValueError(
            f"game: got {str(game)!r}, the folder of a run; takes the name of its game, or this alone, without a folder"
        )
    if env is not None and not isinstance(env, Mapping):
        raise ValueError(f"env: got {described(env)}; takes a dict of the game's fields, such as {{'horizon': 80}}")
    if not isinstance(game, str):
        if env:
            raise ValueError(
                f"env: got {sorted(env)} with an environment; takes fields only where the game is given by its name"
            )
        return check_environment(game)
    known = field_names(config_of(game))
    return make(game, **({name: value for name, value in config.env.items() if name in known} | dict(env or {})))


def preset_in(folder: str | Path) -> str:
    """Returns the preset of the run in a folder; where none is, the one for this machine."""
    if is_run(folder):
        return Folder(folder).about()["preset"]
    return "laptop" if jax.default_backend() == "cpu" else "gpu"


def taken_over(policy: Policy, network: Network, key: jax.Array, *, transfer: bool = False) -> Weights:
    """Returns the weights of a policy for another run; a critic that it lacks, or that does not fit, is drawn.

    Args:
        policy: the policy.
        network: the run's networks.
        key: for what is drawn.
        transfer: whether the game may have other observations and actions, see `transferred`.

    Raises:
        ValueError: a policy of other networks.
    """
    mine = policy.network
    # In which type the layers compute is no part of what was learnt.
    if replace(mine.net, compute=network.net.compute) != network.net:
        ours, theirs = (asdict(replace(net, compute=network.net.compute)) for net in (network.net, mine.net))
        raise ValueError(
            f"begin_from (--from): got a policy of other networks than the run's, {differences(theirs, ours, 'net.')}; "
            "takes one of the same, or these settings in the run"
        )
    drawn = network.draw(key)
    if transfer:
        if mine.net.encoder == "flat":
            raise ValueError("transfer: got True with net.encoder=flat, which knows no entities; takes pool or attend")
        return jax.tree.map(jnp.array, transferred(policy.params, mine, network, drawn))
    try:
        check_fits(mine, network)
    except ValueError as error:
        raise ValueError(f"{error}, or transfer=True (--transfer)") from None
    keeps = policy.params.critic and not critic_left(policy, network)
    critic = policy.params.critic if keeps else drawn.critic
    # In memory of their own, since they are donated.
    return jax.tree.map(jnp.array, policy.params.replace(critic=critic))


def critic_left(policy: Policy, network: Network) -> str:
    """Says that a run without `transfer` leaves the critic of the policy that it begins with; empty if it does not.

    Args:
        policy: the policy.
        network: the run's networks.
    """
    were, are = ({part.name: part.columns for part in net.spec.critic} for net in (policy.network, network))
    names = [name for name in dict.fromkeys((*were, *are)) if were.get(name) != are.get(name)]
    if not policy.params.critic or not names:
        return ""
    return f"the policy's critic reads other columns of {', '.join(names)}: the run begins with a new one"


def begun_with(policy: Policy, transfer: bool) -> dict[str, Any]:
    """Returns what a run notes of the policy that it begins with, by which another one is told from it."""
    leaves = jax.tree.leaves(policy.params.actor)
    digest = sha256(b"".join(np.asarray(x, np.float32).tobytes() for x in leaves)).hexdigest()[:16]
    return {"game": policy.game, "steps": policy.steps, "transfer": transfer, "digest": digest}


def check_same(folder: Folder, about: Mapping[str, Any]) -> None:
    """Refuses a folder with another run.

    Raises:
        ValueError: another game, network or seed; the message names the first that differs.
    """
    was = folder.about()
    for name in ("game", "columns", "teams", "net", "seed"):
        if other := _other(name, was, about):
            raise ValueError(
                f"folder: got {folder.path}, which has a run with {other}; takes that run's, or another folder (--out)"
            )


def check_begun(folder: Folder, begun_from: Mapping[str, Any] | None) -> None:
    """Refuses a policy to begin with for a run that began with another one, or with none.

    Args:
        folder: of the run.
        begun_from: what is to be known of the policy; None if there is none.

    Raises:
        ValueError: another policy.
    """
    about = folder.about()
    if begun_from is None or "begun_from" not in about:  # as of runs of before it was noted
        return
    was, now = about["begun_from"], json.loads(json.dumps(begun_from))
    if was and was == {name: now.get(name) for name in was}:  # "transfer" was not always noted
        return
    other = f"another one, of {was['steps']:,} steps{_with_transfer(was)}" if was else "none"
    raise ValueError(
        f"begin_from (--from): got a policy of {now['steps']:,} steps{_with_transfer(now)} for {folder.path}, whose "
        f"run began with {other}; takes a new folder, or leave it out to go on"
    )


def _with_transfer(begun: Mapping[str, Any]) -> str:
    return " by transfer" if begun.get("transfer") else ""


def changed_settings(was: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Returns settings that a run had and has, by dotted name, of those that differ; with the engine of its game.

    Settings that there were not yet when the run began are left out.

    Args:
        was, now: what `run.json` says of it, and what it is to say.
    """
    before, after = (_by_dotted_name(about["settings"]) | _engine(about.get("game")) for about in (was, now))
    names = (name for name in after if name in before and before[name] != after[name])
    return {name: (before[name], after[name]) for name in names}


def _engine(game: Mapping[str, Any] | None) -> dict[str, Any]:
    return {"env.impl": game["config"].get("impl", DEFAULT)} if game else {}


def _by_dotted_name(settings: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in settings.items():
        if name in GROUPS and isinstance(value, Mapping):
            found |= {f"{name}.{inner}": x for inner, x in value.items()}
        else:
            found[name] = value
    return found


def _other(name: str, was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """How what a run trains differs from what is asked for, in a few words; empty if it does not.

    Engines do not count: what was learnt travels between machines.
    """
    if name == "game":
        return _other_game(was, now)
    before, after = was.get(name), now[name]
    if before == after or (name == "teams" and before is None):  # as of runs of before there were names of teams
        return ""
    # Presets differ in five settings of the networks, none of which anybody gave.
    if name == "net" and was.get("preset") != now["preset"]:
        return f"preset={was.get('preset')}, not {now['preset']}"
    if name == "columns":
        before = before or {}
        return "other columns of " + ", ".join(
            x for x in dict.fromkeys((*before, *after)) if before.get(x) != after.get(x)
        )
    return differences(before, after, f"{name}.") if isinstance(before, Mapping) else f"{name}={before}, not {after}"


def _other_game(was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """How the game of a run differs from the one that is asked for."""
    named, asked = was["game"], now["game"]
    if named and asked:
        return difference(named, asked)
    if named or asked:
        return f"game={', not '.join(game['game'] if game else OWN for game in (named, asked))}"
    # Of environments of one's own; runs of before these were noted have nothing to compare.
    return difference(was["environment"], now["environment"]) if was.get("environment") else ""
