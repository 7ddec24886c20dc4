"""What files of results say about the run behind every row; which files and benchmarks there are."""

from __future__ import annotations

import json
import pkgutil
import shutil
import subprocess
from dataclasses import dataclass
from datetime import date
from importlib import import_module

import pytest
from matplotlib.figure import Figure

from maax_mjx import benchmarks
from maax_mjx.benchmarks import plots, record
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.conditions import commit, conditions


@dataclass
class Config(Options):
    """Options of a benchmark that counts."""

    numbers: tuple[int, ...] = (1, 2)
    power: int = 2


@dataclass(frozen=True)
class Case:
    number: int


@dataclass(frozen=True)
class Row(Case, Measured):
    result: int


def measure(case, config):
    return Row(case.number, result=case.number**config.power)


COUNT = benchmark(Config, Row, lambda config: map(Case, config.numbers), measure, str)


def rows_of(path):
    return json.loads(path.read_text())["rows"]


def test_rows_keep_the_run_that_measured_them(tmp_path):
    path = tmp_path / "count.json"
    COUNT.main(Config(out=path))
    COUNT.main(Config(out=path, numbers=(2, 3), power=3, max_minutes=5.0))
    rows = rows_of(path)
    assert [(row["number"], row["result"]) for row in rows] == [(1, 1), (2, 4), (3, 27)]
    assert [row["measured"]["options"] for row in rows] == [
        {"max_minutes": None, "numbers": [1, 2], "power": 2},
        {"max_minutes": None, "numbers": [1, 2], "power": 2},
        {"max_minutes": 5.0, "numbers": [2, 3], "power": 3},
    ]
    for row in rows:
        assert list(row) == ["number", "result", "measured"], "figures come first"
        assert row["measured"]["date"] == date.today().isoformat()
        assert row["measured"]["commit"] == commit()


def test_a_benchmark_of_nothing_is_refused(tmp_path):
    """It measured nothing, in silence."""
    with pytest.raises(ValueError, match="numbers: got none; takes at least one"):
        COUNT.main(Config(out=tmp_path / "count.json", numbers=()))
    assert not (tmp_path / "count.json").exists()


def test_rows_from_before_that_are_kept_as_they_are(tmp_path):
    """Nothing is invented about them when a later run adds rows."""
    path = tmp_path / "count.json"
    known = {name: value for name, value in conditions().items() if name != "commit"}
    old = {"conditions": known, "config": "Config(...)", "rows": [{"number": 1, "result": 10}]}
    path.write_text(json.dumps(old))
    COUNT.main(Config(out=path))
    first, second = rows_of(path)
    assert first == {"number": 1, "result": 10, "measured": None}
    assert second["result"] == 4
    assert second["measured"]["options"]["numbers"] == [1, 2]


def test_an_interruption_loses_no_row(tmp_path):
    def until_three(case, config):
        if case.number == 3:
            raise KeyboardInterrupt
        return measure(case, config)

    path = tmp_path / "count.json"
    command = benchmark(Config, Row, lambda config: map(Case, config.numbers), until_three, str)
    with pytest.raises(KeyboardInterrupt):
        command.main(Config(out=path, numbers=(1, 2, 3, 4)))
    assert [row["number"] for row in rows_of(path)] == [1, 2]


def git(folder, *words):
    identity = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
    done = subprocess.run(["git", "-C", str(folder), *identity, *words], check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository that has a package and its results, committed."""
    # A hook that runs these tests would otherwise have its own repository asked.
    monkeypatch.delenv("GIT_DIR", raising=False)
    root = tmp_path / "repository"
    for file in ("maax_mjx/code.py", "docs/results/a.json"):
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_text("1\n")
    git(tmp_path, "init", "-q", str(root))
    git(root, "add", ".")
    git(root, "commit", "-q", "-m", "x")
    commit.cache_clear()
    yield root
    commit.cache_clear()


def test_commit(checkout):
    head = git(checkout, "rev-parse", "HEAD")
    # Results change as they are measured, which does not change what is measured.
    (checkout / "docs/results/a.json").write_text("2\n")
    assert commit(checkout) == head


@pytest.mark.parametrize("file", ["maax_mjx/code.py", "maax_mjx/untracked.py"])
def test_commit_with_other_code(file, checkout):
    (checkout / file).write_text("2\n")
    assert commit(checkout) == f"{git(checkout, 'rev-parse', 'HEAD')}-dirty"


def test_no_commit_outside_a_checkout(checkout):
    """Where the package is installed inside somebody else's repository, that one's commit says nothing."""
    installed = checkout / "venv" / "site-packages"
    installed.mkdir(parents=True)
    assert commit(installed) is None


def test_benchmarks_are_listed_with_what_they_are():
    names = [info.name for info in pkgutil.iter_modules(benchmarks.__path__)]
    modules = {name: import_module(f"maax_mjx.benchmarks.{name}") for name in names}
    assert set(benchmarks.BENCHMARKS) == {name for name, module in modules.items() if hasattr(module, "COMMAND")}
    for name in benchmarks.BENCHMARKS:
        command = modules[name].COMMAND
        assert command.config is modules[name].Config
        assert command.description.splitlines()[0].endswith(".")


RESULTS = sorted(record.RESULTS.glob("*.json"))
BEFORE_ENV = ("step_c_cpu", "step_jax_cpu", "step_warp_h200")
"""Files from before rows of `step` named their environment; it is M in all of them."""


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_committed_results_are_rows_of_their_benchmark(path):
    """A later run can go on from them, or is refused in a sentence."""
    kinds = {name: name for name in benchmarks.BENCHMARKS} | {
        "games": "step",
        "first": "first_step",
        "train": "train_speed",
    }
    module = import_module(f"maax_mjx.benchmarks.{kinds[path.stem.split('_')[0]]}")
    if path.stem in BEFORE_ENV:
        with pytest.raises(ValueError, match="takes a file with rows of this benchmark"):
            record.read_rows(path, module.Row)
    else:
        assert record.read_rows(path, module.Row)


@pytest.mark.slow
def test_committed_results_are_drawn(tmp_path, capsys, monkeypatch):
    """With few dots and no layout, which take most of the time."""
    save = Figure.savefig

    def coarse(self, path, dpi):
        self.set_layout_engine("none")
        save(self, path, dpi=20)

    monkeypatch.setattr(Figure, "savefig", coarse)
    for path in RESULTS:
        shutil.copy(path, tmp_path)
    for path in record.RESULTS.glob("runs/*/metrics.jsonl"):
        shutil.copytree(path.parent, tmp_path / "runs" / path.parent.name, ignore=shutil.ignore_patterns("*.png"))
    plots.main(plots.Config(tmp_path))
    pictures, drawn = ({x.relative_to(folder) for x in folder.rglob("*.png")} for folder in (record.RESULTS, tmp_path))
    assert len(pictures) > 10
    assert drawn == pictures
    assert len(capsys.readouterr().out.split()) == len(pictures)
