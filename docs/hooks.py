"""What mkdocs does besides: pages that are files of the project's root are read from there."""

from pathlib import Path
from typing import Any

ROOT_FILES = {"changelog.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}


def on_page_read_source(page: Any, config: Any) -> str | None:
    """The text of a page that stands elsewhere; what stands in docs/ points a reader there."""
    name = ROOT_FILES.get(page.file.src_uri)
    if name is None:
        return None
    return (Path(config.config_file_path).parent / name).read_text(encoding="utf-8")
