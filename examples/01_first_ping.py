"""A first ping: what a forward-looking sonar sees of a tetrapod, in fan view.

python examples/01_first_ping.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

from insonify import Pose, World, scenario_config
from insonify.report.fans import draw_fan

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples")
folder.mkdir(parents=True, exist_ok=True)

world = World(scenario_config("tetrapod"))
pose = Pose(x_m=-8.0, y_m=0.0, z_m=-15.0)  # east, north, up; heading east
ping = world.sonar.ping(world.scene, pose, np.random.default_rng(0))
truth = world.sonar.truth(world.scene, pose)

bins, beams = ping.image.shape
shows = truth.label == world.scene.labels.index("tetrapod")
nearest_m = ping.geometry.bin_ranges_m[np.flatnonzero(shows.any(axis=1))[0]]
print(f"{bins} range bins x {beams} beams, the tetrapod from {nearest_m:.2f} m on")
(folder / "first-ping.png").write_bytes(draw_fan(ping, "a tetrapod, from 8 m west"))
print(f"picture: {folder / 'first-ping.png'}")
