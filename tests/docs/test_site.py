"""The documentation site builds without a warning, and has everything that is public."""

from __future__ import annotations

import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

import maax_mjx as maax
from maax_mjx import adapters, training

pytest.importorskip("mkdocs")
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.slow
def test_everything_public_has_its_place(site):
    inventory = (site / "objects.inv").read_bytes()
    text = zlib.decompress(inventory[inventory.index(b"zlib.\n") + 6 :]).decode()
    known = {line.split(" ")[0].rpartition(".")[2] for line in text.splitlines()}
    public = {*maax.__all__, *training.__all__, *adapters.__all__}
    assert len(public) > 100
    assert not sorted(name for name in public - known if not name.startswith("__"))


@pytest.mark.slow
def test_pages_have_their_pictures_and_notebooks_their_outputs(site):
    for page in site.rglob("index.html"):
        for source in re.findall(r'<img[^>]* src="([^"]+)"', page.read_text()):
            assert source.startswith(("data:", "http")) or (page.parent / source).exists(), (page, source)
    quickstart = (site / "notebooks" / "quickstart" / "index.html").read_text()
    assert "data:image/png;base64" in quickstart
    assert maax.__version__ in (site / "CHANGELOG" / "index.html").read_text()
