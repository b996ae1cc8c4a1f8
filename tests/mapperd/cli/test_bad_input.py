"""Whatever is given to the command: one clear line or a counted drop, never a traceback."""

import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.cli.mapperd import main
from mapperd.export.clouds import VERTEX
from oculus_driver.command_line import ExitCode

Write = Callable[..., list[int]]
Survey = Callable[..., list[Any]]
PingBytes = Callable[..., bytes]
OdometryBytes = Callable[..., bytes]

Run = Callable[..., Any]

STILL = "--pose=0,0,0,0,0,0"


def assert_finite(folder: Path) -> None:
    """No NaN in the map that came out."""
    _, _, body = (folder / "map.ply").read_bytes().partition(b"end_header\n")
    points = np.frombuffer(body, dtype=VERTEX)
    for name in ("x", "y", "z", "probability"):
        assert np.isfinite(points[name]).all()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (bytes(100_000), "zeros"),
        (b"dear diary\n" * 5000, "text file"),
        (bytes(range(256)) * 500, ""),
        (b"\x89MCAP0\r\n", ""),
        (b"\x89MCAP0\r\n" + bytes(50_000), ""),
        (b"\x89MCAP0\r\n" + b"\xff" * 50_000, ""),
        (b"SO", ""),
    ],
    ids=["empty", "zeros", "text", "ramp", "only magic", "mcap zeros", "mcap ones", "two bytes"],
)
@pytest.mark.parametrize("pose", [[], [STILL]], ids=["odometry", "pose"])
def test_file_that_is_no_recording(
    tmp_path: Path, run: Run, content: bytes, words: str, pose: list[str]
) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    ran = run(path, *pose)
    assert ran.code == ExitCode.BAD_DATA
    assert words in ran.output
    assert ran.output.startswith("mapperd: ")
    assert str(path) in ran.output
    assert ran.output.count("\n") == 1, ran.output


@pytest.mark.parametrize("pose", [[], [STILL]], ids=["odometry", "pose"])
def test_path_that_is_no_file(tmp_path: Path, run: Run, pose: list[str]) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.db3").touch()
    for path, words in (
        (tmp_path / "bag", "only a ROS bag"),
        (tmp_path, "folder"),
        (tmp_path / "nothing", "no such file"),
        (tmp_path / "pipe", "not a file"),
        (Path("/dev/null"), "not a file"),
    ):
        ran = run(path, *pose)
        assert ran.code == ExitCode.NO_INPUT
        assert words in ran.output
        assert ran.output.count("\n") == 1


@pytest.mark.usefixtures("no_picture")
def test_recording_cut_anywhere_maps_every_ping_before_the_cut(
    tmp_path: Path, run: Run, write_recording: Write, survey: Survey
) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    events = survey(4)
    sizes = write_recording(whole, events)
    data = whole.read_bytes()
    ends = [size for size, (kind, _, _) in zip(sizes, events, strict=True) if kind == "ping"]
    first_odometry_end = sizes[0]
    near_ends = [end + step for end in sizes for step in (-1, 0, 1)]
    for size in sorted({*range(0, len(data), 1499), *near_ends, len(data) - 1, len(data)}):
        cut.write_bytes(data[:size])
        ran = run(cut)
        assert "Traceback" not in ran.output
        expected = sum(end <= size for end in ends)
        if expected:
            assert ran.code == ExitCode.OK, (size, ran.output)
            assert ran.summary["pings_mapped"] == expected, size
            assert_finite(ran.out)
        elif size >= first_odometry_end:
            assert ran.code == ExitCode.BAD_DATA, (size, ran.output)
        else:
            assert ran.code in (ExitCode.BAD_DATA, ExitCode.USAGE), (size, ran.output)
            assert ran.output.count("\n") == 1


@pytest.mark.usefixtures("no_picture")
@pytest.mark.slow
def test_recording_damaged_anywhere_never_ends_in_a_traceback(
    tmp_path: Path, run: Run, write_recording: Write, survey: Survey
) -> None:
    whole, damaged = tmp_path / "whole", tmp_path / "damaged"
    write_recording(whole, survey(2))
    data = whole.read_bytes()
    rng = np.random.default_rng(7)
    for place in [*range(0, 400, 13), *rng.integers(0, len(data), 40)]:
        changed = bytearray(data)
        changed[int(place)] ^= int(rng.integers(1, 256))
        damaged.write_bytes(changed)
        ran = run(damaged)
        assert ran.code in (ExitCode.OK, ExitCode.BAD_DATA, ExitCode.USAGE), ran.output
        assert "Traceback" not in ran.output
        if ran.code == ExitCode.OK:
            assert_finite(ran.out)


def test_ping_that_claims_4_gb_costs_only_its_bytes(
    tmp_path: Path, run: Run, ping_bytes: PingBytes
) -> None:
    liar = bytearray(ping_bytes(2))
    struct.pack_into("<I", liar, 10, 0xFFFFFFFF)
    path = tmp_path / "raw"
    path.write_bytes(ping_bytes(1) + bytes(liar) + ping_bytes(3))
    ran = run(path, STILL)
    assert ran.code == ExitCode.OK
    assert ran.summary["pings_mapped"] == 2
    assert ran.summary["bytes_rejected"] == len(liar)


def test_image_that_claims_4_gb_is_a_counted_drop(
    tmp_path: Path, run: Run, ping_bytes: PingBytes
) -> None:
    good = ping_bytes(2)
    place = good.index(struct.pack("<I", 50 * 65))  # the image size in the body
    liar = good[:place] + b"\xff\xff\xff\xff" + good[place + 4 :]
    path = tmp_path / "raw"
    path.write_bytes(ping_bytes(1) + liar + ping_bytes(3))
    ran = run(path, STILL)
    assert ran.code == ExitCode.OK
    assert ran.summary["pings_mapped"] == 2
    lost = ran.summary["pings_total"] - 2 + ran.summary["bytes_rejected"]
    assert lost > 0


def test_image_as_deep_as_no_sonar_sees_is_a_counted_drop(
    tmp_path: Path, run: Run, ping_bytes: PingBytes
) -> None:
    path = tmp_path / "raw"
    path.write_bytes(ping_bytes(1) + ping_bytes(2, range_resolution_m=19.9))
    ran = run(path, STILL)
    assert ran.code == ExitCode.OK
    assert ran.summary["pings_dropped"] == {"fan_too_large": 1}


def test_bad_odometry_is_counted_and_never_reaches_the_map(
    tmp_path: Path,
    run: Run,
    write_recording: Write,
    ping_bytes: PingBytes,
    odometry_bytes: OdometryBytes,
) -> None:
    nan = float("nan")
    bad = {
        "zero_quaternion": odometry_bytes(q=(0.0, 0.0, 0.0, 0.0)),
        "not_finite": odometry_bytes(q=(nan, 0.0, 0.0, 1.0)),
        "unnormalised_quaternion": odometry_bytes(q=(3.0, 0.0, 0.0, 0.0)),
        "out_of_range": odometry_bytes(p=(1e300, 0.0, 0.0)),
        "not_msgpack": b"\xc1\xc1",
        "no_pose": odometry_bytes(p=None, q=None),
    }
    events = [("odometry", odometry_bytes(), 0.0)]
    for k, data in enumerate(bad.values()):
        events += [("odometry", data, 0.1 * k + 0.01), ("ping", ping_bytes(k + 1), 0.1 * k + 0.05)]
        events.append(("odometry", odometry_bytes(), 0.1 * k + 0.1))
    events.append(("odometry", odometry_bytes(), 0.2))  # back in time
    path = tmp_path / "a"
    write_recording(path, events)
    ran = run(path)
    assert ran.code == ExitCode.OK
    summary = ran.summary
    assert summary["pings_mapped"] == summary["pings_total"] == len(bad)
    assert summary["poses"]["odometry_rejected"] == dict.fromkeys([*bad, "back_in_time"], 1)
    received = summary["poses"]["odometry_received"]
    assert received == summary["poses"]["odometry_accepted"] + len(bad) + 1
    assert_finite(ran.out)


def test_recording_whose_odometry_is_all_bad_reports_the_reason(
    tmp_path: Path,
    run: Run,
    write_recording: Write,
    ping_bytes: PingBytes,
    odometry_bytes: OdometryBytes,
) -> None:
    path = tmp_path / "a"
    zero = odometry_bytes(q=(0.0, 0.0, 0.0, 0.0))
    write_recording(path, [("odometry", zero, 0.0), ("ping", ping_bytes(1), 0.05)])
    ran = run(path)
    assert ran.code == ExitCode.BAD_DATA
    assert "no_odometry 1" in ran.output
    assert ran.summary["poses"]["odometry_rejected"] == {"zero_quaternion": 1}


def test_recording_without_a_ping_names_the_bytes(
    tmp_path: Path, run: Run, write_recording: Write, odometry_bytes: OdometryBytes
) -> None:
    path = tmp_path / "a"
    write_recording(path, [("odometry", odometry_bytes(), 0.0), ("ping", b"x" * 1234, 0.1)])
    ran = run(path)
    assert ran.code == ExitCode.BAD_DATA
    assert "1234 of 1234 bytes" in ran.output
    assert ran.summary["pings_total"] == 0
    assert ran.summary["bytes_rejected"] == 1234


def test_recording_without_odometry_is_refused_without_a_pose(
    tmp_path: Path, run: Run, write_recording: Write, ping_bytes: PingBytes
) -> None:
    path = tmp_path / "a"
    write_recording(path, [("ping", ping_bytes(1), 0.0)])
    ran = run(path)
    assert ran.code == ExitCode.USAGE
    assert "no odometry" in ran.output
    assert not ran.out.exists()
    assert run(path, STILL).code == ExitCode.OK


@pytest.mark.parametrize("more", [["--start", "1"], ["--duration", "1"]])
def test_part_of_a_recording_without_stamps_is_refused(
    tmp_path: Path, run: Run, ping_bytes: PingBytes, more: list[str]
) -> None:
    path = tmp_path / "raw"
    path.write_bytes(ping_bytes(1))
    ran = run(path, STILL, *more)
    assert ran.code == ExitCode.USAGE
    assert "no time stamps" in ran.output
    assert ran.output.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("octree: {voxel_resolution: -1}", "$.octree.voxel_resolution: -1 is not allowed"),
        ("octree: {voxel_resolution: [1]}", "$.octree.voxel_resolution"),
        ("octree: {voxel: 1}", "$.octree.voxel: there is no such setting"),
        ("octree: {voxel_resolution: .nan}", "$.octree.voxel_resolution: .nan"),
        ("a: &a [*a]", "aliases"),
        ("[" * 10_000, "nested"),
        ("a: 1\na: 1", "set twice"),
    ],
)
def test_bad_settings_are_one_line_and_exit_78(
    tmp_path: Path, run: Run, ping_bytes: PingBytes, text: str, words: str
) -> None:
    recording, config = tmp_path / "raw", tmp_path / "bad.yaml"
    recording.write_bytes(ping_bytes(1))
    config.write_text(text, encoding="utf-8")
    ran = run(recording, STILL, config=config)
    assert ran.code == 78
    assert words in ran.output
    assert str(config) in ran.output
    assert ran.output.count("\n") == 1
    assert not ran.out.exists()


def test_missing_settings_file_is_exit_78(tmp_path: Path, run: Run, ping_bytes: PingBytes) -> None:
    (tmp_path / "raw").write_bytes(ping_bytes(1))
    ran = run(tmp_path / "raw", STILL, config=tmp_path / "none.yaml")
    assert ran.code == ExitCode.BAD_CONFIG
    assert ran.output.count("\n") == 1


def test_results_that_cannot_be_written_are_exit_73(
    tmp_path: Path, ping_bytes: PingBytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "raw").write_bytes(ping_bytes(1))
    (tmp_path / "file").touch()
    words = ["--replay", str(tmp_path / "raw"), STILL, "--out", str(tmp_path / "file")]
    assert main(words) == ExitCode.CANNOT_WRITE
    assert capsys.readouterr().err.count("\n") == 1


def test_map_beyond_octomap_keeps_its_other_files(
    tmp_path: Path,
    run: Run,
    write_recording: Write,
    ping_bytes: PingBytes,
    odometry_bytes: OdometryBytes,
) -> None:
    far = odometry_bytes(p=(1e6, 0.0, 0.0))
    track = [("odometry", far, 0.0), ("ping", ping_bytes(1), 0.05), ("odometry", far, 0.1)]
    write_recording(tmp_path / "a", track)
    ran = run(tmp_path / "a")
    assert ran.code == ExitCode.CANNOT_WRITE
    assert "map.bt" in ran.output
    assert ran.summary["pings_mapped"] == 1
    assert_finite(ran.out)
    assert not (ran.out / "map.bt").exists()


@pytest.mark.parametrize(
    ("pose", "code"),
    [
        ("1000000,0,0,0,0,0", ExitCode.USAGE),
        ("0,0,-6550,0,0,0", ExitCode.USAGE),  # the reach is 6553.6 m, the range 5 m
        ("0,0,-6540,0,0,0", ExitCode.OK),
    ],
)
def test_pose_beyond_octomap_is_refused_at_once(
    tmp_path: Path, run: Run, ping_bytes: PingBytes, pose: str, code: int
) -> None:
    (tmp_path / "raw").write_bytes(ping_bytes(1))
    ran = run(tmp_path / "raw", f"--pose={pose}")
    assert ran.code == code, ran.output
    assert ran.out.exists() == (code == ExitCode.OK)
    assert ("reach of map.bt" in ran.output) == (code == ExitCode.USAGE)


def test_part_without_a_ping_is_reported(
    tmp_path: Path, run: Run, write_recording: Write, survey: Survey
) -> None:
    write_recording(tmp_path / "a", survey(3))
    ran = run(tmp_path / "a", "--start", "100")
    assert ran.code == ExitCode.BAD_DATA
    assert ran.summary["pings_outside"] == 3


@pytest.mark.parametrize("pose", [[], [STILL]], ids=["odometry", "pose"])
def test_recording_without_a_sonar_is_refused_at_once(
    tmp_path: Path,
    run: Run,
    write_recording: Write,
    odometry_bytes: OdometryBytes,
    pose: list[str],
) -> None:
    write_recording(tmp_path / "a", [("odometry", odometry_bytes(), 0.1 * k) for k in range(5)])
    ran = run(tmp_path / "a", *pose)
    assert ran.code == ExitCode.BAD_DATA
    assert "no sonar data in it" in ran.output
    assert not ran.out.exists()


def test_name_that_is_too_long_is_one_line(tmp_path: Path, run: Run) -> None:
    ran = run(tmp_path / ("a" * 300), STILL)
    assert ran.code == ExitCode.NO_INPUT
    assert ran.output.count("\n") == 1
