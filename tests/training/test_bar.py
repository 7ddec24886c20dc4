"""The progress bar of a run."""

from types import SimpleNamespace

from maax_mjx import training

TRAINER = SimpleNamespace(
    seconds=60.0, steps=1000, config=SimpleNamespace(worlds=4), env=SimpleNamespace(made_from=None)
)
"""A run that goes on after a minute."""


def test_what_is_left_follows_from_the_mean_speed():
    """Of ten minutes two are over, with 1,000 steps in each; the last iteration was slow."""
    bar = training.Bar(minutes=10)
    with bar:
        bar.of(TRAINER)(training.Progress(9, 3000, 180.0, {"env_steps_per_s": 0.1}))
        assert bar._bar.total == 3000 + 8 * 1000
        assert bar._bar.n == 3000


def test_the_first_iteration_which_takes_no_time_says_nothing_of_what_is_left():
    with training.Bar(minutes=10) as bar:
        bar.of(TRAINER)(training.Progress(2, 1500, 60.0, {"compile_s": 9.0}))
        assert bar._bar.total == 1500
