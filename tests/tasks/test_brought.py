"""Games of others: in files, and by entry points of installed packages."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import maax_mjx as maax
from maax_mjx.cli import main
from maax_mjx.tasks import brought, registry

GAME = '''
from dataclasses import dataclass

import maax_mjx as maax
from beside import SIZE


@dataclass(frozen=True)
class PitchConfig(maax.StandardConfig):
    """An empty pitch."""

    scenario: str = "empty"
    floor_size: float = SIZE


def pitch(config: PitchConfig):
    return maax.make("standard", config)


def helper(config):
    return pitch(config)


def nothing(config: int):
    return None
'''


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A folder with a game in it, from which the process forgets what it imports."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "own_game.py").write_text(GAME)
    (tmp_path / "beside.py").write_text("SIZE = 7.0\n")
    yield tmp_path
    for name in ("own_game", "beside", "broken"):
        sys.modules.pop(name, None)


def test_a_function_of_a_file_is_a_game(mine):
    env = maax.make("own_game.py:pitch", floor_size=8.0, impl="c")
    assert env.base.floor_size == 8
    assert maax.config_of("own_game.py:pitch").floor_size == 7
    assert maax.config_of(env) == maax.config_of("own_game.py:pitch", floor_size=8.0, impl="c")
    assert "own_game.py:pitch" in repr(env)
    assert maax.make(f"{mine}/own_game.py:pitch", impl="c").base.floor_size == 7
    assert not [name for name in maax.tasks() if "pitch" in name], "files are not listed"


def test_what_a_file_registers_is_a_game(mine):
    """Under its name, whatever the function is called, also if the file was imported before."""
    with (mine / "own_game.py").open("a") as file:
        file.write('\nmaax.register("meadow", helper, PitchConfig)\n')
    sys.path.insert(0, str(mine))
    import own_game  # noqa: F401

    assert maax.make("own_game.py:meadow", impl="c").base.floor_size == 7
    assert maax.make("meadow", impl="c").base.floor_size == 7
    with pytest.raises(ValueError, match=r"whose file has the games \['meadow', 'pitch'\]"):
        maax.make("own_game.py:moor")


def test_one_game_by_several_paths(mine, monkeypatch):
    monkeypatch.chdir(mine)
    for path in ("own_game.py", "./own_game.py", f"{mine}/own_game.py", f"../{mine.name}/own_game.py"):
        assert brought.is_same_game(f"{path}:pitch", "own_game.py:pitch")
        assert not brought.is_same_game(f"{path}:pitch", "own_game.py:helper")
    assert not brought.is_same_game("other.py:pitch", "own_game.py:pitch")
    assert brought.is_same_game("folder/own_game.py:pitch", "own_game.py:pitch"), "seen from another folder"
    assert not brought.is_same_game("pitch", "own_game.py:pitch")
    assert brought.is_same_game("tag", "tag")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("own_game.py:pich", r"whose file has the games \['pitch'\]"),
        ("own_game.py:nothing", "nothing does not say which config it takes; takes a function of one argument"),
        ("own_game.py:helper", "helper does not say which config it takes; takes .* registers with maax.register"),
        ("other.py:pitch", "there is no file .*other.py"),
        ("own_game.py", "a file without the name of a game; takes .*my_game.py:football"),
        ("broken.py:pitch", r"cannot be imported \(ZeroDivisionError: division by zero\)"),
        ("json.py:pitch", "another module is called json; takes a file renamed"),
        ("own_game:pitch", "takes one of"),
    ],
)
def test_what_is_no_game_is_refused(name, said, mine):
    (mine / "broken.py").write_text("1 / 0\n")
    (mine / "json.py").write_text("")
    with pytest.raises(ValueError, match=rf"^name: got '{name}'.* {said}"):
        maax.make(name)
    assert "broken" not in sys.modules


def test_a_file_that_was_mended_is_taken(mine):
    """What it registered before it failed is forgotten."""
    whole = GAME + '\nmaax.register("meadow", helper, PitchConfig)\n'
    (mine / "own_game.py").write_text(whole + "1 / 0\n")
    with pytest.raises(ValueError, match="ZeroDivisionError"):
        maax.make("own_game.py:meadow")
    assert "meadow" not in maax.tasks()
    (mine / "own_game.py").write_text(whole)
    assert maax.make("own_game.py:meadow", impl="c").base.floor_size == 7


def test_a_file_is_the_same_by_any_path(mine):
    """Also through a link; and what it registers may be made elsewhere."""
    (mine / "folder").mkdir()
    (mine / "folder" / "link.py").symlink_to(mine / "own_game.py")
    with (mine / "own_game.py").open("a") as file:
        file.write('\nimport functools\nmaax.register("part", functools.partial(helper), PitchConfig)\n')
    assert maax.make("own_game.py:part", impl="c").base.floor_size == 7
    assert maax.make("folder/../own_game.py:pitch", impl="c").base.floor_size == 7
    assert maax.make("folder/link.py:pitch", impl="c").base.floor_size == 7


def test_the_shell_takes_files(mine, capsys):
    main(["info", "own_game.py:pitch", "--env.floor_size", "9"])
    assert "floor_size" in (printed := capsys.readouterr().out)
    assert "An empty pitch." in printed
    main(["worlds", "own_game.py:pitch", "--n", "2", "--env.n_boxes", "2", "--out", "sheet.png"])
    assert capsys.readouterr().out == "wrote sheet.png: 2 worlds, 0 invalid\n"
    for line, said in {
        "worlds own_game.py:pitch --n_boxes 2": "n_boxes: got it with own_game.py:pitch; takes it without a game",
        "worlds --env.n_boxes 2": "--env.n_boxes: only rollout",
        "rollout own_game.py": "env: got 'own_game.py', a file without the name of a game",
    }.items():
        with pytest.raises(SystemExit):
            main(line.split())
        assert said in capsys.readouterr().err


@pytest.fixture
def installed(mine):
    """What pip leaves of a package with two games, of which one cannot be imported."""
    info = mine / "own-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
    points = "pitch = own_game:pitch\nlost = own_game:lost\nodd = own_game:helper\n"
    (info / "entry_points.txt").write_text(f"[{brought.GROUP}]\n{points}")
    sys.path.insert(0, str(mine))
    brought.installed.cache_clear()
    yield Path(mine)
    brought.installed.cache_clear()


def test_games_of_installed_packages_are_listed_and_made(installed):
    assert {"pitch", "lost", "odd", "tag"} <= set(maax.tasks())
    assert "own_game" not in sys.modules, "imported when it is asked for"
    assert maax.make("pitch", impl="c").base.floor_size == 7
    with pytest.raises(ValueError, match="did you mean 'pitch'"):
        maax.make("pitchh")


def test_entry_points_that_are_no_games_are_refused(installed):
    with pytest.raises(ValueError, match=r"got 'lost', whose package cannot be imported \(AttributeError: .*has no"):
        maax.make("lost")
    with pytest.raises(ValueError, match=r"whose entry point in 'maax_mjx.games', own_game:helper, is .* annotated"):
        maax.make("odd")


def test_a_config_may_leave_the_engine_to_its_game(mine, capsys):
    (mine / "own_game.py").write_text(
        "from dataclasses import dataclass\nimport maax_mjx as maax\n"
        "@dataclass(frozen=True)\nclass Small:\n    horizon: int = 9\n"
        "def small(config: Small):\n"
        '    return maax.make("standard", scenario="empty", impl="c", horizon=config.horizon)\n'
    )
    main(["info", "own_game.py:small", "--env.horizon", "12", "--json"])
    assert json.loads(capsys.readouterr().out)["fields"]["horizon"] == 12
