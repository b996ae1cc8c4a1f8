import dataclasses
import hashlib
import itertools
from pathlib import Path

import msgpack
import numpy as np
import pytest
from sonar_sim import (
    CaptureSettings,
    Scenario,
    SonarSettings,
    Trajectory,
    Waypoint,
    load_scenario,
    write_capture,
)
from sonar_sim.capture import EPOCH_NS, POWER_UP_S

from oculus_driver.encode import bearing_table_cdeg
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, Chunk, open_recording
from oculus_driver.stream import StreamParser

SONAR = SonarSettings(demanded_range_m=5.0, beams=256)
PATH = Trajectory([Waypoint(-1.0, -3.0, -2.6, 90.0), Waypoint(-1.0, -2.0, -2.6, 100.0)])
SCENARIO = Scenario("a leg", load_scenario("harbour").scene, SONAR, PATH)
SETTINGS = CaptureSettings(seed=11, processes=1)


def capture(folder: Path, settings: CaptureSettings) -> Path:
    path = folder / f"{settings.seed}-{settings.processes}.bin"
    seen = write_capture(path, SCENARIO, settings)
    assert len(seen.points_m) > 1000
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return capture(tmp_path_factory.mktemp("capture"), SETTINGS)


@pytest.fixture(scope="module")
def chunks(recorded: Path) -> list[Chunk]:
    with open_recording(recorded) as recording:
        return list(recording)


@pytest.fixture(scope="module")
def pings(chunks: list[Chunk]) -> list[Ping]:
    parser = StreamParser()
    sonar = (chunk for chunk in chunks if chunk.encoding == OCULUS)
    messages = [m for chunk in sonar for m in parser.feed(chunk.data, chunk.arrival_ns)]
    messages += parser.finish()
    assert parser.counters.bytes_rejected == 0
    decoded = [decode_ping(message) for message in messages]
    assert all(isinstance(ping, Ping) for ping in decoded)
    return [ping for ping in decoded if isinstance(ping, Ping)]


@pytest.mark.slow
def test_every_ping_parses_back(pings: list[Ping]) -> None:
    assert [ping.ping_id for ping in pings] == list(range(len(pings)))
    assert len(pings) == 4
    first = pings[0]
    assert first.version == 2
    assert first.image.shape == (SONAR.rows, SONAR.beams)
    assert first.range_resolution_m == SONAR.range_resolution_m
    assert first.image.max() > 100
    assert not first.warnings


def test_bearings_are_uniform_in_sine(pings: list[Ping]) -> None:
    table_deg = np.degrees(pings[0].bearings_rad)
    law = np.degrees(np.arcsin(np.sin(np.radians(65.0)) * np.linspace(-1.0, 1.0, SONAR.beams)))
    assert np.abs(table_deg - law).max() <= 0.0101
    full = bearing_table_cdeg(512, np.radians(65.0)) / 100.0
    assert full[[0, 1, 255, 256]].tolist() == [-65.0, -64.52, -0.1, 0.1]


def test_reads_are_of_many_sizes_and_in_order(chunks: list[Chunk]) -> None:
    stamps = [chunk.arrival_ns or 0 for chunk in chunks]
    assert stamps == sorted(stamps)
    sizes = [len(chunk.data) for chunk in chunks if chunk.encoding == OCULUS]
    assert len(set(sizes)) > 5
    assert max(sizes) <= 65536


def test_ping_arrives_after_its_last_echo(pings: list[Ping]) -> None:
    for ping in pings:
        assert ping.start_time_s is not None
        assert ping.arrival_ns is not None
        transmit_ns = EPOCH_NS + round((ping.start_time_s - POWER_UP_S) * 1e9)
        listening_ns = 2e9 * ping.max_range_m / ping.speed_of_sound_mps
        delay_ns = ping.arrival_ns - transmit_ns - listening_ns
        assert 3e6 <= delay_ns < 20e6


def test_odometry_is_the_path_and_encloses_the_pings(
    chunks: list[Chunk], pings: list[Ping]
) -> None:
    records = [msgpack.unpackb(c.data) for c in chunks if c.encoding == ODOMETRY_NATIVE]
    assert {(r["v"], r["clk"], r["w"], r["b"], r["rst"]) for r in records} == {
        (1, "unix", "enu", "flu", 0)
    }
    stamps = [record["t"] for record in records]
    assert all(b > a for a, b in itertools.pairwise(stamps))
    first_ns, last_ns = pings[0].arrival_ns, pings[-1].arrival_ns
    assert first_ns is not None
    assert last_ns is not None
    assert stamps[0] < first_ns
    assert last_ns < stamps[-1]
    for record in records:
        truth = PATH.pose((record["t"] - EPOCH_NS) / 1e9)
        assert record["p"] == pytest.approx(truth.position_m, abs=0.03)
        assert abs(np.dot(record["q"], truth.quaternion)) > 0.9999
        assert len(record["u"]) == len(record["r"]) == 3


@pytest.mark.slow
def test_equal_seeds_give_equal_files_whatever_the_processes(
    recorded: Path, tmp_path: Path
) -> None:
    two = capture(tmp_path, dataclasses.replace(SETTINGS, processes=2))
    assert _digest(two) == _digest(recorded)
    other = capture(tmp_path, dataclasses.replace(SETTINGS, seed=12))
    assert _digest(other) != _digest(recorded)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
