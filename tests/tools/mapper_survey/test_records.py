"""What is spooled of a ping is all that the map wants of it."""

from collections.abc import Callable

import numpy as np
import pytest
from mapper_survey.spool import RecordReader, RecordWriter

from mapperd.config.tree import Config
from mapperd.errors import MapperdError
from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap

POSE = pose_from_rpy((3.0, -2.0, -4.0), (5, 20, 70)).map_T_base
MOTION = PingMotion(np.array([1.0, 0.2, 0.0]), np.array([0.0, 0.1, 0.3]), 0.01, 1480.0)


def echo_of(intensity: np.ndarray) -> PingImage:
    return PingImage(intensity.astype(np.float32), np.linspace(-0.7, 0.7, 20), 0.1)


def noise(kind: Callable[[np.ndarray], np.ndarray]) -> PingImage:
    return echo_of(kind(np.random.default_rng(3).uniform(0, 255, (40, 20))))


@pytest.mark.parametrize("threshold", [35, 100])
@pytest.mark.parametrize("kind", [np.round, np.asarray], ids=["bytes", "fractions"])
def test_the_map_is_the_same_to_the_bit(
    kind: Callable[[np.ndarray], np.ndarray], threshold: int
) -> None:
    config = Config()
    echo = noise(kind)
    writer = RecordWriter(threshold)
    record = writer.pack(echo, POSE, MOTION)
    back, pose, motion = RecordReader(writer.bearings).unpack(record)
    assert motion is not None
    assert pose.tobytes() == POSE.tobytes()
    assert np.array_equal(back.intensity, np.where(echo.intensity > threshold, echo.intensity, 0))
    maps = [SonarMap(config), SonarMap(config)]
    for sonar_map in maps:
        sonar_map.core.set_intensity_threshold(threshold)
    maps[0].integrate(echo, POSE, MOTION)
    maps[1].integrate(back, pose, motion)
    assert maps[0].sha256() == maps[1].sha256()
    assert maps[0].counts().occupied > 10


def test_a_sample_just_above_the_threshold_is_kept() -> None:
    threshold = 34.9999999  # which no float32 is
    samples = np.full((3, 20), 34.0, dtype=np.float32)
    samples[1] = np.nextafter(np.float32(35), np.float32(0))
    samples[2] = 35.0
    for rows in (samples, samples[[0, 2]]):
        writer = RecordWriter(threshold)
        record = writer.pack(echo_of(rows), POSE, None)
        back, _, motion = RecordReader(writer.bearings).unpack(record)
        assert motion is None
        expected = np.where(rows.astype(np.float64) > threshold, rows, 0)
        assert np.array_equal(back.intensity, expected)


def test_bearings_are_kept_once() -> None:
    writer = RecordWriter(35)
    other = PingImage(np.zeros((4, 3), np.float32), np.array([-0.1, 0.0, 0.2]), 0.5)
    records = [writer.pack(echo, POSE, None) for echo in (noise(np.round), other, noise(np.round))]
    assert len(writer.bearings) == 2
    reader = RecordReader(writer.bearings)
    found = [reader.unpack(record)[0].bearings_rad.tolist() for record in records]
    assert found[0] == found[2] != found[1] == [-0.1, 0.0, 0.2]


@pytest.mark.parametrize("cut", [0, 100, -1])
def test_damage_is_reported(cut: int) -> None:
    writer = RecordWriter(35)
    record = writer.pack(noise(np.round), POSE, None)
    with pytest.raises(MapperdError, match="spool is damaged"):
        RecordReader(writer.bearings).unpack(record[:cut])


def test_a_turned_bit_of_a_pose_is_reported() -> None:
    writer = RecordWriter(35)
    record = bytearray(writer.pack(noise(np.round), POSE, None))
    record[40] ^= 1
    with pytest.raises(MapperdError, match="spool is damaged: wrong checksum"):
        RecordReader(writer.bearings).unpack(bytes(record))
