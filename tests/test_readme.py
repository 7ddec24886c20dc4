"""Every Python block of the README runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from maax_mjx.tasks import registry

README = Path(__file__).parent.parent / "README.md"
BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)

(DESCENT,) = [block for block in BLOCKS if "jax.value_and_grad" in block]


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_block(block, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))
    exec(compile(block, str(README), "exec"), {})
    if block == DESCENT:
        reached = re.fullmatch(r"([\d.]+) mm from the goal after (\d+) iterations\n", capsys.readouterr().out)
        assert float(reached[1]) < 5
        assert int(reached[2]) < 49
