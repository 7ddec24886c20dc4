"""Training as users call it: a run in a folder, which ends by time or steps and goes on where it was."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.annotated import Positive, check_value
from maax_mjx.common.checks import LONG, check_bool, check_count, described
from maax_mjx.common.conditions import conditions
from maax_mjx.common.runtime import is_out_of_memory
from maax_mjx.core.env import Environment
from maax_mjx.core.identity import about_environment
from maax_mjx.parallel import Checkpoints, Worlds
from maax_mjx.parallel.processes import any_process
from maax_mjx.parallel.shards import Devices
from maax_mjx.training.begin import (
    begun_with,
    changed_settings,
    check_begun,
    check_same,
    critic_left,
    environment_of,
    game_fields,
    preset_in,
    taken_over,
)
from maax_mjx.training.collect import Remembered
from maax_mjx.training.config import check_divides
from maax_mjx.training.config import preset as preset_of
from maax_mjx.training.folder import POLICY, SAVES, SMALL, Folder, settings_of
from maax_mjx.training.league import League, worlds_of_each
from maax_mjx.training.learner import RETURN, compile_iteration, counted_by, new_learner
from maax_mjx.training.network import Network
from maax_mjx.training.policy import Policy, game_of, policy_of
from maax_mjx.training.visited import Archive
from maax_mjx.wrappers.split import declared_table

T = TypeVar("T")


class NotFiniteError(FloatingPointError):
    """Rewards, observations or weights that are not finite end a run."""


BROKEN = 10
"""Iterations in a row none of whose updates is finite, after which a run stops."""
LEAST_SECONDS = 10.0
"""Between two drawings of the curves."""


class Progress(NamedTuple):
    """A run after an iteration.

    Attributes:
        iteration: iterations so far.
        steps: env steps so far.
        seconds: of training so far, saves included, and the first iteration of every call, which compiles, not.
        metrics: numbers of the iteration by name.
    """

    iteration: int
    steps: int
    seconds: float
    metrics: dict[str, float]


class Run(NamedTuple):
    """A run that ended.

    Attributes:
        folder: its folder.
        policy: the policy of its end.
        progress: its last iteration.
    """

    folder: Path
    policy: Policy
    progress: Progress | None


class Trainer:
    """A run that is ready to begin or go on; the arguments are those of `train`.

    Attributes:
        changed: the settings with which it goes on that are not those it had, in words; empty without.
    """

    def __init__(
        self,
        game: str | Environment,
        folder: str | Path,
        preset: str | None = None,
        worlds: int | None = None,
        devices: Devices = "all",
        seed: int = 0,
        begin_from: Policy | str | Path | None = None,
        env: Mapping[str, Any] | None = None,
        keep_faults: str | Path | None = None,
        transfer: bool = False,
        **overrides: Any,
    ):
        preset = preset or preset_in(folder)
        overrides, env = game_fields(overrides, env)
        self.config = preset_of(preset, overrides if worlds is None else {**overrides, "worlds": worlds})
        seed = check_count("seed", seed, maximum=LONG)
        self.env = environment_of(game, self.config, env)
        if self.env.base.horizon is None and self.config.ppo.bootstrap == "horizon":
            raise ValueError(
                "ppo.bootstrap: got 'horizon' for a game with horizon=None; takes 'end', which never comes"
            )
        declared_table(self.env, "train", masks=())  # networks read what is declared, and would miss the rest
        self.network = Network.of(self.env, self.config.net)
        self.worlds = Worlds(self.env, self.config.worlds, devices, keep_faults=keep_faults)
        check_divides(self.config, len(self.worlds.shards.devices))
        self._key, self._start, draw = jax.random.split(jax.random.key(seed), 3)
        self.iteration, self.steps, self.seconds = 0, 0, 0.0
        self._since = time.perf_counter()
        self.league = League(self.config.league.keep)
        if check_bool("transfer", transfer) and begin_from is None:
            raise ValueError("transfer: got True without begin_from (--from); takes a policy to begin with as well")
        begin_from = None if begin_from is None else policy_of(begin_from, "begin_from")
        weights = (
            self.network.draw(draw)
            if begin_from is None
            else taken_over(begin_from, self.network, draw, transfer=transfer)
        )
        self.learner = new_learner(weights, self.config)
        self.memory: Any = None
        self.changed = self._critic_left = ""
        self._change: dict[str, Any] | None = None
        # After all that is refused, so that a refusal leaves no folder behind.
        self.folder = Folder(folder, self.config.tensorboard)
        self.folder.claim()
        settings = settings_of(self.config)
        about = {
            "game": game_of(self.env),
            "environment": None if self.env.made else about_environment(self.env),
            "preset": preset,
            "columns": {name: list(columns) for name, columns in self.network.spec.columns().items()},
            "teams": list(self.env.teams),
            "net": settings["net"],
            "seed": seed,
            "settings": settings,
            "conditions": conditions(),
        }
        begun_from = begun_with(begin_from, transfer) if begin_from else None
        if self.folder.found:
            check_same(self.folder, about)
            check_begun(self.folder, begun_from)
            self._restore()
            self._compare(about)
        else:
            if begin_from is not None and not transfer:
                self._critic_left = critic_left(begin_from, self.network)
            self.folder.describe(about | {"begun_from": begun_from})
            self._keep_past()
        if self.memory is None:
            self.memory = self._fresh_memory()
        # Where the program leaves them, or its second run would compile it again.
        shards = self.worlds.shards
        self.learner = shards.replicate(self.learner)
        self.memory = shards.put(jax.tree.map(np.asarray, self.memory))
        self._iterate = compile_iteration(self.worlds, self.network, self.config)

    @cached_property
    def states(self) -> Any:
        """All worlds as they are now; without a save they are drawn when they are first needed, which compiles."""
        key = jax.random.fold_in(self._start, self.iteration)
        return self.worlds.reset(key, stagger=self.env.base.horizon is not None)

    @property
    def goes_on_in_new_worlds(self) -> bool:
        """Whether the run goes on from a save without its worlds, which begin anew."""
        return self.iteration > 0 and "states" not in self.__dict__

    def has(self, steps: int | None) -> bool:
        """Whether the run has its steps already; never without a number."""
        return steps is not None and self.steps >= steps

    @property
    def nothing_to_do(self) -> str:
        """What there is to tell where the run has its steps already."""
        return f"the run has {self.steps:,} steps already, and steps count all of them: nothing to do"

    @property
    def news(self) -> tuple[str, ...]:
        """What is other than one may think where the run begins or goes on, in sentences without a full stop."""
        told = [self._critic_left] if self._critic_left else []
        if self.changed:
            told.append(f"the run goes on with {self.changed}")
        if self.goes_on_in_new_worlds:
            told.append(f"{SAVES}/ has no save of the last policy that fits: what was learnt goes on, in new worlds")
        return tuple(told)

    @property
    def policy(self) -> Policy:
        """The policy as it is now, on the host."""
        return Policy(self.network, jax.device_get(self.learner.weights), game_of(self.env), self.steps)

    def run(
        self,
        minutes: float | None = None,
        steps: int | None = None,
        on_iteration: Callable[[Progress], Any] | None = None,
    ) -> Run:
        """Trains until the minutes or the steps are over, and saves; the arguments are those of `train`."""
        check_end(minutes, steps, on_iteration)
        self.folder.claim()
        if not self.has(steps):
            jax.block_until_ready(self.states)  # drawn before the clock starts
        progress, over, begun, drawn = None, False, self.seconds, 0.0
        saved = self._since = time.perf_counter()
        try:
            while not over and not self.has(steps):
                progress = self._iteration(first=progress is None)
                enough = on_iteration is not None and on_iteration(progress) is False
                over = minutes is not None and self.seconds - begun >= 60 * minutes
                due = time.perf_counter() - saved > 60 * self.config.save_minutes
                # Clocks of several processes differ, and saves are made together.
                over, due = any_process(over or enough, due)
                if due:
                    self.save()
                    saved = time.perf_counter()
                if time.perf_counter() - drawn > LEAST_SECONDS:
                    self.folder.draw()
                    drawn = time.perf_counter()
        finally:
            if progress is not None:
                self.save()
                self.folder.draw(finished=True)
            self.folder.close()
        return Run(self.folder.path, self.policy, progress)

    def save(self) -> None:
        """Saves everything: the run goes on from here; in new worlds, where something in these was not finite."""
        self.folder.keep(self.policy)
        saves = Checkpoints(self.folder.path / SAVES)
        sound = self.config.save_worlds and not int(self.learner.broken)
        if sound and (saves.latest is None or saves.latest < self.iteration):
            counts = _counts(self.steps, self.seconds)
            memory = _parts(self.memory)
            saves.save(self.iteration, self.worlds, self.states, learner=self.learner, memory=memory, counts=counts)
        if self._change:  # with the first save: the folder's settings are those of what it goes on from
            self.folder.go_on(game_of(self.env), settings_of(self.config), self._change)
            self._change = None
        # Last: the newer of the two is what a run goes on from.
        self.folder.save_small(self.learner, self._counters())

    def _iteration(self, first: bool) -> Progress:
        """Makes an iteration and notes it; the first one of a process compiles, which counts as no time."""
        league = self.config.league
        groups = league.at_once(self.worlds.shards.per_device)
        opponents = self.league.draw(self.iteration, groups, league.share) if groups else None
        key = jax.random.fold_in(self._key, self.iteration)
        args = self.learner, opponents, key, self.states, self.memory
        # Together, so that an interrupt while the device works leaves a state that can be saved.
        self.learner, self.states, self.memory, given = self.worlds.run(self._iterate, *args)
        self.iteration += 1
        self.steps += (taken := self.config.worlds * self.config.ppo.unroll)
        metrics = without_the_empty({name: float(x) for name, x in jax.device_get(given).items()})
        # The teams in the game's order; JAX sorts names.
        metrics |= {name: metrics.pop(name) for team in self.env.teams if (name := RETURN + team) in metrics}
        # From iteration to iteration, so that saves and curves count.
        spent = time.perf_counter() - self._since
        self._since += spent
        self.seconds += 0.0 if first else spent
        speed = {"compile_s": spent} if first else {"env_steps_per_s": taken / spent}
        progress = Progress(self.iteration, self.steps, self.seconds, metrics | speed)
        self.folder.note(self._counters() | progress.metrics)
        if int(self.learner.broken) >= BROKEN:
            raise NotFiniteError(
                f"train: {BROKEN} iterations in a row had no update that is finite, the first array that is not: "
                f"{self._not_finite()}; {self.folder.path} has what was learnt before"
            )
        if self.iteration % league.every == 0:
            self._keep_past()
        return progress

    def _counters(self) -> dict[str, float]:
        """How far the run is."""
        return {"iteration": self.iteration, "steps": self.steps, "seconds": self.seconds}

    def _keep_past(self) -> None:
        """Keeps the policy of now, for past opponents and for evaluations."""
        policy = self.policy
        policy.params = policy.params.replace(critic={})
        self.folder.keep_past(policy)
        self.league.add(policy.params)

    def _not_finite(self) -> str:
        """Returns the name of the first array that is not finite."""
        trees = {"obs": self.states.obs, "reward": self.states.reward, "weights": self.learner.weights}
        for path, x in jax.tree.leaves_with_path(trees):
            if jnp.issubdtype(x.dtype, jnp.floating) and not bool(jnp.isfinite(x).all()):
                return jax.tree_util.keystr(path, simple=True, separator=".")
        return "the gradient"

    def _compare(self, about: Mapping[str, Any]) -> None:
        """Finds settings with which the run goes on that are not those it had."""
        found = changed_settings(self.folder.about(), about)
        if found:
            self.changed = "; ".join(f"{name}={now}, not {was}" for name, (was, now) in found.items())
            now = {name: now for name, (_, now) in found.items()}
            self._change = {"iteration": self.iteration, "steps": self.steps, "settings": now}

    def _fresh_memory(self) -> Remembered:
        """What is remembered at the beginning, on the worlds' devices."""
        visited, n_worlds = self.config.visited, self.config.worlds
        archive: Any = Archive.empty(self.env, visited.size, n_worlds) if visited.share else ()
        return Remembered(self.network.memory(n_worlds), self._memory_of_opponents(), archive)

    def _memory_of_opponents(self) -> Any:
        """What past opponents remember at the beginning, in all worlds in which they play."""
        league, shards = self.config.league, self.worlds.shards
        groups = league.at_once(shards.per_device)
        if not groups:
            return ()
        each = worlds_of_each(league.share, groups, shards.per_device)
        return self.network.memory(each * groups * len(shards.devices)).actor

    def _restore(self) -> None:
        """Takes over the newest save; where its worlds and memories do not fit, only what was learnt."""
        policy = self.folder.path / POLICY
        if self.folder.has_no_save and policy.exists():
            steps = Policy.load(policy).steps
            raise ValueError(
                f"folder: got {self.folder.path}, which has a policy of {steps:,} steps and no save to go on from; "
                "takes another folder (--out) with begin_from (--from) that policy"
            )
        saves = Checkpoints(self.folder.path / SAVES)
        learner, memory = jax.eval_shape(lambda: (self.learner, self._fresh_memory()))
        like = jax.tree.map(lambda x: np.empty(x.shape, x.dtype), {"learner": learner, "memory": _parts(memory)})
        small = self.folder.load_small(like["learner"])
        newest = -1 if small is None else small[1]["iteration"]
        if saves.latest is not None and saves.latest >= newest:
            whole = _readable(saves, lambda: saves.fits(self.worlds, memory=like["memory"]))
            worlds, wanted = (self.worlds, like) if whole else (None, {"learner": like["learner"]})
            states, found = _readable(saves, lambda: saves.restore(worlds, counts=_counts(0, 0.0), **wanted))
            if whole:
                self.states, self.memory = states, Remembered(**found["memory"])
            self.learner = found["learner"]
            self.iteration, self.steps = int(saves.latest or 0), int(found["counts"]["steps"])
            self.seconds = float(found["counts"]["seconds"])
        elif small is not None:
            self.learner, numbers = small
            self.iteration, self.steps, self.seconds = (numbers[x] for x in ("iteration", "steps", "seconds"))
        self.learner = self.learner.replace(broken=jnp.zeros_like(self.learner.broken))  # counted from here
        self.folder.forget(self.iteration)
        for steps, file in self.folder.past():
            if steps <= self.steps:
                self.league.add(Policy.load(file).params)


def without_the_empty(metrics: Mapping[str, float]) -> dict[str, float]:
    """Returns an iteration's numbers with NaN for those of episodes where no episode counts for them."""
    return {name: x if metrics.get(counted_by(name), 1.0) else math.nan for name, x in metrics.items()}


def _readable(saves: Checkpoints, read: Callable[[], T]) -> T:
    """Returns what is read of the newest save.

    Raises:
        ValueError: it is damaged; the message says what to delete.
    """
    try:
        return read()
    # Orbax and what it reads with raise errors of a dozen kinds.
    except Exception as error:
        if is_out_of_memory(error):
            raise
        damage = re.search(r"which is damaged \((.*)\); takes", str(error))
        reason = damage[1] if damage else str(error).partition("\n")[0][:160]
        raise ValueError(
            f"folder: the newest save, {saves.folder / str(saves.latest)}, cannot be read ({reason}); delete it: then "
            f"what was learnt goes on in new worlds, or, without {SMALL}/, the run goes on from the save before it"
        ) from error


def check_end(minutes: Any, steps: Any, on_iteration: Any) -> None:
    """Refuses a training that would never end; the arguments are those of `train`.

    Raises:
        ValueError: a number out of its range, what is no function, or none of the three.
    """
    if on_iteration is not None and not callable(on_iteration):
        raise ValueError(f"on_iteration: got {described(on_iteration)}; takes a function of training.Progress")
    if minutes is not None:
        check_value("minutes", minutes, Positive)
    if steps is not None:
        check_count("steps", steps, minimum=1, maximum=LONG)
    if minutes is None and steps is None and on_iteration is None:
        raise ValueError("minutes: got None and no steps; takes one of them, or the training would never end")


def _parts(memory: Remembered) -> dict[str, Any]:
    """Returns what is remembered as saves have it; those of runs without visited states have no archive."""
    parts = {"own": memory.own, "opponents": memory.opponents, "archive": memory.archive}
    return {name: part for name, part in parts.items() if name != "archive" or part != ()}


def _counts(steps: int, seconds: float) -> dict[str, np.ndarray]:
    return {"steps": np.asarray(steps, np.int64), "seconds": np.asarray(seconds, np.float64)}
