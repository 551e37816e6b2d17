"""The pictures in the README and docs: ``python -m benchmarks.pictures``."""

from __future__ import annotations

from pathlib import Path

from insonify.report.fans import draw_fan
from insonify.report.pictures import draw_decision, draw_slices
from insonify.runs import execute
from insonify.scenarios import scenario_config

FOLDER = Path("docs/images")


def main() -> None:
    """Scan the wreck and draw its first decision, a ping and the map."""
    run = execute(scenario_config("wreck"))
    _, _, ping = run.keyframes[3]
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "wreck-decision.png").write_bytes(draw_decision(run, run.snapshots[0], 1))
    (FOLDER / "wreck-ping.png").write_bytes(draw_fan(ping, "wreck, scan 2"))
    (FOLDER / "wreck-map.png").write_bytes(draw_slices(run))


if __name__ == "__main__":
    main()
