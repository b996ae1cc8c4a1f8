"""Small dives that always go the same way, and surveys of them."""

import json
import sqlite3
from collections.abc import Container
from pathlib import Path
from typing import Any

import numpy as np
from mapper_survey.engine import InProcess
from mapper_survey.folder import Folder
from mapper_survey.request import read_survey
from mapper_survey.running import RunOptions, run_survey

from mapperd.odometry.native import NativeRecord, encode_native
from oculus_driver.encode import encode_ping
from oculus_driver.recording import RecordingWriter

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND
ROWS, BEAMS, RANGE_M = 50, 32, 5.0
SETTINGS = {
    "octree": {"voxel_resolution": 0.1},
    "mounting": {"orientation": {"pitch": 35.0}},
    "filtering": {"min_range": 0.3},
}
MEMORY = 1 << 30


def ping_of(number: int, dive: int) -> bytes:
    """Noise, and a seabed that is not flat."""
    random = np.random.default_rng([31, dive, number])
    image = random.integers(0, 30, (ROWS, BEAMS)).astype(np.uint8)
    seabed = 32 + 6 * np.sin(0.3 * number + np.linspace(0, 3, BEAMS))
    rows = np.arange(ROWS)[:, None]
    image[(rows >= seabed) & (rows < seabed + 3)] = 190
    return encode_ping(
        ping_id=number + 1,
        mode=1,
        frequency_hz=750e3,
        range_m=RANGE_M,
        gain_percent=50.0,
        speed_of_sound_mps=1500.0,
        salinity_ppt=35.0,
        start_time=0.2 * number,
        range_resolution_m=RANGE_M / ROWS,
        bearings_cdeg=np.linspace(-4000, 4000, BEAMS).round().astype(np.int16),
        image=image,
        source_id=7,
    )


def odometry_of(x: float, y: float, yaw: float) -> bytes:
    return encode_native(
        NativeRecord(
            v=1,
            clk="arrival",
            w="enu",
            b="flu",
            p=(x, y, -3.0),
            q=(float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))),
        )
    )


def write_dive(
    path: Path,
    dive: int,
    *,
    pings: int = 30,
    begin_s: float = 0.0,
    y: float = 0.0,
    never: Container[int] = (),
    synced: int = 0,
) -> list[int]:
    """A vehicle that goes along x, a metre between two pings; returns the sizes after each.

    Pings of some numbers never come. The file is synced after every `synced` pings; damage costs
    what lies between two syncs.
    """
    sizes = []
    path.parent.mkdir(parents=True, exist_ok=True)
    with RecordingWriter(path, overwrite=True) as writer:
        sonar = writer.add_link("sonar", "oculus")
        vehicle = writer.add_link("vehicle", "odometry-native")
        for k in range(pings + 1):
            t_ns = START_NS + round((begin_s + 0.2 * k) * SECOND)
            writer.write(vehicle, odometry_of(1.0 * k, y, 0.05 * k), t_ns)
            if k < pings and k not in never:
                writer.write(sonar, ping_of(k, dive), t_ns + SECOND // 10)
            if synced and k % synced == 0:
                writer.sync()
            sizes.append(writer.size_bytes)
    return sizes


def write_survey(folder: Path, **changes: Any) -> Path:
    """Two dives across each other, at the same time; returns `survey.yaml`."""
    write_dive(folder / "a.mcap", 1)
    write_dive(folder / "b.mcap", 2, begin_s=1.03, y=4.0)
    reported: dict[str, Any] = {
        "settings": SETTINGS,
        "dives": [
            {"name": "a", "recording": "a.mcap"},
            {
                "name": "b",
                "recording": "b.mcap",
                "transform": {"x": 14.0, "y": -9.0, "z": 0.3, "yaw_deg": 70.0},
            },
        ],
    }
    path = folder / "survey.yaml"
    path.write_text(json.dumps(reported | changes), encoding="utf-8")  # YAML takes JSON
    return path


class Silent:
    """Takes the progress."""

    def isatty(self) -> bool:
        return False

    def write(self, text: str) -> int:
        return len(text)

    def flush(self) -> None: ...


def run_here(survey: Path, out: Path, *, by_dive: bool = False) -> dict[str, Any]:
    """The survey in this process."""
    options = RunOptions(MEMORY, by_dive=by_dive)
    return run_survey(read_survey(survey), Folder(str(out)), InProcess(), options, Silent())  # type: ignore[arg-type]


def rows_in(path: Path) -> list[tuple[Any, ...]]:
    """Bricks of a map's file, with revisions, to the bit."""
    connection = sqlite3.connect(path)
    found = connection.execute("SELECT * FROM brick ORDER BY x, y, z").fetchall()
    connection.close()
    return found


def revision_of(path: Path) -> int:
    connection = sqlite3.connect(path)
    (revision,) = connection.execute("SELECT revision FROM progress").fetchone()
    connection.close()
    return int(revision)
