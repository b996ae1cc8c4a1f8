"""Alignment of drifting dives in a room; the room and the sonar are plain geometry."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.alignment.align import (
    AlignedDive,
    Alignment,
    AlignOptions,
    DiveInput,
    align,
    odometry_steps,
)
from mapperd.alignment.submaps import (
    Correction,
    DiveSubmaps,
    OdometryTrack,
    compose,
    inverse,
    read_submaps,
)
from mapperd.config.loader import config_of
from mapperd.session.recordings import files_in, sessions_of
from tests.mapperd.localization.room import PERIOD_S, Dive, Recorder, dive, events, room

pytestmark = pytest.mark.slow

Floats = NDArray[np.float64]

CONFIG = config_of(
    {
        "octree": {"voxel_resolution": 0.1},
        "mounting": {"orientation": {"pitch": 0}},
        "sonar": {"vertical_aperture": 4},
    },
    "",
)
STEPS = 330
"""Three times round and a part again."""


def drifting(truth: Floats) -> Dive:
    """The track with odometry that is 4 % too long, 2 % aside and turns by 3 degrees a minute."""
    odometry = [truth[0]]
    for before, after in itertools.pairwise(truth):
        motion = compose(inverse(before), after)
        c, s = 1.04, 0.02
        x, y = c * motion[0] - s * motion[1], s * motion[0] + c * motion[1]
        odometry.append(compose(odometry[-1], np.array([x, y, motion[2] + 0.00017])))
    return Dive(truth, np.array(odometry))


def given(
    folder: Path, track: Dive, write_recording: Recorder, name: str = "dive", **known: object
) -> DiveInput:
    write_recording(folder / name, events(room(), track))
    paths = files_in([folder / name], begun=True)

    def read(correction: Correction | None) -> DiveSubmaps:
        return read_submaps(sessions_of(paths)[0], CONFIG, correction)

    return DiveInput(name, read, **known)  # type: ignore[arg-type]


def errors_m(track: Dive, estimate: Callable[[NDArray[np.int64]], Floats], begin_ns: int) -> Floats:
    """Distances from the truth at the pings, the first pose being right."""
    times = begin_ns + (np.arange(len(track.truth)) * PERIOD_S * 1e9).astype(np.int64)
    found = estimate(times)
    frame = compose(track.truth[0], inverse(found[0]))
    found = compose(np.broadcast_to(frame, found.shape), found)
    return np.asarray(np.hypot(*(found - track.truth)[:, :2].T))


def begin_of(aligned: AlignedDive) -> int:
    """Time of the first ping: `events` sends the first odometry 20 ms before it."""
    return int(aligned.track.t_ns[0]) + 20_000_000


@pytest.fixture(scope="module")
def track() -> Dive:
    return drifting(dive(STEPS).truth)


@pytest.fixture
def alignment(tmp_path: Path, track: Dive, write_recording: Recorder) -> Alignment:
    return align([given(tmp_path, track, write_recording)])


def test_a_drifting_dive_is_corrected(alignment: Alignment, track: Dive) -> None:
    [aligned] = alignment.dives
    before = errors_m(track, aligned.track.at, begin_of(aligned))
    after = errors_m(track, aligned.poses_at, begin_of(aligned))
    assert alignment.corrected, alignment.reason
    assert np.sqrt((after**2).mean()) < 0.25 * np.sqrt((before**2).mean())
    assert alignment.figures["neighbour_deviation_factor"] < 1.0  # walls hold a heading well


def test_accepted_revisits_are_right(alignment: Alignment, track: Dive) -> None:
    [aligned] = alignment.dives
    at_s = (aligned.t_ns - begin_of(aligned)) / 1e9 / PERIOD_S
    truth = np.stack(
        [np.interp(at_s, np.arange(len(track.truth)), column) for column in track.truth.T], axis=1
    )
    accepted = [loop for loop in alignment.loops if loop.accepted and not loop.neighbours]
    assert len(accepted) >= 6
    for loop in accepted:
        measured = loop.poses[loop.chosen]
        true = compose(inverse(truth[loop.i]), truth[loop.j])
        assert math.dist(measured[:2], true[:2]) < 0.5


def test_the_stated_deviation_is_of_the_size_of_the_error(
    alignment: Alignment, track: Dive
) -> None:
    [aligned] = alignment.dives
    after = errors_m(track, aligned.poses_at, begin_of(aligned))
    stated = np.sqrt(aligned.covariance[:, 0, 0] + aligned.covariance[:, 1, 1]).mean()
    rms = np.sqrt((after**2).mean())
    assert 0.3 * rms < stated < 5 * rms + 0.1


def test_threads_change_nothing(tmp_path: Path, track: Dive, write_recording: Recorder) -> None:
    dive_given = given(tmp_path, track, write_recording)
    one, three = (align([dive_given], AlignOptions(threads=threads)) for threads in (1, 3))
    assert one.dives[0].poses.tobytes() == three.dives[0].poses.tobytes()
    assert one.dives[0].covariance.tobytes() == three.dives[0].covariance.tobytes()


def test_a_dive_without_a_revisit_keeps_its_odometry(
    tmp_path: Path, write_recording: Recorder
) -> None:
    short = drifting(dive(70).truth)
    found = align([given(tmp_path, short, write_recording)])  # less than once round
    [aligned] = found.dives
    assert not found.corrected
    assert "revisit" in found.reason
    times = aligned.track.t_ns
    assert np.allclose(aligned.poses_at(times)[:, :2], aligned.track.at(times)[:, :2], atol=1e-9)


def test_fixes_correct_a_dive_without_revisits(tmp_path: Path, write_recording: Recorder) -> None:
    short = drifting(dive(70).truth)
    plain = align([given(tmp_path, short, write_recording)])
    begin_ns = begin_of(plain.dives[0])
    known_T_room = np.array([30.0, -20.0, 2.0])  # noqa: N806 frames
    known = compose(np.broadcast_to(known_T_room, short.truth.shape), short.truth)
    fixes = tuple(
        (begin_ns + int(k * PERIOD_S * 1e9), float(x), float(y), 0.05)
        for k, (x, y, _) in enumerate(known)
        if k % 10 == 0
    )
    wrong_ns, *_ = fixes[3]
    fixes += ((wrong_ns + 1, 500.0, 0.0, 0.05),)  # an outlier
    found = align([given(tmp_path, short, write_recording, "fixed", fixes=fixes)])
    [aligned] = found.dives
    assert found.corrected
    times = begin_ns + (np.arange(70) * PERIOD_S * 1e9).astype(np.int64)
    off = np.hypot(*(aligned.poses_at(times) - known)[:, :2].T)
    assert np.sqrt((off**2).mean()) < 0.15


def test_two_dives_whose_frames_differ_come_together(
    tmp_path: Path, track: Dive, write_recording: Recorder
) -> None:
    frame = np.array([4.0, -3.0, math.radians(20.0)])
    # The second dive runs a third later, in a frame of its own.
    order = np.r_[80:STEPS]
    other = Dive(
        track.truth[order],
        compose(np.broadcast_to(frame, (len(order), 3)), track.truth[order]),
    )
    found = align(
        [
            given(tmp_path, Dive(track.truth, track.truth), write_recording, "first"),
            given(tmp_path, other, write_recording, "second"),
        ]
    )
    first, second = found.dives
    assert found.corrected, found.reason
    begin_ns = begin_of(second)
    times = begin_ns + (np.arange(len(order)) * PERIOD_S * 1e9).astype(np.int64)
    # The first dive's odometry is the truth, so the common frame is the room's.
    off = second.poses_at(times) - other.truth
    assert np.abs(off[:, :2]).mean(axis=0).max() < 0.1
    turn = np.remainder(off[:, 2] + math.pi, 2 * math.pi) - math.pi
    assert abs(float(turn.mean())) < math.radians(0.5)
    assert first.name == "first"


def test_dives_of_different_places_are_refused(
    tmp_path: Path, track: Dive, write_recording: Recorder
) -> None:
    empty = Dive(track.truth[:60] + np.array([40.0, 40.0, 0.0]), track.odometry[:60])
    found = align(
        [
            given(tmp_path, track, write_recording, "here"),
            given(tmp_path, empty, write_recording, "elsewhere"),
        ]
    )
    assert not found.corrected
    assert "elsewhere" in found.reason


def test_an_outage_of_velocity_that_the_odometry_states_is_corrected(
    tmp_path: Path, track: Dive, write_recording: Recorder
) -> None:
    # 0.25 m/s for ten seconds of the second lap.
    lost = slice(120, 170)
    error_m = np.zeros(STEPS)
    error_m[lost] = 0.25 * PERIOD_S
    heading = track.odometry[:, 2]
    away_m = np.cumsum(
        np.column_stack([error_m * np.cos(heading + 2.0), error_m * np.sin(heading + 2.0)]), axis=0
    )
    odometry = track.odometry + np.column_stack([away_m, np.zeros(STEPS)])
    stated_m = np.hypot(0.02, np.cumsum(error_m))
    found = align([given(tmp_path, Dive(track.truth, odometry, stated_m), write_recording)])
    [aligned] = found.dives
    before = errors_m(track, aligned.track.at, begin_of(aligned))
    after = errors_m(track, aligned.poses_at, begin_of(aligned))
    assert found.corrected, found.reason
    assert np.sqrt((after**2).mean()) < 0.15 * np.sqrt((before**2).mean())
    steps = odometry_steps(aligned.track, aligned.t_ns)
    assert sum(step.outage_std_m for step in steps if step is not None) == pytest.approx(
        2.5, rel=0.05
    )


def test_a_step_is_loose_where_the_odometry_says_so_and_at_jumps() -> None:
    count = 101  # 10 s at 1 m/s; two metres of doubt come about in the fifth second
    t_ns = np.arange(count, dtype=np.int64) * 100_000_000
    doubt_m = 2.0 * np.clip((np.arange(count) - 40) / 10, 0.0, 1.0)
    segment = (np.arange(count) >= 80).astype(np.int64)
    position_m = np.column_stack([np.arange(count) / 10, np.zeros(count), np.zeros(count)])
    level = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    track = OdometryTrack(t_ns, position_m, level, segment, doubt_m)
    first, sure, doubtful, jump = odometry_steps(track, t_ns[[0, 30, 60, 90]])
    assert first is None
    assert sure is not None
    assert doubtful is not None
    assert jump is not None
    assert sure.outage_std_m == sure.extra_std_m == 0
    assert doubtful.outage_std_m == pytest.approx(2.0 / math.sqrt(2))  # of each axis
    assert jump.extra_std_m > 5
    assert jump.extra_std_rad > 0.5
    assert sure.motion == pytest.approx([3.0, 0.0, 0.0])
    assert sure.path_m == pytest.approx(3.0)
