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
  let field = null;
  const find = () => {
    if (field && field.isConnected) return field;
    field = [...document.querySelectorAll("input")].find(one => one.value.startsWith("BEGIN"));
    // What it says is for the server alone.
    let row = field;
    while (row && row.parentElement && !row.textContent.includes("LABEL")) row = row.parentElement;
    if (row) row.style.display = "none";
    return field;
  };
  const wait = () => find() || setTimeout(wait, 50);
  const tell = () => {
    if (!find()) return;
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    const counts = Object.entries(presses).map(([code, n]) => `${code}:${n}`);
    set.call(field, ["BEGIN", ...held, ...counts].join(" "));
    field.dispatchEvent(new Event("input", {bubbles: true}));
  };
  const written = new Set(["text", "number", "search", "password", "email", "url", "tel"]);
  const typing = one =>
    one.tagName === "TEXTAREA" || (one.tagName === "INPUT" && written.has(one.type) && !one.readOnly && one !== field);
  const on = down => e => {
    if (!known.has(e.code) || e.ctrlKey || e.metaKey || e.altKey || (down && typing(e.target))) return;
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
  // After a choice from a list keys are for the game again.
  window.addEventListener("click", e => {
    if (e.target.closest("[role=option]")) setTimeout(() => document.activeElement.blur(), 0);
  }, true);
  wait();
})()
"""
LABEL = "Keys that are held"


class Keyboard:
    """The keys of all pages. They tell of them through a field that they hide.

    Args:
        server: of viser.
        codes: the keys to listen to, by `KeyboardEvent.code`, such as "KeyW" and "Space"; pages do nothing else with
            them, but where somebody writes.
    """

    def __init__(self, server: Any, codes: Collection[str]):
        self._lock = Lock()
        self._codes = frozenset(codes)
        self._held: dict[int, frozenset[str]] = {}
        self._pressed: list[str] = []
        self._counts: dict[int, Counter[str]] = {}
        field = self._field = server.gui.add_text(LABEL, BEGIN)
        field.on_update(lambda event: self.told(event.target.value, event.client_id))
        server.on_client_disconnect(lambda client: self.gone(client.client_id))
        # A page runs no script that is put into it later, but the handler of an image that fails.
        script = LISTEN.replace("KNOWN", str(sorted(codes))).replace("BEGIN", BEGIN).replace("LABEL", LABEL)
        server.gui.add_html(f'<img src="data:," style="display: none" onerror="{html.escape(script, quote=True)}">')

    def told(self, text: str, page: int = 0) -> None:
        """Takes what a page says: what is held, and how often it has pressed what, since not every text arrives."""
        words = text.split()
        if words[:1] != [BEGIN]:
            self._field.value = BEGIN
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
            self._held[page] = frozenset(words[1:]) & self._codes

    def gone(self, page: int) -> None:
        """Lets go of what a page held that is not there any more."""
        with self._lock:
            self._held.pop(page, None)
            self._counts.pop(page, None)

    @property
    def held(self) -> frozenset[str]:
        """The keys that are held, in any page."""
        with self._lock:
            return frozenset().union(*self._held.values())

    def pressed(self) -> list[str]:
        """Returns the keys that were pressed since the last call, each as often as it was."""
        with self._lock:
            pressed, self._pressed = self._pressed, []
        return pressed
