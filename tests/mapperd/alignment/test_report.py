"""What an alignment writes, read back by other readers."""

import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.alignment.align import AlignedDive, Alignment
from mapperd.alignment.pose_graph import Loop
from mapperd.alignment.report import maps_of, record_of, write_alignment
from mapperd.alignment.submaps import DiveReader, OdometryTrack, SonarSubmap
from mapperd.config.tree import Config
from mapperd.odometry.native import decode_native
from mapperd.odometry.odometry_files import OdometryOptions, read_odometry
from mapperd.odometry.records import Odometry
from mapperd.session.recordings import RecordedSession

Floats = NDArray[np.float64]

START_NS = 1_700_000_000_000_000_000
TICKS = 101  # 10 s
NODES = 3  # at 0, 5 and 10 s


def planar_pose(x: float, y: float, yaw: float) -> Floats:
    return np.array(
        [[math.cos(yaw), -math.sin(yaw), x], [math.sin(yaw), math.cos(yaw), y], [0, 0, 1]]
    )


def track_of() -> OdometryTrack:
    """One metre a second along x, with a heading of 0.2 rad, a roll, and a depth."""
    t_ns = START_NS + np.arange(TICKS, dtype=np.int64) * 100_000_000
    s = np.arange(TICKS) / 10
    roll, yaw = 0.1, 0.2
    quaternion = [
        math.cos(yaw / 2) * math.cos(roll / 2),
        math.cos(yaw / 2) * math.sin(roll / 2),
        math.sin(yaw / 2) * math.sin(roll / 2),
        math.sin(yaw / 2) * math.cos(roll / 2),
    ]
    return OdometryTrack(
        t_ns,
        np.column_stack([s, np.zeros(TICKS), -3.0 - 0.01 * s]),
        np.tile(quaternion, (TICKS, 1)),
        np.where(s < 8.0, 4, 5).astype(np.int64),
        0.1 * s,
    )


def dive_of(name: str, frame: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> AlignedDive:
    """A dive whose aligned poses are shorter by a tenth, and turned by 0.1 rad at the end."""
    track = track_of()
    t_ns = track.t_ns[[0, 50, 100]]
    odometry = track.at(t_ns)
    corrected = odometry * [0.9, 1.0, 1.0] + [[0, 0, 0], [0, 0, 0.05], [0, 0, 0.1]]
    c, s = math.cos(frame[2]), math.sin(frame[2])
    poses = np.column_stack(
        [
            frame[0] + c * corrected[:, 0] - s * corrected[:, 1],
            frame[1] + s * corrected[:, 0] + c * corrected[:, 1],
            corrected[:, 2] + frame[2],
        ]
    )
    covariance = np.array([np.diag([0.01 * k, 0.02 * k, 0.001 * k]) for k in range(NODES)])
    covariance[:, 0, 2] = covariance[:, 2, 0] = [0.0, 0.0005, 0.001]
    drift = np.tile([-0.1, math.radians(2.0), math.radians(3.0) / 60], (NODES, 1))
    return AlignedDive(name, t_ns, odometry, poses, covariance, drift, np.array(frame), track)


def loop(i: int, j: int, pose: tuple[float, float, float], weight: float) -> Loop:
    information = np.array([[100.0, 1, 2], [1, 90, 3], [2, 3, 400]])
    return Loop(
        i,
        j,
        np.array([pose]),
        information[None],
        neighbours=False,
        scores=np.array([0.8]),
        centre=np.zeros(2),
        weight=weight,
    )


def alignment_of(*dives: AlignedDive, corrected: bool = True) -> Alignment:
    loops = [loop(0, 2, (8.9, 0.0, 0.1), 1.0), loop(0, 1, (7.0, 0.0, 0.0), 0.1)]
    reason = "" if corrected else "nothing was seen twice"
    return Alignment(
        list(dives), loops, corrected, reason, 7, Counter(poor_fit=2), {"split_m": 0.1}
    )


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures: they take seconds."""
    monkeypatch.setattr("mapperd.alignment.report._draw", lambda *_: [])


@pytest.mark.usefixtures("drawn")
def test_the_trajectory_has_aligned_x_y_yaw_and_the_rest_of_the_odometry(tmp_path: Path) -> None:
    write_alignment(alignment_of(dive_of("a")), tmp_path)
    rows = np.loadtxt(tmp_path / "trajectory.tum")
    assert rows.shape == (TICKS, 8)
    assert rows[0, 0] == START_NS / 1e9
    expected = np.array([[0, 0, -3], [4.5, 0, -3.05], [9, 0, -3.1]])
    np.testing.assert_allclose(rows[[0, 50, 100], 1:4], expected)
    x, y, z, w = rows[100, 4:]
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(0.3)
    assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(0.1)


@pytest.mark.usefixtures("drawn")
def test_the_records_are_finished_poses_with_covariances(tmp_path: Path) -> None:
    write_alignment(alignment_of(dive_of("a")), tmp_path)
    config = Config()
    files = read_odometry(OdometryOptions((tmp_path / "trajectory.mcap",)), config)
    assert files.files[0].is_finished
    assert files.settings(config).odometry.at_jump == "follow"
    chunks = list(files.files[0].chunks())
    records = [decode_native(chunk.data) for chunk in chunks]
    assert all(isinstance(record, Odometry) for record in records)
    last = records[-1]
    assert isinstance(last, Odometry)
    assert last.stamp_ns == chunks[-1].arrival_ns == START_NS + 10**10
    assert last.pose_covariance is not None
    assert last.position_m == pytest.approx([9, 0, -3.1])
    place = np.ix_([0, 1, 5], [0, 1, 5])
    expected = [[0.02, 0, 0.001], [0, 0.04, 0], [0.001, 0, 0.002]]
    np.testing.assert_allclose(last.pose_covariance[place], expected)
    assert np.linalg.eigvalsh(last.pose_covariance).min() > 0
    resets = [record.reset_count for record in records if isinstance(record, Odometry)]
    assert resets == [0] * 80 + [1] * 21
    assert not list(tmp_path.glob(".*"))


@pytest.mark.usefixtures("drawn")
def test_the_graph_has_all_nodes_and_its_accepted_edges_fit(tmp_path: Path) -> None:
    alignment = alignment_of(dive_of("a"), dive_of("b", (3.0, -2.0, 0.7)))
    write_alignment(alignment, tmp_path)
    vertices: dict[int, Floats] = {}
    edges: list[tuple[int, int, Floats, Floats]] = []
    fixed, refused = [], 0
    for line in (tmp_path / "graph.g2o").read_text().splitlines():
        tag, *words = line.split()
        if tag == "VERTEX_SE2":
            vertices[int(words[0])] = planar_pose(*map(float, words[1:]))
        elif tag == "EDGE_SE2":
            numbers = np.array(words[2:], dtype=float)
            edges.append((int(words[0]), int(words[1]), planar_pose(*numbers[:3]), numbers[3:]))
        elif tag == "FIX":
            fixed.append(int(words[0]))
        else:
            assert tag == "#"
            refused += "refused: EDGE_SE2 0 1 7 0 0" in line
    assert sorted(vertices) == list(range(2 * NODES))
    assert fixed == [0]
    assert refused == 1
    steps = [(i, j) for i, j, _, _ in edges]
    assert steps == [(0, 1), (1, 2), (3, 4), (4, 5), (0, 2)]
    for i, j, pose, _ in edges[:4]:  # odometry goes 5 m straight ahead, in its own heading
        assert math.hypot(*pose[:2, 2]) == pytest.approx(5.0)
        assert math.hypot(*(vertices[j] - vertices[i])[:2, 2]) == pytest.approx(4.5)
    np.testing.assert_allclose(edges[-1][3], [100, 1, 2, 90, 3, 400])


@pytest.mark.usefixtures("drawn")
def test_steps_without_velocity_are_loose_in_the_graph(tmp_path: Path) -> None:
    dive = dive_of("a")
    doubt_m = np.where(np.arange(TICKS) > 50, 3.0, 0.0)  # in the second step, of two
    track = replace(dive.track, deviation_m=doubt_m, segment=np.zeros(TICKS, dtype=np.int64))
    write_alignment(alignment_of(replace(dive, track=track)), tmp_path)
    lines = (tmp_path / "graph.g2o").read_text().splitlines()
    edges = [line.split() for line in lines if line.startswith("EDGE_SE2")]
    sure, loose = (1 / math.sqrt(float(words[6])) for words in edges[:2])
    assert sure < 0.5
    assert loose == pytest.approx(3.0 / math.sqrt(2), rel=0.1)  # of each axis


@pytest.mark.usefixtures("drawn")
def test_the_figures_are_those_of_the_dive(tmp_path: Path) -> None:
    # The frames of the loops are the nodes, whose heading is 0.2 rad.
    write_alignment(alignment_of(dive_of("a")), tmp_path)
    facts = json.loads((tmp_path / "alignment.json").read_text())
    assert facts["corrected"] is True
    assert (facts["revisits_accepted"], facts["revisits_refused"]) == (1, 1)
    [dive] = facts["dives"]
    assert dive["correction_max_m"] == pytest.approx(1.0)
    assert dive["correction_rms_m"] == pytest.approx(math.sqrt((0.25 + 1.0) / 3))
    assert dive["correction_max_deg"] == pytest.approx(math.degrees(0.1))
    assert dive["drift_scale_percent"] == pytest.approx(-10)
    assert dive["drift_turn_deg_per_min"] == pytest.approx(3)
    assert dive["deviation_max_m"] == pytest.approx(math.sqrt(0.06))
    accepted, refused = facts["loops"]
    assert (accepted["accepted"], refused["accepted"]) == (True, False)
    assert accepted["time_s"] == [START_NS / 1e9, START_NS / 1e9 + 10]
    expected = math.hypot(9 * math.cos(0.2) - 8.9, 9 * math.sin(0.2))
    assert accepted["residual_m"] == pytest.approx(expected)
    assert accepted["residual_deg"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.usefixtures("drawn")
def test_the_report_says_why_nothing_is_corrected(tmp_path: Path) -> None:
    record = write_alignment(alignment_of(dive_of("a"), corrected=False), tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "because nothing was seen twice" in text
    assert record.summary()["reason"] == "nothing was seen twice"


@pytest.mark.usefixtures("drawn")
def test_dives_have_files_by_their_names(tmp_path: Path) -> None:
    write_alignment(alignment_of(dive_of("a"), dive_of("b", (3.0, -2.0, 0.7))), tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"a.tum", "a.mcap", "b.tum", "b.mcap"} <= names
    assert not any(name.startswith("trajectory") for name in names)
    first = np.loadtxt(tmp_path / "b.tum")[0]
    assert first[1:3] == pytest.approx([3, -2])


def test_a_frame_alone_is_no_correction() -> None:
    placed = dive_of("b", (3.0, -2.0, 0.7))
    record = record_of(alignment_of(dive_of("a"), placed)).dives[1]
    assert record.correction_max_m == pytest.approx(1.0)
    assert record.frame == pytest.approx((3.0, -2.0, math.degrees(0.7)))


def submap_at(dive: AlignedDive, seen: NDArray[np.int32]) -> SonarSubmap:
    """A submap at the last node, whose voxels are occupied and free alike."""
    end, weight = int(dive.t_ns[2]), np.ones(len(seen))
    return SonarSubmap(end, end, end, dive.odometry[2], 0, 5, seen, seen, weight, 0.2)


def test_maps_lie_where_the_poses_put_the_submaps() -> None:
    dive = dive_of("a")
    seen = np.array([[10, 0, -15]], dtype=np.int32)  # 2 m ahead of the last node
    submap = submap_at(dive, seen)
    session = RecordedSession([], None)
    reader = DiveReader(session, Config())
    assert maps_of(alignment_of(dive), [reader]) is None
    reader.uncorrected = reader.submaps = [submap]
    maps = maps_of(alignment_of(dive), [reader])
    assert maps is not None
    for voxels, x, yaw in ((maps.before, 10.0, 0.2), (maps.after, 9.0, 0.3)):
        ahead, port = 2.1, 0.1
        expected = [
            x + ahead * math.cos(yaw) - port * math.sin(yaw),
            ahead * math.sin(yaw) + port * math.cos(yaw),
            -2.9,
        ]
        assert voxels.centres_m[0] == pytest.approx(expected, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(60, 20), (20, 60)])
def test_pictures_are_drawn_for_one_dive_and_several(tmp_path: Path, size: tuple[int, int]) -> None:
    imread = pytest.importorskip("matplotlib.image").imread
    strip = np.stack(np.meshgrid(*map(range, size), [-15], indexing="ij"), -1)
    seen = np.ascontiguousarray(strip.reshape(-1, 3), dtype=np.int32)
    for name, dives in (("one", ["a"]), ("two", ["a", "b"])):
        alignment = alignment_of(*map(dive_of, dives))
        reader = DiveReader(RecordedSession([], None), Config())
        dive = alignment.dives[0]
        submap = submap_at(dive, seen)
        reader.uncorrected = reader.submaps = [submap]
        maps = maps_of(alignment, [reader] * len(dives))
        write_alignment(alignment, tmp_path / name, maps)
        pictures = {path.name for path in (tmp_path / name).glob("*.png")}
        figures = {"trajectory.png", "correction.png", "loops.png", "residuals.png"}
        assert pictures == figures | {"map.png"}
        text = (tmp_path / name / "report.md").read_text()
        assert all(f"]({picture})" in text for picture in pictures)
        height, width, _ = imread(tmp_path / name / "map.png").shape
        assert (width > 1.2 * height) == (size[1] > size[0])  # side by side, or one below the other
