"""The pages of the documentation, the Python blocks in them, and the commands."""

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


def commands(page: Path) -> list[str]:
    """Lines of a page's shell blocks that call `maax-mjx`, each a whole command."""
    blocks = re.findall(r"^ *```sh\n(.*?)^ *```$", page.read_text(), re.DOTALL | re.MULTILINE)
    lines = "".join(blocks).replace("\\\n", "").splitlines()  # a command may go on in the next line
    return [line.strip() for line in lines if line.strip().startswith("maax-mjx ")]


def in_prose(page: Path) -> list[str]:
    """Commands in a page's sentences: those with more than one word, and none that stands for others, as NAME does."""
    found = re.findall(r"`(maax-mjx(?:\s+(?![A-Z]+\b)[^\s`]+){2,})`", page.read_text())
    return [" ".join(command.split()) for command in found]


WORLDS = re.compile(r"(Worlds\(env, (?:n_worlds=)?|\(\()64\b")
"""Where blocks say how many worlds there are, in batches and in the shapes of their actions."""


def run(name: str, few: bool = True) -> dict:
    """Runs a block, such as "modules-0", by default with 8 worlds instead of 64, and returns its names."""
    names = {"__name__": "__main__"}
    exec(compile(WORLDS.sub(r"\g<1>8", BLOCKS[name]) if few else BLOCKS[name], name, "exec", dont_inherit=True), names)
    return names
