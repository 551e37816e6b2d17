"""How much the view sends and how fast it draws: ``python -m benchmarks.viewing [--browser]``.

A level bottom of so many voxels, of which each ping changes those before the sonar.  Prints what a
ping sends and how long the server takes for it; with ``--browser`` also how many pictures a second
Chromium draws as the camera turns, which says little where it draws by software.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import numpy as np

from benchmarks.chromium import DESKTOP, chromium, missing, resize
from insonify.mapping.voxels import BLOCK, IN_VIEW, VoxelMap
from insonify.types import Array, Box, FanGeometry, Ping, Pose, PosedPing
from insonify.view.layers import draw_cubes
from insonify.view.page import Page
from insonify.view.story import Story

VOXEL_M, PINGS, REACH_M = 0.1, 20, 12.8
FAN = FanGeometry(math.radians(29.0), math.radians(14.0), 96, 513, 0.0, REACH_M)
_FRAMES = """
const done = arguments[arguments.length - 1], canvas = document.querySelector("canvas");
const box = canvas.getBoundingClientRect(), began = performance.now();
const at = (kind, x) => canvas.dispatchEvent(new PointerEvent(kind, {
  clientX: box.left + 300 + x, clientY: box.top + 300, button: 0, buttons: 1, pointerId: 1,
  pointerType: "mouse", bubbles: true }));
let count = 0;
at("pointerdown", 0);
const turn = () => {
  at("pointermove", 3 * ++count);
  if (performance.now() - began < 8000) requestAnimationFrame(turn);
  else { at("pointerup", 3 * count); done(count / 8); }
};
requestAnimationFrame(turn);
"""


def bottom(cubes: int) -> VoxelMap:
    """A level square of so many occupied voxels, at most."""
    across = math.floor(math.sqrt(cubes) / BLOCK)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(across), np.arange(across)))
    voxels = VoxelMap(VOXEL_M)
    slots = voxels.allocate(np.column_stack([x, y, np.full_like(x, -20)]).astype(np.int32))
    level = np.zeros((BLOCK, BLOCK, BLOCK), bool)
    level[:, :, 0] = True
    voxels.log_odds[slots] = np.where(level.ravel(), np.float32(1.0), np.float32(-2.0))
    voxels.seen[slots] = IN_VIEW
    return voxels


def heard(voxels: VoxelMap, pose: Pose) -> None:
    """Change what lies before the sonar, as a ping would."""
    within = np.column_stack(np.unravel_index(np.arange(BLOCK**3), (BLOCK,) * 3))
    centres: Array = (voxels.coords[:, None, :] * BLOCK + within + 0.5) * VOXEL_M
    ahead, aside = centres[..., 0] - pose.x_m, centres[..., 1] - pose.y_m
    seen = (np.hypot(ahead, aside) < REACH_M) & (np.abs(np.arctan2(aside, ahead)) < 0.25)
    voxels.log_odds[seen & (voxels.log_odds > 0.0)] += 0.25


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cubes", type=int, default=300_000)
    parser.add_argument("--browser", action="store_true", help="turn the camera in Chromium too")
    given = parser.parse_args()
    voxels = bottom(given.cubes)
    side_m = float(voxels.coords[:, 0].max() + 1) * BLOCK * VOXEL_M
    region = Box((0.0, 0.0, -20.0), (side_m, side_m, -10.0))
    story = Story("a level bottom")
    page = Page(Story("nothing yet"), port=8400)
    canvas = page._canvas
    steps = []
    for number in range(PINGS):
        pose = Pose(0.2 * side_m + 0.5 * number, side_m / 2, -10.0)
        heard(voxels, pose)
        story.add_ping(PosedPing(Ping(np.full((513, 96), 0.5, np.float32), FAN), pose))
        story.add_map(voxels, region)
        before, started = canvas.sent_bytes, time.perf_counter()
        found = story.maps.at(number + 1)
        assert found is not None
        draw_cubes(canvas, "/occupied/cubes", found[1].occupied)
        steps.append((canvas.sent_bytes - before, time.perf_counter() - started))
        whole = 31 * len(found[1].occupied.index)
    page.close()
    sent, took = np.array(steps[1:]).mean(axis=0)
    print(f"{whole // 31:,} cubes; all of them anew would be {whole / 1e6:.2f} MB a ping")
    print(f"sent a ping: {sent / 1e6:.2f} MB, drawn by the server in {1e3 * took:.0f} ms")
    if given.browser and missing():
        print(missing())
    elif given.browser:
        print(f"pictures a second in a browser: {_turned(story):.1f}")


def _turned(story: Story) -> float:
    """How many pictures a second a browser draws while the camera is turned."""
    page = Page(story, port=8410)
    with chromium(*DESKTOP) as browser:
        resize(browser, DESKTOP)
        browser.set_script_timeout(120)
        browser.get(page.url)
        time.sleep(15.0)
        rate: Any = browser.execute_async_script(_FRAMES)
        browser.get("about:blank")
    page.close()
    return float(rate)


if __name__ == "__main__":
    main()
