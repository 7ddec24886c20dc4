"""Progress where stderr is no terminal, and where it is one."""

import sys

from maax_mjx.common import progress as module
from maax_mjx.common.progress import progress


def test_a_log_gets_a_line_every_ten_seconds(capsys, monkeypatch):
    now = 1000.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    bar = progress(None, "compiling", total=500, unit="step", mininterval=0)
    bar.set_description_str("4 worlds")
    with bar:
        for i in range(50):
            now += 0.5
            bar.update(10)
            bar.set_postfix_str(f"{i} env-steps/s")
    told = capsys.readouterr().err
    assert "\r" not in told
    assert "|" not in told
    lines = told.splitlines()
    assert lines[:2] == ["compiling: 0/500 step", "4 worlds: 0/500 step"]
    assert len(lines) == 4, "25 seconds"
    assert lines[3].startswith("4 worlds: 400/500 step")


def test_a_terminal_gets_a_bar(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(progress(range(3), "rows")) == [0, 1, 2]
    told = capsys.readouterr().err
    assert "rows: 100%|" in told
