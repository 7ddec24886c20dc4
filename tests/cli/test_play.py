"""`maax-mjx play`: what it prints, without a page."""

from __future__ import annotations

import logging
import sys
from types import SimpleNamespace

from maax_mjx.cli import main

LOGGER = logging.getLogger("websockets.server")
GAME = ["--env.n_boxes=0", "--env.n_ramps=0", "--env.scenario=empty"]


def test_handshakes_that_fail_are_not_told(monkeypatch, caplog, capsys):
    """A connection that ends before it has said what it wants is an error of websockets', and none of a player's."""

    def wait():
        LOGGER.error("opening handshake failed")
        logging.getLogger("other").error("an error of something else")

    live = SimpleNamespace(url="http://127.0.0.1:1", port=1, wait=wait, stop=lambda: None)
    monkeypatch.setattr(sys.modules["maax_mjx.cli.play"], "play", lambda *_, **__: live)
    main(["play", "tag", "--policy=still", "--no-browser", *GAME])
    assert "play at http://127.0.0.1:1" in capsys.readouterr().out
    assert [record.message for record in caplog.records] == ["an error of something else"]
    wait()
    assert caplog.records[1].name == LOGGER.name, "afterwards, and elsewhere, they are told as ever"
