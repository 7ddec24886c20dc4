"""Evaluation: policies against scripted agents, other policies and their own past, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import check_bool, check_choice, check_count, described, suggestion
from maax_mjx.common.progress import progress
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.state import State
from maax_mjx.parallel import Worlds
from maax_mjx.parallel.shards import Devices
from maax_mjx.training.folder import Folder
from maax_mjx.training.opponents import SCRIPTED, Scripted
from maax_mjx.training.policy import Policy, check_trained, load_any
from maax_mjx.training.ratings import LIKELY, Rating, Result, rate
from maax_mjx.training.shipped import file_of, policies
from maax_mjx.training.trained import TrainedPolicy

UNITS = {"k": 10**3, "M": 10**6, "G": 10**9}
"""Of steps, as in "50M"."""
SELF = "self"
"""Name of the policy where it is its own opponent, and in ratings."""
SHOWN = ("caught", "tags")
"""Metrics that tables show, and those that begin with "score_"."""


class Estimate(NamedTuple):
    """A mean over episodes.

    Attributes:
        mean: the mean.
        margin: half of the width of its 95 % interval.
    """

    mean: float
    margin: float

    def __str__(self) -> str:
        return f"{_digits(self.mean, 3)} ± {_digits(self.margin, 2)}"


def _digits(x: float, n: int) -> str:
    """A number with n digits, or as an integer from 100 up; never as 1.1e+02, but where it is minute or huge."""
    if abs(x) >= 100:
        return f"{x:.0f}" if abs(x) < 1e15 else f"{x:.{n}g}"
    if 0 < abs(x) < 1e-6:
        return f"{x:.{n}g}"
    return np.format_float_positional(x, n, unique=False, fractional=False, trim="-")


@dataclass(frozen=True)
class Match:
    """How a policy played a team against an opponent.

    Attributes:
        team: the policy's team; the opponent plays the others.
        opponent: the opponent's name.
        episodes: number of episodes, of those that the physics did not cut off and in which both sides had an agent in
            play.
        score: return of an agent of the team.
        won: share of the episodes in which agents of the team had a higher return in the mean than all others, ties as
            half; in a game of one team that all of its agents play together, a higher one than the opponent has in the
            same worlds.
        metrics: the game's numbers at the end of the episodes.
    """

    team: str
    opponent: str
    episodes: int
    score: Estimate
    won: Estimate
    metrics: dict[str, Estimate]


class Evaluation(NamedTuple):
    """Matches of a policy; printed as a table, with the ratings below it."""

    matches: tuple[Match, ...]

    @property
    def ratings(self) -> dict[str, Rating]:
        """Elo's points of the policy, "self", at 0, and of its opponents; {} for games of one team."""
        if len({match.team for match in self.matches}) < 2:
            return {}
        results = [Result(SELF, m.opponent, m.team, m.won.mean, m.episodes) for m in self.matches]
        return rate(results, SELF)

    def of(self, team: str, opponent: str) -> Match:
        """Returns a match.

        Raises:
            ValueError: no such match.
        """
        for match in self.matches:
            if (match.team, match.opponent) == (team, opponent):
                return match
        raise ValueError(f"of: got {team!r} against {opponent!r}; takes {[(m.team, m.opponent) for m in self.matches]}")

    def __str__(self) -> str:
        names = {name: None for match in self.matches for name in match.metrics}
        shown = [name for name in names if name in SHOWN or name.startswith("score_")]
        head = ["team", "against", "episodes", "return", "won", *shown]
        rows = [
            [m.team, m.opponent, f"{m.episodes:,}", str(m.score), str(m.won), *(str(m.metrics[name]) for name in shown)]
            for m in self.matches
        ]
        widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in [head, *rows]]
        if self.ratings:
            lines += ["", "ratings: " + ", ".join(f"{name} {rating}" for name, rating in self.ratings.items())]
        return "\n".join(line.rstrip() for line in lines)


@dataclass(frozen=True)
class Versus:
    """Two players of one world: the first one's actions for some agents, the second one's for the others.

    Attributes:
        first, second: functions `(state, key, memory, params) -> (action, memory)`.
    """

    first: Callable[..., Any]
    second: Callable[..., Any]

    def __call__(self, state: State, key: jax.Array, memory: Any, params: Any) -> tuple[Any, Any]:
        """Plays one step, as policies with a memory do.

        Args:
            state: of one world.
            key: for both players.
            memory: of the first and the second player.
            params: of the first and the second player, and (n_agents,) bool, whom the first plays: an argument, so
                that one program plays all teams.
        """
        parts = [
            player(state, jax.random.fold_in(key, i), memory[i], params[i])
            for i, player in enumerate((self.first, self.second))
        ]
        mine = params[2]

        def chosen(a: jax.Array, b: jax.Array) -> jax.Array:
            return jnp.where(mine.reshape(-1, *[1] * (a.ndim - 1)), a, b)

        return jax.tree.map(chosen, parts[0][0], parts[1][0]), (parts[0][1], parts[1][1])


def evaluate(
    policy: TrainedPolicy | str,
    against: Sequence[Any] = ("random",),
    episodes: int = 1024,
    env: Environment | None = None,
    teams: Sequence[str] | None = None,
    devices: Devices = None,
    seed: int = 0,
    bar: bool = False,
) -> Evaluation:
    """Plays a policy as each team against each opponent, in worlds that begin as usual.

    Where all play against all, as in tag, the policy plays every second agent. In other games of one team it plays them
    all, and the opponent plays the same worlds without it.

    Args:
        policy: the policy, its file, the folder of a run, or the name of a scripted one or of one of
            `training.policies()`.
        against: opponents: "self", scripted ones by their names in `training.SCRIPTED`, policies, files of them, names
            of `training.policies()`, folders of runs, or "runs/x@50M", a run's past policy nearest to so many steps.
        episodes: episodes of every match, each in a world of its own; those that the physics cuts off, and those in
            which one side has no agent in play, do not count.
        env: the game; None makes that of the policy.
        teams: the policy's teams; None is every team.
        devices: see `Worlds`.
        seed: of the worlds and the actions.
        bar: whether stderr shows which match is played.

    Returns:
        The matches.

    Raises:
        ValueError: an unknown opponent or team, a policy that does not fit the game, a game without a horizon, or no
            episode that counts.
    """
    episodes = check_count("episodes", episodes, minimum=2)
    if isinstance(against, str | Path | TrainedPolicy):
        raise ValueError(f"against: got {described(against)}; takes a list, such as ['random']")
    if not against:
        raise ValueError("against: got none; takes at least one opponent, such as 'random'")
    if env is None:
        if isinstance(policy, str) and policy in SCRIPTED:
            raise ValueError(f"env: got None with the scripted {policy!r}; takes an environment")
        env = player_of("policy", policy).make_env()  # type: ignore[union-attr]
    if check_environment(env).base.horizon is None:
        raise ValueError(
            "env: got an endless game, horizon=None; takes one with a horizon, as whole episodes are compared: "
            "make_env(horizon=1000), --env.horizon 1000"
        )
    names = list(env.teams) if teams is None else [check_choice("teams", team, env.teams) for team in teams]
    if not names:
        raise ValueError("env: got one without teams; takes a game of teams")
    worlds = Worlds(env, episodes, devices)
    mine = seated(player_of("policy", policy), env)
    # All of them before the first match, which takes minutes in some games.
    played = [None if isinstance(one, str) and one == SELF else player_of("against", one) for one in against]
    others = [
        mine if player is None else _opponent(one, player, env) for one, player in zip(against, played, strict=True)
    ]
    matches = []
    with progress(total=len(others) * len(names), unit="matches", disable=not check_bool("bar", bar)) as shown:
        for one, player, other in zip(against, played, others, strict=True):
            name = _title(one, player)
            for team in names:
                shown.set_description_str(f"{team} against {name}")
                matches.append(_match(worlds, mine, other, team, name, seed))
                shown.update()
    return Evaluation(tuple(matches))


def player_of(argument: str, given: Any) -> TrainedPolicy | Scripted:
    """Returns the policy or scripted player that an argument names.

    Raises:
        ValueError: nothing of that name.
    """
    if isinstance(given, str) and given in SCRIPTED:
        return SCRIPTED[given]
    if isinstance(given, TrainedPolicy | Scripted):
        return given
    if isinstance(getattr(given, "policy", None), TrainedPolicy):
        raise ValueError(f"{argument}: got {described(given)}; takes its policy, run.policy")
    if not isinstance(given, str | Path) or not str(given):
        raise ValueError(f"{argument}: got {described(given)}; {_takes_players(argument)}")
    text, at, steps = str(given).rpartition("@")
    if at and not Path(given).exists():
        return _past(argument, text, steps)
    if not file_of(Path(given)).exists():
        meant = suggestion(given, _names(argument))
        raise ValueError(f"{argument}: got {str(given)!r}, and nothing is there{meant}; {_takes_players(argument)}")
    if str(given).endswith(".py"):
        raise ValueError(f"{argument}: got {str(given)!r}, a Python file; {_takes_players(argument)}")
    return load_any(given, argument)


def _names(argument: str) -> list[str]:
    return sorted([*SCRIPTED, *([SELF] if argument == "against" else []), *policies()])


def _takes_players(argument: str) -> str:
    return f"takes a policy, its file, the folder of a run, or one of {_names(argument)}"


def _past(argument: str, folder: str, steps: str) -> Policy:
    """Returns a run's past policy nearest to a number of steps, such as "50M"."""
    unit = UNITS.get(steps[-1:], 1)
    try:
        wanted = float(steps.rstrip("kMG")) * unit
    except ValueError:
        wanted = -1.0
    if not wanted >= 0:
        raise ValueError(f"{argument}: got {steps!r} after the @; takes a number of steps, such as 50M")
    past = Folder(folder).past() if Path(folder).is_dir() else []
    if not past:
        raise ValueError(f"{argument}: got {folder}, which has no past policies; takes the folder of a run")
    return Policy.load(min(past, key=lambda one: abs(one[0] - wanted))[1])


def _title(given: Any, player: TrainedPolicy | Scripted | None) -> str:
    """What tables call a player: a past policy by the steps that it has, which may not be those that were asked for."""
    if not isinstance(given, str):
        return repr(given)
    folder, at, _ = given.rpartition("@")
    if not at or Path(given).exists() or not isinstance(player, Policy):
        return given
    letter = next((letter for letter in reversed(UNITS) if player.steps >= UNITS[letter]), "")
    return f"{folder}@{player.steps / UNITS.get(letter, 1):.4g}{letter}"


class Seated(NamedTuple):
    """A player of one environment: a function for one world, its parameters, and its memory of n worlds."""

    play: Callable[..., Any]
    params: Any
    memory: Callable[[int], Any]


def _opponent(given: Any, player: TrainedPolicy | Scripted, env: Environment) -> Seated:
    """Returns an opponent as it plays an environment; an error names the argument and what it got."""
    try:
        return seated(player, env)
    except ValueError as error:
        raise ValueError(f"against: got {_title(given, player)!r}, which cannot play here; {error}") from None


def seated(player: TrainedPolicy | Scripted, env: Environment) -> Seated:
    """Returns a player as it plays an environment.

    Raises:
        ValueError: an environment that it cannot play.
    """
    if isinstance(player, Scripted):
        return Seated(player.on(env), np.zeros(0, np.float32), lambda n: np.zeros((n, 0), np.float32))
    fitting = check_trained(player).on(env)
    return Seated(fitting.play, fitting.params, fitting.memory)


def seats(env: Environment, team: str) -> np.ndarray:
    """Returns which agents a policy plays as a team, (n_agents,) bool.

    They are those of the team; where all play against all, as in tag, every second one.
    """
    slots = env.teams[team].slots
    alone = len(env.teams) == 1 and any(layer.everyone_for_itself for layer in env.layers)
    return np.isin(np.arange(env.n_agents), slots[::2] if alone else slots)


class _Played(NamedTuple):
    """The first episodes of all worlds: (n_worlds, ...) each.

    Attributes:
        whole: (n_worlds,) bool, episodes that ended and were not cut off by the physics.
        returns: (n_worlds, n_agents).
        active: (n_worlds, n_agents) bool.
        metrics: at the end.
    """

    whole: np.ndarray
    returns: np.ndarray
    active: np.ndarray
    metrics: dict[str, np.ndarray]


def _play(worlds: Worlds, mine: Seated, other: Seated, slots: np.ndarray, seed: int) -> _Played:
    """Plays the first episode of every world, `mine` the agents of `slots` (n_agents,) bool."""
    env, n = worlds.env, worlds.n_worlds
    assert env.base.horizon is not None  # `evaluate` refuses others.
    world_key, play_key = jax.random.split(jax.random.key(seed))
    keep = ("terminated", "truncated", "active", "episode_return", "metrics")
    _, kept = worlds.rollout(
        worlds.reset(world_key),
        Versus(mine.play, other.play),
        env.base.horizon,
        (mine.params, other.params, slots),
        key=play_key,
        keep=keep,
        memory=worlds.shards.put((mine.memory(n), other.memory(n))),
    )
    kept.pop("memory")
    host = {name: jax.tree.map(np.asarray, x) for name, x in kept.items()}
    ended = host["terminated"] | host["truncated"]
    at = ended.argmax(axis=0), np.arange(n)
    # An episode that the physics cut off says nothing about the policies.
    whole = ended.any(axis=0) & ~host["metrics"]["physics_fault"][at]
    metrics = {name: x[at].reshape(n, -1).mean(axis=1) for name, x in host["metrics"].items()}
    return _Played(whole, host["episode_return"][at], host["active"][at], metrics)


def _match(worlds: Worlds, mine: Seated, other: Seated, team: str, opponent: str, seed: int) -> Match:
    """Plays the first episode of every world; where nobody is left for the opponent, it plays them all again."""
    slots = seats(worlds.env, team)
    played = _play(worlds, mine, other, slots, seed)
    alone = slots.all()
    again = _play(worlds, mine, other, ~slots, seed) if alone else played
    we, they = played.active & slots, again.active & (alone | ~slots)
    whole = played.whole & again.whole & we.any(axis=1) & they.any(axis=1)
    if not whole.any():
        raise ValueError(
            f"episodes: got {len(whole)}, and in none of them, as {team} against {opponent}, the physics went well and "
            "both sides had an agent in play; takes more"
        )
    ours, theirs = _mean(played.returns, we), _mean(again.returns, they)
    won = np.where(ours > theirs, 1.0, np.where(ours == theirs, 0.5, 0.0))
    return Match(
        team=team,
        opponent=opponent,
        episodes=int(whole.sum()),
        score=estimate(ours[whole]),
        won=_share(won[whole]),
        metrics={name: estimate(x[whole]) for name, x in played.metrics.items()},
    )


def _mean(x: np.ndarray, where: np.ndarray) -> np.ndarray:
    return np.where(where, x, 0.0).sum(axis=1) / np.maximum(where.sum(axis=1), 1)


def _share(won: np.ndarray) -> Estimate:
    """Returns the mean of shares (n,), with the rule of three where all are equal: 3 in n may still be otherwise."""
    found = estimate(won)
    return found._replace(margin=3 / max(len(won), 3)) if found.margin == 0 else found


def estimate(values: np.ndarray) -> Estimate:
    """Returns the mean of independent numbers (n,) and its 95 % interval."""
    values = np.asarray(values, float)
    error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else float("nan")
    return Estimate(float(values.mean()), float(LIKELY * error))


def as_json(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Returns the matches as JSON has them.

    Raises:
        ValueError: not what `evaluate` returned.
    """
    if not isinstance(evaluation, Evaluation):
        raise ValueError(f"evaluation: got {evaluation!r}; takes what training.evaluate returned")

    def plain(x: Any) -> Any:
        if isinstance(x, Estimate):
            return {"mean": x.mean, "margin": x.margin}
        return {k: plain(v) for k, v in x.items()} if isinstance(x, Mapping) else x

    return [{name: plain(value) for name, value in vars(match).items()} for match in evaluation.matches]
