"""The blocks of the docs' pages, and the examples written into them: python -m benchmarks.pages."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SHOWN = re.compile(r"<!-- example: (examples/[\w.]+) -->\n```python\n(.*?)^```$", re.M | re.S)


def pages() -> list[Path]:
    """What people read: the README and every page of the docs."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def shown(name: str) -> str:
    """An example from its first import on, without the words for those who run the file."""
    lines = (ROOT / name).read_text("utf-8").splitlines(keepends=True)
    first = next(k for k, line in enumerate(lines) if line.startswith(("import ", "from ")))
    return "".join(lines[first:])


def with_examples(text: str) -> str:
    """A page with each example that it shows as the file has it."""
    return SHOWN.sub(lambda m: f"<!-- example: {m[1]} -->\n```python\n{shown(m[1])}```", text)


def main() -> int:
    """Write the examples into the pages that show them."""
    for page in pages():
        before = page.read_text("utf-8")
        after = with_examples(before)
        if after != before:
            page.write_text(after, "utf-8")
            print(f"{page.relative_to(ROOT)}: examples written anew")
    return 0


if __name__ == "__main__":
    sys.exit(main())
