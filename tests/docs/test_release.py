"""What a release says of its version: the package, the changelog, and the citation agree."""

from __future__ import annotations

import datetime
import re
import tomllib
from pathlib import Path

from maax_mjx.common.version import VERSION

ROOT = Path(__file__).parents[2]


def test_the_version_is_in_one_place():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"] == {"path": "maax_mjx/common/version.py"}


def test_the_changelog_begins_with_it_and_the_citation_has_it():
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] in (f"{VERSION} (unreleased)", f"{VERSION} ({dates()[0]})")
    cited = (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^version: (.*)$", cited, re.MULTILINE)[1] == VERSION


def test_dates_are_dates():
    for date in dates():
        datetime.date.fromisoformat(date)


def dates():
    """When it was released, as the citation says, and then all dates of the changelog."""
    released = re.search(r"^date-released: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1]
    return [released, *re.findall(r"^## \S+ \((\d.*)\)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)]
