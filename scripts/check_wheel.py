#!/usr/bin/env python3
"""Check an installation: import its packages, map one ping with `mapperd`.

Run it with the Python of the installation, outside of the checkout.
"""

import importlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from oculus_driver.encode import encode_ping

for name in ("mapperd._core", "oculus_driver", "sonar_sim", "mapper_survey"):
    importlib.import_module(name)

image = np.zeros((100, 64), np.uint8)
image[60:62] = 255  # a wall 6 m ahead
ping = encode_ping(
    ping_id=1,
    mode=1,
    frequency_hz=750e3,
    range_m=10.0,
    gain_percent=50.0,
    speed_of_sound_mps=1500.0,
    salinity_ppt=35.0,
    start_time=1.0,
    range_resolution_m=0.1,
    bearings_cdeg=np.linspace(-6000, 6000, 64).astype(np.int16),
    image=image,
)
with tempfile.TemporaryDirectory() as folder:
    recording, out = Path(folder, "ping.raw"), Path(folder, "map")
    recording.write_bytes(ping)
    words = ["--replay", str(recording), "--pose", "0,0,0,0,0,0", "--out", str(out)]
    subprocess.run([sys.executable, "-m", "mapperd", *words], check=True)  # noqa: S603 our own words
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
if summary["pings_mapped"] != 1 or not summary["voxels_occupied"]:
    sys.exit(f"the ping is not in the map: {summary}")
print("one ping mapped:", summary["voxels_occupied"], "occupied voxels")
