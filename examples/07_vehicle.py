"""A vehicle that flies the scans: what its own navigation costs the map.

python examples/07_vehicle.py [FOLDER]
"""

import sys
from pathlib import Path

from insonify import execute, scenario_config
from insonify.report.html import write_report

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples")
folder.mkdir(parents=True, exist_ok=True)

config = scenario_config(
    "tetrapod",
    [
        {"mapping": {"voxel_m": 0.2}, "planner": "uniform", "survey": {"baseline_scans": 2}},
        {
            "vehicle": {
                "name": "bluerov2",
                "navigation": "dvl",
                "current": {"velocity_m_s": [0.05, 0.0, 0.0]},
            }
        },
    ],
)
run = execute(config)

result = run.result()
flown, error = result.vehicle, result.vehicle.pose_error
print(f"{flown.name} flew {result.path_m:.0f} m in {flown.time_s:.0f} s")
print(f"position off by {error['position_mean_m']:.2f} m in the mean")
own = result.metrics["solid"]["exact"]["f1"]
perfect = flown.metrics_at_true_poses["solid"]["exact"]["f1"]
print(f"solid F1 {own:.3f}, and {perfect:.3f} with the same pings at their true poses")
write_report(run.account(), folder / "vehicle.html")
print(f"report: {folder / 'vehicle.html'}")
