"""A BlueROV2 with config/bluerov2.yaml, simulated: without its DVL, and with a copied token."""

import tempfile
from pathlib import Path

import pytest

from tests.support.shell_blocks import Block, Reader, own_network

pytestmark = [pytest.mark.net, pytest.mark.slow, pytest.mark.timeout(900)]

ROOT = Path(__file__).resolve().parents[3]
AUTOPILOT = "--odometry mavlink-attitude@udp:127.0.0.1:52210"


def test_without_a_dvl_depth_and_heading_are_shown_and_what_is_missing(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink", reason="the extra `mavlink` is not installed")
    with tempfile.TemporaryDirectory() as runtime, own_network() as network:
        if not network:
            pytest.skip("no network of its own: a sonar's ports exist once")
        reader = Reader(tmp_path, Path(runtime), network)
        sonar = Block(f"sonar-sim serve harbour {AUTOPILOT}", ready="oculus discover --first")
        words = f"--config {ROOT}/config/bluerov2.yaml --out out"
        daemon = Block(f"mapperd {words}", ready="mapperctl status --once | grep -q depth")
        with reader.background(sonar), reader.background(daemon):
            waited = reader.run(
                "until mapperctl status --once | grep -q DVL; do sleep 1; done; "
                "mapperctl status --once"
            )
    lines = waited.stdout.splitlines()
    missing = "! the odometry has neither horizontal position nor velocity"
    assert any(line.startswith(missing) for line in lines), lines
    assert any(line.startswith("mapperd") and "not mapping" in line for line in lines), lines
    (vehicle,) = (line for line in lines if line.startswith("vehicle"))
    assert "depth" in vehicle
    assert "heading" in vehicle
