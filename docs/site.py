"""What the site has from elsewhere in the repository: the notebooks as tutorials, and the changelog."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
CHANGES = "CHANGELOG.md"


@event_priority(100)  # before the plugin that renders notebooks
def on_files(files: Files, config: Any) -> Files:
    """Adds files from outside of `docs/`."""
    for path in (ROOT / CHANGES, *sorted((ROOT / "notebooks").glob("*.ipynb"))):
        name = path.relative_to(ROOT).as_posix()
        files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lets links of the changelog lead to pages of the site."""
    return markdown.replace("](docs/", "](") if page.file.src_uri == CHANGES else markdown
