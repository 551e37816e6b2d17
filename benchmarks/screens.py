"""Pages as a reader sees them: ``python -m benchmarks.screens FOLDER OUT [PART OF A NAME...]``.

Every page of a folder, as of the docs' site (``make docs``), becomes a picture of all its height at
the width of a desktop and of a phone; what is wider than the screen, or complains, is told.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from benchmarks.chromium import chromium

WIDTHS_PX = {"desktop": 1280, "phone": 390}
HEIGHT_PX = 900
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
    with chromium(WIDTHS_PX["desktop"], HEIGHT_PX) as browser:
        for page in sorted(folder.rglob("*.html")):
            name = "-".join(page.relative_to(folder).with_suffix("").parts)
            if name == "404" or (parts and not any(part in name for part in parts)):
                continue
            for screen, width in WIDTHS_PX.items():
                _resize(browser, width, HEIGHT_PX)
                browser.get(page.as_uri())
                size = "const e = document.documentElement; return [e.scrollWidth, e.scrollHeight]"
                wide, tall = browser.execute_script(size)
                log = [row for row in browser.get_log("browser") if row["level"] == "SEVERE"]
                if wide > width or log:
                    bad += 1
                    print(f"{name}, {screen}: {wide} px wide; {[row['message'] for row in log]}")
                _resize(browser, width, min(tall, TALLEST_PX))
                browser.save_screenshot(str(out / f"{name}-{screen}.png"))
    print(f"{len(list(out.glob('*.png')))} pictures in {out}, {bad} pages that do not fit")
    return int(bad > 0)


def _resize(browser: Any, width: int, height: int) -> None:
    screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
