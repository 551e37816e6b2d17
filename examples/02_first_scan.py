"""A first scan: map, find what is uncertain, scan there, until it no longer pays.

python examples/02_first_scan.py [FOLDER]
"""

import sys
from pathlib import Path

from insonify import execute, save_map, scenario_config
from insonify.report.html import write_report

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples")
folder.mkdir(parents=True, exist_ok=True)

config = scenario_config("tetrapod", [{"mapping": {"voxel_m": 0.2}}])  # coarse, to be quick
run = execute(config)

for entry in run.history:
    scores = entry.metrics["solid"]["exact"]
    print(f"scan {entry.scan}: {entry.total_entropy_bits:.0f} bits left, F1 {scores['f1']:.3f}")
print(run.stop_reason.sentence)
save_map(run.mapper.voxels, folder / "first-scan.bt")  # for OctoMap; the suffix names the format
write_report(run.account(), folder / "first-scan.html")
print(f"report: {folder / 'first-scan.html'}")
