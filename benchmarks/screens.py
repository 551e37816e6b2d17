"""Pages as a reader sees them: ``python -m benchmarks.screens FOLDER OUT [PART OF A NAME...]``.

Every page of a folder, as of the docs' site (``make docs``), becomes a picture of all its height at
the width of a desktop and of a phone; what is wider than the screen, or complains, is told.
"""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks.chromium import DESKTOP, PHONE, chromium, errors, resize

SIZES_PX = {"desktop": DESKTOP, "phone": PHONE}
TALLEST_PX = 16_000
"""Of a picture; what lies below is left out."""


def main(words: list[str]) -> int:
    """Photograph the pages; 1 if one is wider than its screen or complains."""
    if len(words) < 2:
        print(__doc__)
        return 2
    folder, out, parts = Path(words[0]).resolve(), Path(words[1]), words[2:]
    out.mkdir(parents=True, exist_ok=True)
    bad = 0
    with chromium(*DESKTOP) as browser:
        for page in sorted(folder.rglob("*.html")):
            name = "-".join(page.relative_to(folder).with_suffix("").parts)
            if name == "404" or (parts and not any(part in name for part in parts)):
                continue
            for screen, size_px in SIZES_PX.items():
                resize(browser, size_px)
                browser.get(page.as_uri())
                size = "const e = document.documentElement; return [e.scrollWidth, e.scrollHeight]"
                wide, tall = browser.execute_script(size)
                log = errors(browser)
                if wide > size_px[0] or log:
                    bad += 1
                    print(f"{name}, {screen}: {wide} px wide; {log}")
                resize(browser, (size_px[0], min(tall, TALLEST_PX)))
                browser.save_screenshot(str(out / f"{name}-{screen}.png"))
    print(f"{len(list(out.glob('*.png')))} pictures in {out}, {bad} pages that do not fit")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
