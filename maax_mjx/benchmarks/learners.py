"""Trainers side by side: what they reach in one small game in the same time on the same machine.

The game is that of docs/training.md: in a room, an agent's reward is minus its mean distance to the others. `maax` is
`training.train` with the preset "laptop". The game and `flax` are the code of that page, so that this needs a checkout;
`sb3` (Stable-Baselines3) and JaxMARL's scripts learn through adapters, and need that package and a checkout of JaxMARL.
Every one has its own observations and settings, those that the page or the script gives. The clock begins after the
first update, so that compilation does not count.
"""

from __future__ import annotations

import importlib.util
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import jax
import numpy as np

import maax_mjx as maax
from maax_mjx import adapters, training
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import Count, Positive, PositiveCount
from maax_mjx.common.checks import check_choice
from maax_mjx.common.conditions import CHECKOUT

AGENTS, HORIZON = 4, 100
GAME = {"n_boxes": 0, "n_ramps": 0, "n_frames": 10, "horizon": HORIZON, "impl": "c"}
SCRIPTS = {
    "ippo_ff_mabrax": {"NUM_STEPS": 50, "UPDATE_EPOCHS": 4, "NUM_MINIBATCHES": 8, "GAMMA": 0.95, "GAE_LAMBDA": 0.9},
    "mappo_rnn_mpe": {"NUM_STEPS": 50, "UPDATE_EPOCHS": 4, "NUM_MINIBATCHES": 4, "GAMMA": 0.95, "GAE_LAMBDA": 0.9},
}
"""JaxMARL's, with the settings of the page in place of those of other games; the others are as they are published."""
BINS = {"mappo_rnn_mpe": 3}
"""Of scripts whose actions are discrete."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        learner: "maax", "flax", "sb3", or the name of one of JaxMARL's scripts.
        seeds: of every learner.
        worlds: batch size of all but "maax", which has its preset's.
        seconds: of training, after the first update.
        jaxmarl: a checkout of JaxMARL.
    """

    learner: tuple[str, ...] = ("maax", "flax", "sb3")
    seeds: tuple[Count, ...] = (0,)
    worlds: PositiveCount = 64
    seconds: Positive = 60.0
    jaxmarl: Path | None = None

    def check(self) -> None:
        super().check()
        for name in self.learner:
            check_choice("learner", name, LEARNERS)
            if name in SCRIPTS and not (self.jaxmarl and (self.jaxmarl / "baselines").is_dir()):
                raise ValueError(f"jaxmarl: got {self.jaxmarl} with {name}; takes the folder of a checkout of JaxMARL")


@dataclass(frozen=True)
class Case:
    """One learner with a seed."""

    learner: str
    seed: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """What a learner reached.

    Attributes:
        seconds: of training.
        env_steps_per_s: steps of all worlds.
        first, last: mean reward of an agent's step in the first update that knows it, and in the last tenth of the
            time.
            The first of JaxMARL's scripts is too high: it takes agents whose episode has not ended for 0.
        compile_s: until the first update was made.
    """

    seconds: float
    env_steps_per_s: int
    first: float
    last: float
    compile_s: float


class TimeUp(Exception):
    """The seconds are over."""


@dataclass
class Clock:
    """What was learnt when.

    Attributes:
        seconds: after the first update, after which `note` raises.
        begun: when the learner was begun.
        noted: seconds since it was begun, env steps, and the mean reward of an agent's step, after every update.
    """

    seconds: float
    begun: float = field(default_factory=time.perf_counter)
    noted: list[tuple[float, int, float]] = field(default_factory=list)

    @property
    def over(self) -> bool:
        """Whether the seconds are."""
        return bool(self.noted) and self.noted[-1][0] - self.noted[0][0] > self.seconds

    def note(self, steps: int, reward: float) -> None:
        """Notes an update: env steps so far, and the reward of those that it learnt from.

        Raises:
            TimeUp: the seconds are over.
        """
        self.noted.append((time.perf_counter() - self.begun, int(steps), float(reward)))
        if self.over:
            raise TimeUp


def block(words: str) -> dict[str, Any]:
    """The names that a block of docs/training.md defines, up to where it begins to train."""
    page = (CHECKOUT / "docs" / "training.md").read_text()
    (found,) = [code for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if words in code]
    names: dict[str, Any] = {"__name__": words}
    exec(found.split("\nenv = ")[0], names)
    return names


def gather(**fields: Any) -> maax.Environment:
    """The game."""
    return block("class ActorCritic")["Gather"](maax.make("tag", **GAME, **fields))


def learn_maax(config: Config, seed: int, clock: Clock) -> None:
    """`training.train`."""
    with tempfile.TemporaryDirectory() as folder:
        training.train(
            gather(observations="ego"),
            Path(folder) / "run",
            preset="laptop",
            seed=seed,
            bar=False,
            on_iteration=lambda now: clock.note(now.steps, now.metrics["reward_players"]),
        )


def learn_flax(config: Config, seed: int, clock: Clock) -> None:
    """The page's PPO."""
    names = block("class ActorCritic")
    worlds, update, done = maax.Worlds(gather(), config.worlds), names["update"], [0]

    def noted(params: Any, opt_state: Any, kept: Any, key: jax.Array) -> Any:
        after = jax.block_until_ready(update(params, opt_state, kept, key))
        done[0] += kept["reward"].size // AGENTS
        clock.note(done[0], kept["reward"].mean())
        return after

    names["update"] = noted
    names["train"](worlds, 1_000_000, seed=seed)


def learn_sb3(config: Config, seed: int, clock: Clock) -> None:
    """Stable-Baselines3's PPO."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)

    class Noted(BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            self.reward = self.model.rollout_buffer.rewards.mean()

        def _on_rollout_start(self) -> None:
            if self.num_timesteps:
                clock.note(self.num_timesteps // AGENTS, self.reward)

    worlds = adapters.stable_baselines3(maax.Worlds(gather(), config.worlds), seed=seed, stagger=True)
    settings = {"n_steps": 50, "batch_size": 800, "n_epochs": 4, "gamma": 0.95, "learning_rate": 1e-3}
    PPO("MlpPolicy", worlds, device="cpu", seed=seed, **settings).learn(1_000_000_000, callback=Noted())


def learn_jaxmarl(name: str, config: Config, seed: int, clock: Clock) -> None:
    """One of JaxMARL's scripts, as it is, with what it logs to Weights & Biases noted instead."""
    script = script_of(name, config, clock)
    import jaxmarl

    bins = BINS.get(script.__name__)
    game = gather() if bins is None else maax.DiscretizeActions(gather(), bins)
    jaxmarl.make = lambda name, **fields: adapters.jaxmarl(game)
    settings = published(script) | SCRIPTS[name]
    settings |= {"NUM_ENVS": config.worlds, "ENV_NAME": "gather", "ENV_KWARGS": {}, "ANNEAL_LR": False}
    settings |= {"TOTAL_TIMESTEPS": 2_000_000_000, "SEED": seed}
    key = jax.random.PRNGKey(seed)
    train = script.make_train(settings, key) if name == "ippo_ff_mabrax" else script.make_train(settings)
    try:
        jax.block_until_ready(jax.jit(train)(key))
    except jax.errors.JaxRuntimeError:
        if not clock.over:
            raise


def script_of(name: str, config: Config, clock: Clock) -> ModuleType:
    """JaxMARL's script, with stand-ins for what only its command line and its logging need."""

    def log(numbers: dict[str, Any], step: Any = None) -> None:
        if "returns" in numbers:  # of MPE's wrapper, which multiplies rewards by the number of agents
            steps, total = numbers["env_step"], numbers["returns"] / AGENTS
        else:
            steps, total = numbers["env_step"], numbers["returned_episode_returns"]
        # Theirs are of the last episodes that ended; nothing is known before.
        clock.note(int(steps), float(np.mean(total)) / HORIZON or np.nan)

    assert config.jaxmarl is not None
    same: Callable[..., Any] = lambda *_, **__: lambda main: main  # noqa: E731
    stand_ins: dict[str, Any] = {
        "wandb": SimpleNamespace(log=log),
        "hydra": SimpleNamespace(main=same),
        "omegaconf": SimpleNamespace(OmegaConf=None),
    }
    sys.modules.update({key: value for key, value in stand_ins.items() if key not in sys.modules or key == "wandb"})
    sys.path.insert(0, str(config.jaxmarl))
    (path,) = config.jaxmarl.glob(f"baselines/*/{name}.py")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def published(script: ModuleType) -> dict[str, Any]:
    """The numbers and words of a script's YAML file."""
    assert script.__file__ is not None
    name = script.__name__.replace("mappo_rnn", "mappo_homogenous_rnn")
    found = re.findall(r'^"(\w+)": (\S+)', (Path(script.__file__).parent / "config" / f"{name}.yaml").read_text(), re.M)
    words = {"True": True, "False": False}

    def value(text: str) -> Any:
        text = text.strip('"')
        try:
            return words[text] if text in words else int(text)
        except ValueError:
            try:
                return float(text)
            except ValueError:
                return text

    return {key: value(text) for key, text in found}


Learner = Callable[[Config, int, Clock], None]
LEARNERS: dict[str, Learner] = {
    "maax": learn_maax,
    "flax": learn_flax,
    "sb3": learn_sb3,
    "ippo_ff_mabrax": lambda *args: learn_jaxmarl("ippo_ff_mabrax", *args),
    "mappo_rnn_mpe": lambda *args: learn_jaxmarl("mappo_rnn_mpe", *args),
}


def cases(config: Config) -> Iterator[Case]:
    """Combinations of the options."""
    return (Case(*case) for case in product(config.learner, config.seeds))


def measure(case: Case, config: Config) -> Row:
    """Lets a learner learn until the time is up."""
    clock = Clock(config.seconds)
    with suppress(TimeUp):
        LEARNERS[case.learner](config, case.seed, clock)
    (compile_s, before, _), *_, (end, steps, _) = clock.noted
    spent = end - compile_s
    known = [(when, reward) for when, _, reward in clock.noted if np.isfinite(reward)]
    last = [reward for when, reward in known if when >= end - 0.1 * spent]
    return Row(
        **vars(case),
        seconds=round(spent, 1),
        env_steps_per_s=round((steps - before) / spent),
        first=round(known[0][1], 3),
        last=round(float(np.mean(last)), 3),
        compile_s=round(compile_s, 1),
    )


HEADER = "learner           seed   seconds      env/s   first    last  compile s"


def line(row: Row) -> str:
    """A row of the table."""
    return (
        f"{row.learner:16} {row.seed:5} {row.seconds:9.1f} {row.env_steps_per_s:10,} {row.first:7.2f} {row.last:7.2f} "
        f"{row.compile_s:10.1f}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
