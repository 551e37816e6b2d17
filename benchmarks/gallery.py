"""The pictures of docs/gallery.md, by its own commands: ``python -m benchmarks.gallery``."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from benchmarks.pages import ROOT, blocks

PAGE = ROOT / "docs/gallery.md"
WIDEST_PX = 1200
QUALITY = 80


def pictures() -> dict[str, str]:
    """What a command leaves, by the image of the page that it becomes."""
    pairs = [words.split(" = ") for block in blocks(PAGE) for words in block.marked("picture")]
    return {image: left for left, image in pairs}


def main() -> int:
    """Run the page's commands in a folder of their own and take their pictures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for block in blocks(PAGE):
            for file in block.marked("file"):
                (folder / file).write_text(block.text, "utf-8")
            for command in block.commands():
                print(command.text, flush=True)
                words = [sys.executable, "-m", *command.words]
                subprocess.run(words, cwd=folder, check=True, capture_output=True)
        for image, left in pictures().items():
            target = PAGE.parent / image
            target.parent.mkdir(parents=True, exist_ok=True)
            with Image.open(folder / left) as picture:
                shown = picture.convert("RGB")
                shown.thumbnail((WIDEST_PX, WIDEST_PX))
                shown.save(target, quality=QUALITY, method=6)
            print(f"{target.relative_to(ROOT)}: {target.stat().st_size / 1024:.0f} KiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
