"""Maps of fixed captures stay the same, to the bit.

A change of what is mapped changes these fingerprints: state it in the commit that renews them. A
refactoring does not.
"""

import json
from pathlib import Path
from typing import Any

import pytest
from sonar_sim import CaptureSettings, load_scenario, write_capture

from mapperd.cli.mapperd import main
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


def test_end_of_the_demo(tmp_path: Path) -> None:
    """Its last pings; all of them take minutes to simulate."""
    scenario = load_scenario("harbour")
    quiet_s = scenario.trajectory.duration_s - 6.0
    write_capture(tmp_path / "capture.bin", scenario, CaptureSettings(quiet_s=quiet_s))
    assert fingerprint(tmp_path / "out", tmp_path / "capture.bin", "--config", DEMO) == (
        26,
        "d91b904e846c2cd2c0b15bdeb10e82131501dae8c6ca93b239ca3b11ba79730a",
    )


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
