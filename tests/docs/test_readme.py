"""Every Python block of the README and of `docs/` runs as it stands, but for fewer worlds."""

from __future__ import annotations

import re
import shlex
import sys
import webbrowser

import pytest
from helpers.pages import BLOCKS, PAGES, PRINTED, commands
from helpers.pages import run as run_block

import maax_mjx.cli.rollout
import maax_mjx.viewer.render  # noqa: F401
from maax_mjx.cli import main
from maax_mjx.layout import scenarios
from maax_mjx.tasks import registry
from maax_mjx.viewer.live import Live

# The modules: the packages have functions of these names.
rollout, render = (sys.modules[f"maax_mjx.{name}"] for name in ("cli.rollout", "viewer.render"))

(DESCENT,) = [name for name, block in BLOCKS.items() if "jax.value_and_grad" in block]
LEARNT = [name for name, block in BLOCKS.items() if "class Gather" in block]


@pytest.mark.slow
@pytest.mark.parametrize("name", BLOCKS)
def test_block(name, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))
    monkeypatch.setattr(scenarios, "_SCENARIOS", dict(scenarios._SCENARIOS))
    monkeypatch.setattr(render, "GIF_FPS", 4)
    for library in ("stable_baselines3", "torch", "jaxmarl", "brax"):
        if re.search(rf"^(import|from) {library}\b", BLOCKS[name], re.MULTILINE):
            pytest.importorskip(library)  # too large to install for one block
    run_block(name, few=name not in LEARNT)
    printed = capsys.readouterr().out
    assert printed == PRINTED.get(name, printed)
    if name == DESCENT:
        reached = re.fullmatch(r"([\d.]+) mm from the goal after (\d+) iterations\n", printed)
        assert float(reached[1]) < 5
        assert int(reached[2]) < 49
    if name in LEARNT:
        before, after = (float(word) for word in re.fullmatch(r"reward a step (\S+) -> (\S+)\n", printed).groups())
        assert after > before + 0.5


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text())
    missing = [target for target in targets if "//" not in target and not (page.parent / target).exists()]
    assert not missing


COMMANDS = [
    line
    for page in PAGES
    if page.stem in ("README", "command_line")
    for line in commands(page)
    # What takes minutes is run at its smallest by tests/cli/test_train.py.
    if "runs/" not in line
]
FEWER = {"--worlds 64": "--worlds 8", "--steps 250": "--steps 60"}
"""What commands are called with here."""


@pytest.mark.slow
def test_commands(tmp_path, monkeypatch, capsys):
    """Those of the README and the page about them, one after the other in one folder: fewer worlds, steps, pictures."""
    assert len(COMMANDS) > 5
    monkeypatch.setattr(rollout, "MAX_FRAMES", 25)
    monkeypatch.setattr(render, "GIF_FPS", 4)
    monkeypatch.setattr(Live, "wait", lambda self: None)  # nobody ends it
    monkeypatch.setattr(webbrowser, "open", lambda url: True)
    monkeypatch.chdir(tmp_path)
    for line in COMMANDS:
        for many, few in FEWER.items():
            line = line.replace(many, few)
        code = None
        try:
            main(shlex.split(line, comments=True)[1:])
        except SystemExit as exited:
            code = exited.code
        assert not code, line
        assert capsys.readouterr().out, line
    assert (tmp_path / "maax-out" / "replay.html").stat().st_size > 500_000
    assert (tmp_path / "play.gif").stat().st_size > 10_000
