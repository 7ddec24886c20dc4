"""The notebooks run, and what is committed of them is what a run leaves."""

from __future__ import annotations

import html
import importlib.util
import re
from pathlib import Path

import nbformat
import numpy as np
import pytest
from helpers.browser import browser, needs_browser, seen_at

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "notebooks"
spec = importlib.util.spec_from_file_location("execute", FOLDER / "execute.py")
execute = importlib.util.module_from_spec(spec)
spec.loader.exec_module(execute)

NAMES = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
REPLAYS = ("quickstart", "hide_and_seek", "training")
MEGABYTES = 1.5
KERNEL = {"MAAX_NOTEBOOK_SCALE": "0.02", "PYTHONPATH": str(ROOT)}
"""What a kernel's environment has besides that of the tests."""


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def committed(name):
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def replays(notebook):
    """The web pages that cells show, as the browser gets them."""
    pages = []
    for cell in code_cells(notebook):
        for output in cell.outputs:
            shown = re.fullmatch(r'<iframe srcdoc="([^"]*)".*', output.get("data", {}).get("text/html", ""), re.DOTALL)
            pages += [html.unescape(shown[1])] if shown else []
    return pages


def test_all_notebooks_are_listed():
    assert sorted(execute.NAMES) == NAMES


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_runs(name, monkeypatch):
    for variable, value in KERNEL.items():
        monkeypatch.setenv(variable, value)
    ran = execute.clean(execute.execute(name))
    assert not [o for cell in code_cells(ran) for o in cell.outputs if o.get("name") == "stderr"]
    assert [cell.source for cell in ran.cells] == [cell.source for cell in committed(name).cells]
    assert len(replays(ran)) == (name in REPLAYS)


@pytest.mark.parametrize("name", NAMES)
def test_is_committed_with_the_outputs_of_one_run(name):
    path = FOLDER / f"{name}.ipynb"
    notebook = committed(name)
    nbformat.validate(notebook)
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert outputs
    assert {output.output_type for output in outputs} <= {"stream", "execute_result", "display_data"}
    assert not [output for output in outputs if output.get("name") == "stderr"]
    assert path.stat().st_size < 1e6 * MEGABYTES
    assert notebook.metadata == execute.KERNEL
    for output in outputs:
        words = output.get("text", "") + output.get("data", {}).get("text/plain", "")
        assert not re.search(r"/(home|root|tmp|work|Users)\b| at 0x", words), words


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("name", REPLAYS)
def test_the_committed_replay_plays_in_a_browser(name, driver, tmp_path):
    (page,) = replays(committed(name))
    (tmp_path / "cell.html").write_text(f'<!DOCTYPE html><iframe srcdoc="{html.escape(page)}" width=400 height=500>')
    driver.get((tmp_path / "cell.html").as_uri())
    driver.switch_to.frame(0)
    early, late = (seen_at(driver, seconds) for seconds in ("0.5", "3.5"))
    assert early.shape == late.shape
    assert (np.abs(early.astype(int) - late).max(axis=-1) > 30).sum() > 50, "nothing moved"
