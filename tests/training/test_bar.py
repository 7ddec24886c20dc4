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


def test_what_is_left_of_steps_follows_from_the_mean_speed():
    """Two of three iterations took time, a minute each; of both ends the nearer one is shown."""
    for minutes, left in ((None, "4.0 min left"), (3, "1.0 min left"), (60, "4.0 min left")):
        with training.Bar(minutes, steps=8000) as bar:
            after = bar.of(TRAINER)
            after(training.Progress(2, 2000, 60.0, {"compile_s": 9.0}))
            assert ("left" in bar._bar.postfix) == (minutes is not None), "nothing is known of the speed yet"
            after(training.Progress(3, 3000, 120.0, {"env_steps_per_s": 16.7}))
            after(training.Progress(4, 4000, 180.0, {"env_steps_per_s": 16.7}))
            assert bar._bar.postfix.endswith(left)
            assert bar._bar.total == 8000


def test_steps_of_earlier_calls_are_no_speed():
    with training.Bar(steps=8000) as bar:
        bar.of(TRAINER)
        assert bar._bar.format_dict["n"] == bar._bar.format_dict["initial"] == 1000
        assert not bar._bar.format_dict["rate"]


def test_returns_of_no_episode_are_not_shown():
    metrics = {"return_a": 2.0, "return_b": float("nan"), "episode_caught": float("nan"), "episodes": 1.0}
    with training.Bar(minutes=10) as bar:
        bar.of(TRAINER)(training.Progress(2, 2000, 120.0, metrics))
        assert bar._bar.postfix == "a +2, 9.0 min left"
        bar.of(TRAINER)(training.Progress(3, 3000, 120.0, metrics | {"broken": 0.5}))
        assert "0.5 of the updates not finite" in bar._bar.postfix
