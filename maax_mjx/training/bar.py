"""The progress bar of a run."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from maax_mjx.common.progress import progress
from maax_mjx.training.learner import RETURN
from maax_mjx.training.run import Progress, Trainer
from maax_mjx.training.stages import stage_of


class Bar:
    """A bar on stderr with a run's speed, scores and what is left; used as a context.

    It says that the run compiles as soon as it is made: so make it after the run, which refuses wrong settings.

    Example:
        ```python
        trainer = Trainer("tag", "runs/tag")
        with Bar(minutes=10) as bar:
            trainer.run(10, on_iteration=bar.of(trainer))
        ```

    Args:
        minutes, steps: when the run ends, as of `train`.
    """

    def __init__(self, minutes: float | None = None, steps: int | None = None):
        self._minutes, self._steps = minutes, steps
        self._bar = progress(total=steps, unit="steps", desc="compiling", unit_scale=True, mininterval=0.5)

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def of(self, trainer: Trainer, then: Callable[[Progress], Any] | None = None) -> Callable[[Progress], Any]:
        """Returns what a run calls after every iteration.

        Args:
            trainer: the run, before its first iteration.
            then: called after the bar is drawn; its result is that of the returned function.
        """
        begun, first = trainer.seconds, trainer.steps
        # Not made in this call: the bar's own guess of the time would count them as quick.
        self._bar.n = self._bar.initial = self._bar.last_print_n = first

        def after(now: Progress) -> Any:
            nonlocal first
            spent = (now.seconds - begun) / 60
            if not spent:
                first = now.steps  # the first iteration compiles, and counts as no time
            self._draw(now, trainer, spent, (now.steps - first) / spent if spent else 0.0)
            return None if then is None else then(now)

        return after

    def _draw(self, now: Progress, trainer: Trainer, spent: float, per_minute: float) -> None:
        left = None if self._minutes is None else max(0.0, self._minutes - spent)
        # By the mean speed: a single iteration, which may have saved, says little.
        if self._steps is None and left is not None:
            self._bar.total = int(now.steps + left * per_minute)
        elif self._steps is not None and per_minute:
            by_steps = max(0, self._steps - now.steps) / per_minute
            left = by_steps if left is None else min(left, by_steps)
        made = trainer.env.made_from
        stage = stage_of(made.name, now.metrics) if made and now.metrics.get("episodes") else ""
        self._bar.set_description_str(f"{trainer.config.worlds} worlds")
        self._bar.set_postfix_str(_words(now, stage, left))
        if self._bar.total is not None:
            # The last iteration is a whole one; of more steps than its total tqdm forgets the total.
            self._bar.total = max(self._bar.total, now.steps)
        self._bar.update(now.steps - self._bar.n)


def _words(now: Progress, stage: str, left: float | None) -> str:
    """The end of the bar: speed, scores, stage, what is left."""
    numbers = now.metrics
    words = [f"{numbers['env_steps_per_s']:,.0f} env-steps/s"] if "env_steps_per_s" in numbers else []
    if math.isfinite(numbers.get("episode_caught", math.nan)):
        words.append(f"caught {numbers['episode_caught']:.2f}")
    returns = {name: x for name, x in numbers.items() if name.startswith(RETURN) and math.isfinite(x)}
    words += [f"{name.removeprefix(RETURN)} {x:+.2g}" for name, x in returns.items()]
    words += [f"{numbers['broken']:.2g} of the updates not finite"] if numbers.get("broken") else []
    words += [stage] if stage else []
    if left is not None:
        words.append(f"{left:.1f} min left")
    return ", ".join(words)
