"""What mkdocs does besides: some pages are files of the root, and guides are found before names."""

from pathlib import Path
from typing import Any

ROOT_FILES = {"changelog.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
REFERENCE_BOOST = 1e-3
"""A word in a title counts a thousand times one in a text."""


def on_page_read_source(page: Any, config: Any) -> str | None:
    """The text of a page that stands elsewhere; what stands in docs/ points a reader there."""
    name = ROOT_FILES.get(page.file.src_uri)
    if name is None:
        return None
    return (Path(config.config_file_path).parent / name).read_text(encoding="utf-8")


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> None:
    """A search finds what explains before what lists."""
    if page.file.src_uri.startswith("reference/"):
        page.meta.setdefault("search", {"boost": REFERENCE_BOOST})
