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


def run(name: str) -> dict:
    """Runs a block, such as "modules-0", and returns its names."""
    names = {"__name__": "__main__"}
    exec(compile(BLOCKS[name], name, "exec"), names)
    return names
