"""Maps of fixed captures stay the same, to the bit.

A change of what is mapped changes these fingerprints: state it in the commit that renews them. A
refactoring does not.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.cli.mapperd import main
from tests.mapperd.conftest import make_odometry, make_ping
from tests.mapperd.localization.room import Recorder, dive, events, room, settings, write_room

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "config" / "demo.yaml"
FILTERS = """
crosstalk: {enabled: true, fft_enabled: true}
robot_detection: {enabled: true}
"""


def fingerprint(out: Path, capture: Path, *options: str | Path) -> tuple[int, str]:
    """Map a capture; return the number of mapped pings and the map's `map_sha256`."""
    words = ["--replay", capture, "--out", out, *options]
    assert main([str(word) for word in words]) == 0
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return summary["pings_mapped"], summary["map_sha256"]


def test_three_pings_of_a_real_sonar(shared_data: Path, tmp_path: Path) -> None:
    capture = shared_data / "oculus" / "three_pings_8bit.raw"
    assert fingerprint(tmp_path, capture, "--pose", "0,0,0,0,0,0") == (
        3,
        "e1a9e44af815b52919e308b2905359c48ef0fdbac74b66138cbae5c73746448c",
    )


def test_settings_of_the_demo(tmp_path: Path, write_recording: Recorder) -> None:
    """A wall in speckle, from integers alone: simulated pings differ by the machine's libraries."""
    write_recording(tmp_path / "dive", past_a_wall(pings=26))
    assert fingerprint(tmp_path / "out", tmp_path / "dive", "--config", DEMO) == (
        26,
        "50b4accc839cef20593102bdde93ad6bf9d5d6e28da14cd831c379c1d247666e",
    )


def past_a_wall(pings: int) -> list[tuple[str, bytes, float]]:
    """A vehicle that moves sideways before a wall 4 m away, which is broken by gaps."""
    beams, rows, row_m = 256, 300, 0.02
    bearings_cdeg = np.arange(beams, dtype=np.int16) * 47 - 5992
    rng = np.random.default_rng(7)
    found: list[tuple[str, bytes, float]] = []
    for k in range(pings):
        image = rng.integers(0, 30, (rows, beams), dtype=np.uint8)
        for beam in range(beams):
            if (beam + 4 * k) % 60 < 45:
                off = abs(2 * beam - beams)  # a slanted wall, longer by one row in four beams
                image[200 + off // 8 : 204 + off // 8, beam] = rng.integers(90, 255)
        ping = make_ping(
            k + 1,
            image=image,
            range_m=rows * row_m,
            range_resolution_m=row_m,
            bearings_cdeg=bearings_cdeg,
            start_time=50 + 0.25 * k,
        )
        for dt in (-0.0625, 0.0625):
            record = make_odometry(p=(0.0, k / 16, -k / 64), q=(0.8, 0.0, 0.0, 0.6))
            found.append(("odometry", record, 1 + 0.25 * k + dt))
        found.append(("ping", ping, 1 + 0.25 * k))
    return sorted(found, key=lambda event: event[2])


@pytest.mark.parametrize(
    ("mapping", "filters", "expected"),
    [
        (
            "corrected",
            "",
            (112, "b2903db27a1bb974007bc5589f2b965c8a22e94a6f435f988ce66925b54aa50b"),
        ),
        (
            "corrected",
            FILTERS,
            (114, "49c0eca4b279058bde464dae6fc198e1f1877f33bf36cbfa9784e8ca0c8e2272"),
        ),
        (
            "odometry",
            FILTERS,
            (120, "a7c59ae257b7f6553b08de778e67248f88d2734cd841fbfc182c6a4b22e3883b"),
        ),
    ],
)
def test_dive_on_a_known_map(
    tmp_path: Path, write_recording: Recorder, mapping: str, filters: str, expected: tuple[int, str]
) -> None:
    write_recording(tmp_path / "dive", events(room(), dive()))
    text = settings(write_room(tmp_path), mapping=mapping) + filters
    (tmp_path / "dive.yaml").write_text(text, encoding="utf-8")
    config = tmp_path / "dive.yaml"
    assert fingerprint(tmp_path / "out", tmp_path / "dive", "--config", config) == expected
