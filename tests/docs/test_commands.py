"""Every `maax-mjx` command in the documentation is one: its words are read as a user's, only its work is left out."""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import replace

import pytest
from helpers.pages import BLOCKS, PAGES, ROOT, commands, in_prose

import maax_mjx as maax
from maax_mjx import cli, training
from maax_mjx.cli.options import as_learnt, config_with
from maax_mjx.cli.train import Train
from maax_mjx.cli.worlds import parse_placement
from maax_mjx.common.annotated import check_fields
from maax_mjx.common.checks import check_choice
from maax_mjx.common.options import value_of
from maax_mjx.tasks import registry
from maax_mjx.tasks.brought import module_of
from maax_mjx.training.config import PRESETS, preset

bench = sys.modules["maax_mjx.cli.bench"]  # the package has a function of that name
SAID = [(page, line) for page in PAGES for line in [*commands(page), *in_prose(page)]]


def player(word):
    """Who plays; None for what the reader trains or downloads, and what is in the checkout."""
    of_reader = word.startswith("runs/") or word.endswith(".npz") or word == "self" or (ROOT / word).exists()
    return None if of_reader else training.player_of("policy", word)


def look(args, fields=()):
    """Takes the place of a command's work: refuses the game, fields, settings and players that there are not."""
    check_fields(args)
    game, fields = getattr(args, "game", getattr(args, "env", "")), dict(fields)
    for option in ("policy", "opponents", "begin_from"):
        given = getattr(args, option, None)
        found = None if given is None else player(str(given))
        if isinstance(found, training.TrainedPolicy) and option != "begin_from":
            game = game or found.game["game"]
            fields = as_learnt(game, found) | fields
    for opponent in getattr(args, "against", ()):
        player(opponent)
    for placement in getattr(args, "placement", ()):
        parse_placement(placement)
    if isinstance(args, Train):
        preset(args.preset or "gpu", {name: value_of(text) for name, text in args.settings.items()})
    if not game or game in PRESETS or game.startswith("runs/") or "/" in game:
        assert not fields
        return
    config = config_with(game, "c", fields)
    if getattr(args, "agent", None) is not None:
        check_choice("agent", args.agent, maax.make(game, config).agent_names)


@pytest.fixture
def looking(tmp_path, monkeypatch, made_once):
    """A folder with the game that the pages write, and commands that do nothing."""
    (block,) = (block for block in BLOCKS.values() if 'maax.register("football"' in block)
    (tmp_path / "my_game.py").write_text(block)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))
    monkeypatch.setattr(sys, "path", list(sys.path))
    for command in ("rollout", "train", "evaluate", "run_play", "info", "sheet", "replay"):
        monkeypatch.setattr(cli, command, look)
    benchmark = bench._command
    monkeypatch.setattr(bench, "_command", lambda name: replace(benchmark(name), main=check_fields))
    yield
    sys.modules.pop("my_game", None)


def test_commands_are_understood(looking, capsys):
    assert len(SAID) > 40
    refused = []
    for page, line in SAID:
        try:
            cli.main(shlex.split(line, comments=True)[1:])
        except SystemExit as exited:
            if exited.code:
                refused.append(f"{page.relative_to(ROOT)}: {line}\n{capsys.readouterr().err}")
    assert not refused, "\n".join(refused)


def test_a_command_makes_no_other_game_of_the_file_that_it_reads(looking, monkeypatch):
    made = []
    monkeypatch.setattr(maax, "make", lambda *args, **_: made.append(args))
    module_of("my_game.py:football")
    assert not made


@pytest.mark.parametrize(
    "line",
    [
        "maax-mjx rollout tagg",
        "maax-mjx rollout tag --stepz 3",
        "maax-mjx rollout hide_and_seek --policy quadrant/forts",
        "maax-mjx train tag --preset large",
        "maax-mjx train tag --ppo.rl 1",
        "maax-mjx train tag --env.n_boxs 1",
        "maax-mjx evaluate quadrant/forts --against quadrant/nobody",
        "maax-mjx play tag --agent tagger_9",
        "maax-mjx worlds --placement nowhere",
        "maax-mjx info my_game.py:handball --env.n_balls 1",
        "maax-mjx bench hostile --holds 20",
    ],
)
def test_others_are_not(looking, line):
    with pytest.raises(SystemExit) as exited:
        cli.main(shlex.split(line)[1:])
    assert exited.value.code == 2


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_are_in_shell_blocks(page):
    """And in no other block, which nobody would try."""
    lines = re.findall(r"^ *(?:\$ )?maax-mjx .*", page.read_text(), re.MULTILINE)
    assert len(lines) == len(commands(page)), lines
