"""Examples in docstrings are code on the site: only fenced blocks are, what is merely indented becomes prose."""

from __future__ import annotations

import ast
import re
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "maax_mjx"
SECTION = re.compile(r"^Examples?:\n((?:    .*\n|\n)+)", re.MULTILINE)
FENCED = re.compile(r"^    ```python\n(.*?)^    ```$", re.MULTILINE | re.DOTALL)


def test_examples_are_fenced_python():
    n_examples = 0
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            text = (ast.get_docstring(node) or "") + "\n"
            sections = SECTION.findall(text)
            assert len(sections) == len(re.findall(r"^\s*examples?:", text, re.MULTILINE | re.IGNORECASE)), path
            for section in sections:
                blocks = FENCED.findall(section)
                assert blocks, f"{path}: an example without a block of ```python\n{section}"
                for block in blocks:
                    ast.parse("if True:\n" + block)
                outside = FENCED.sub("", section)
                assert "```" not in outside, f"{path}: a fence that does not end, or not of Python\n{section}"
            n_examples += len(sections)
    assert n_examples > 15
