"""What the site has from elsewhere in the repository: notebooks as tutorials, the changelog, and scripts in pages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
CHANGES = "CHANGELOG.md"
SCRIPT = re.compile(r"^\[(\w+\.py)\]\(\1\)$", re.MULTILINE)
"""A line that is nothing but a link to a script beside the page."""


@event_priority(100)  # before the plugin that renders notebooks
def on_files(files: Files, config: Any) -> Files:
    """Adds files from outside of `docs/`."""
    for path in (ROOT / CHANGES, *sorted((ROOT / "notebooks").glob("*.ipynb"))):
        name = path.relative_to(ROOT).as_posix()
        files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lets links of the changelog lead to pages of the site, and shows scripts where pages link to them."""
    folder = Path(page.file.abs_src_path).parent

    def shown(link: re.Match[str]) -> str:
        return f'```python title="{link[1]}"\n{(folder / link[1]).read_text()}```'

    markdown = SCRIPT.sub(shown, markdown)
    return markdown.replace("](docs/", "](") if page.file.src_uri == CHANGES else markdown
