"""Pings as `insonify simulate` leaves them, read back: images, what their pixels mean, and truth.

python examples/11_load_pings.py [FOLDER]
"""

import subprocess
import sys
from pathlib import Path

import numpy as np

from insonify import load_ping, load_pings

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples") / "pings"
words = "simulate tank --sonar gemini-720im --range 8 --set sonar.bins=400 --truth --force"
orbit = ["--orbit", "0 0 -1 2 3 20"]
command = [sys.executable, "-m", "insonify", *words.split(), *orbit, "--out", str(folder)]
subprocess.run(command, check=True)

for posed in load_pings(folder):
    assert posed.pose is not None
    ping, fan = posed.ping, posed.ping.geometry
    cell, beam = np.unravel_index(ping.image.argmax(), ping.image.shape)
    bearing_deg = np.degrees(fan.beam_azimuths_rad[beam])  # positive to port
    print(
        f"{ping.time_s:.1f} s at {np.round(posed.pose.position_m, 2)}: the strongest echo is "
        f"{fan.bin_ranges_m[cell]:.2f} m away, {bearing_deg:+.1f} degrees"
    )

posed, truth = load_ping(folder / "pings" / "0000.npz")
assert truth is not None
for number, name in enumerate(truth.labels):
    shown = truth.label == number
    if shown.any():
        elevation_deg = np.degrees(truth.elevation_rad[shown])
        print(f"{name}: {shown.sum()} pixels, elevation up to {elevation_deg.max():+.1f} degrees")
print(f"{truth.shadow.sum()} pixels lie in shadow")
