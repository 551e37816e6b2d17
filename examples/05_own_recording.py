"""Your own recording: images and poses as NumPy arrays, then a map of them.

python examples/05_own_recording.py [FOLDER]

Here the images are simulated; yours come from your sonar.  docs/recordings.md has the layout, and
the other formats that are read: MCAP and ROS bags, ARIS, Oculus, folders of images.
"""

import sys
from pathlib import Path

import numpy as np

from insonify import Pose, World, map_recordings, open_recording, save_map, scenario_config
from insonify.mapping.mapper import MappingSettings

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples")
folder.mkdir(parents=True, exist_ok=True)

world = World(scenario_config("tetrapod"))
rng = np.random.default_rng(0)
poses = [Pose(x_m, 0.0, -15.0) for x_m in np.linspace(-9.0, -4.0, 30)]
pings = [world.sonar.ping(world.scene, pose, rng) for pose in poses]
fan = pings[0].geometry

np.savez_compressed(
    folder / "dive.npz",
    images=np.stack([np.round(255 * ping.image).astype(np.uint8) for ping in pings]),
    columns="port_to_starboard",
    range_min_m=fan.range_min_m,
    range_max_m=fan.range_max_m,
    azimuth_deg=np.degrees(fan.azimuth_fov_rad),
    elevation_deg=np.degrees(fan.elevation_fov_rad),
    time_s=0.1 * np.arange(len(pings)),
    pose_body=[[p.x_m, p.y_m, p.z_m, p.roll_rad, p.pitch_rad, p.yaw_rad] for p in poses],
    mount=[*fan.mount.position_m, fan.mount.roll_rad, fan.mount.pitch_rad, fan.mount.yaw_rad],
)

recording = open_recording(folder / "dive.npz")
print(f"{recording.format}: {recording.count} pings")
remap = map_recordings([recording], MappingSettings(voxel_m=0.2))
result = remap.result()
print(f"{result.occupied_voxels} occupied voxels along {result.path_m:.1f} m")
save_map(remap.mapper.voxels, folder / "dive.glb")
print(f"surface: {folder / 'dive.glb'}")
