"""Keys that are held in a page of viser's, which itself tells of presses alone, and moves its camera with some."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Collection
from threading import Lock
from typing import Any

BEGIN = "keys:"
"""What the field begins with by which the page tells what is held."""

LISTEN = """
(() => {
  const known = new Set(KNOWN), held = new Set(), presses = {};
  const tell = () => {
    const field = [...document.querySelectorAll("input")].find(one => one.value.startsWith("BEGIN"));
    if (!field) return;
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    const counts = Object.entries(presses).map(([code, n]) => `${code}:${n}`);
    set.call(field, ["BEGIN", ...held, ...counts].join(" "));
    field.dispatchEvent(new Event("input", {bubbles: true}));
  };
  const typing = e => /^(INPUT|TEXTAREA|SELECT)$/.test(e.target.tagName);
  const on = down => e => {
    if (!known.has(e.code) || e.ctrlKey || e.metaKey || e.altKey || (down && typing(e))) return;
    e.preventDefault();
    e.stopImmediatePropagation();
    if (down ? held.has(e.code) : !held.delete(e.code)) return;
    if (down) {
      held.add(e.code);
      presses[e.code] = (presses[e.code] || 0) + 1;
    }
    tell();
  };
  window.addEventListener("keydown", on(true), true);
  window.addEventListener("keyup", on(false), true);
  window.addEventListener("blur", () => { held.clear(); tell(); });
})()
"""


class Keyboard:
    """The keys of a page. It adds a field to the page that shows what is held.

    Args:
        gui: of viser's server.
        codes: the keys to listen to, by `KeyboardEvent.code`, such as "KeyW" and "Space"; the page does nothing else
            with them.
    """

    def __init__(self, gui: Any, codes: Collection[str]):
        self._lock = Lock()
        self._codes = frozenset(codes)
        self._held: frozenset[str] = frozenset()
        self._pressed: list[str] = []
        self._counts: dict[int, Counter[str]] = {}
        field = gui.add_text("Keys", BEGIN, hint="What is held, and how often what was pressed.")
        field.on_update(lambda event: self.told(event.target.value, event.client_id))
        # A page runs no script that is put into it later, but the handler of an image that fails.
        script = LISTEN.replace("KNOWN", str(sorted(codes))).replace("BEGIN", BEGIN)
        gui.add_html(f'<img src="data:," style="display: none" onerror="{html.escape(script, quote=True)}">')

    def told(self, text: str, page: int = 0) -> None:
        """Takes what a page says: what is held, and how often it has pressed what, since not every text arrives."""
        words = text.split()
        if words[:1] != [BEGIN]:
            return
        counts: Counter[str] = Counter()
        for word in words[1:]:
            code, colon, n = word.partition(":")
            if colon and code in self._codes and n.isdigit():
                counts[code] = int(n)
        with self._lock:
            new = counts - self._counts.get(page, Counter())
            self._pressed += new.elements()
            self._counts[page] = counts
            self._held = frozenset(words[1:]) & self._codes

    @property
    def held(self) -> frozenset[str]:
        """The keys that are held."""
        return self._held

    def pressed(self) -> list[str]:
        """Returns the keys that were pressed since the last call, each as often as it was."""
        with self._lock:
            pressed, self._pressed = self._pressed, []
        return pressed
