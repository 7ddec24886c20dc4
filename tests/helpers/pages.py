"""The pages of the documentation, and the Python blocks in them."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PYTHON_THEN_TEXT = re.compile(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", re.DOTALL)
FOUND = {
    f"{page.stem}-{i}": found for page in PAGES for i, found in enumerate(PYTHON_THEN_TEXT.findall(page.read_text()))
}
BLOCKS = {name: block for name, (block, _) in FOUND.items()}
PRINTED = {name: text for name, (_, text) in FOUND.items() if text}
"""What blocks print, where the page has that below them."""


WORLDS = re.compile(r"(Worlds\(env, (?:n_worlds=)?|\(\()64\b")
"""Where blocks say how many worlds there are, in batches and in the shapes of their actions."""


def run(name: str, few: bool = True) -> dict:
    """Runs a block, such as "modules-0", by default with 8 worlds instead of 64, and returns its names."""
    names = {"__name__": "__main__"}
    exec(compile(WORLDS.sub(r"\g<1>8", BLOCKS[name]) if few else BLOCKS[name], name, "exec"), names)
    return names
