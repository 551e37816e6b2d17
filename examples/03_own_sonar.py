"""Your own sonar: a device by its data sheet, pinging beside one that is known by name.

python examples/03_own_sonar.py [FOLDER]
"""

import sys
from pathlib import Path

from insonify import Pose, Sonar, World, scenario_config
from insonify.report.fans import draw_fan
from insonify.sonar.devices import SonarDevice, named_device

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples")
folder.mkdir(parents=True, exist_ok=True)

mine = SonarDevice(
    name="my sonar",
    azimuth_fov_deg=70.0,
    elevation_fov_deg=12.0,
    beams=128,
    bins=600,
    range_min_m=0.5,
    range_max_m=12.0,
    tilt_deg=30.0,
    frequency_khz=900.0,
)
scene = World(scenario_config("tetrapod")).scene
for device in (mine, named_device("oculus-m750d-1200khz")):  # `insonify sonars` lists the names
    ping = Sonar(device).ping(scene, Pose(-6.0, 0.0, -16.0))
    resolution_deg = device.azimuth_fov_deg / device.beams
    print(
        f"{device.name}: {resolution_deg:.2f} degrees a beam, "
        f"{100 * ping.geometry.bin_m:.1f} cm a bin, mean intensity {ping.image.mean():.3f}"
    )
    file = folder / f"own-sonar-{device.name.replace(' ', '-')}.png"
    file.write_bytes(draw_fan(ping, device.name))
    print(f"picture: {file}")
