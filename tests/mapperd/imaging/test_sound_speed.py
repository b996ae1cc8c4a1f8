"""Ranges that were recorded with a wrong speed of sound."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mapperd.config.device import WaterConfig
from mapperd.config.loader import config_from_text
from mapperd.errors import ConfigError
from mapperd.geometry.frames import pose_from_rpy
from mapperd.imaging.ping_image import corrected_ranges, true_speed_mps
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.session.replay import Replay, Window
from oculus_driver import Ping
from oculus_driver.recording import OCULUS, Chunk
from oculus_driver.sound_speed import speed_of_sound_mps

MakePing = Callable[..., Ping]
MakeBytes = Callable[..., bytes]

FRESH = WaterConfig(salinity=0.0, correct_ranges=True)
SEA_MPS = speed_of_sound_mps(10.0, 35.0)
FRESH_MPS = speed_of_sound_mps(10.0, 0.0)


def test_fresh_water_with_35_ppt_is_2_9_percent_off(ping: MakePing) -> None:
    sent = ping(speed_of_sound_mps=SEA_MPS, salinity_ppt=35.0)
    corrected = corrected_ranges(sent, FRESH)
    assert pytest.approx(1.029, abs=5e-4) == SEA_MPS / FRESH_MPS
    assert sent.max_range_m / corrected.max_range_m == pytest.approx(SEA_MPS / FRESH_MPS)
    assert corrected.speed_of_sound_mps == pytest.approx(FRESH_MPS)
    assert np.shares_memory(corrected.image, sent.image)


def test_the_times_of_echoes_stay(ping: MakePing) -> None:
    sent = ping(speed_of_sound_mps=SEA_MPS, salinity_ppt=35.0)
    corrected = corrected_ranges(sent, FRESH)
    assert corrected.flight_ns(corrected.max_range_m) == sent.flight_ns(sent.max_range_m)
    assert corrected.transmit_time_ns() == sent.transmit_time_ns()


@pytest.mark.parametrize(
    ("water", "expected_mps"),
    [
        (WaterConfig(speed_of_sound=1447.0), 1447.0),
        (WaterConfig(salinity=0.0, temperature=10.0), FRESH_MPS),
        (WaterConfig(salinity=0.0, temperature=10.0, speed_of_sound=1500.0), 1500.0),
        (WaterConfig(salinity=0.0), FRESH_MPS),
        (WaterConfig(salinity=35.0), SEA_MPS),
    ],
)
def test_a_measured_speed_counts_before_a_temperature_and_that_before_salinity(
    water: WaterConfig, expected_mps: float
) -> None:
    assert true_speed_mps(water, SEA_MPS, 35.0) == pytest.approx(expected_mps)


@pytest.mark.parametrize("used_ppt", [float("nan"), -1.0, 41.0])
def test_an_implausible_salinity_changes_nothing(used_ppt: float) -> None:
    assert true_speed_mps(FRESH, SEA_MPS, used_ppt) == SEA_MPS


def test_ranges_stay_unless_a_correction_is_requested(ping: MakePing) -> None:
    sent = ping(speed_of_sound_mps=SEA_MPS, salinity_ppt=35.0)
    assert corrected_ranges(sent, WaterConfig(salinity=0.0)) is sent
    assert corrected_ranges(sent, WaterConfig(salinity=35.0, correct_ranges=True)) is sent


def wall_m(more: str, data: bytes) -> float:
    """Mean distance of the occupied voxels ahead, in a replay with some settings."""
    config = config_from_text(
        f"octree: {{voxel_resolution: 0.02}}\nmounting: {{orientation: {{pitch: 0}}}}\n{more}"
    )
    sonar_map = SonarMap(config)
    fixed = FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0)))
    replay = Replay(sonar_map, fixed, Window(), lambda: 0.0, confirm=False)
    chunks = [Chunk("sonar", OCULUS, 1_700_000_000_000_000_000, data)]
    for _ in replay.run(chunks):
        pass
    centres = sonar_map.voxels("occupied").centres_m
    assert len(centres)
    return float(np.mean(np.hypot(centres[:, 0], centres[:, 1])))


def test_a_replay_maps_a_recording_from_fresh_water_in_its_place(ping_bytes: MakeBytes) -> None:
    image = np.zeros((500, 65), np.uint8)
    image[398:402] = 250
    sent: dict[str, Any] = {"image": image, "range_resolution_m": 0.02}
    data = ping_bytes(1, speed_of_sound_mps=SEA_MPS, salinity_ppt=35.0, **sent)
    wrong_m = wall_m("", data)
    right_m = wall_m("water: {salinity: 0, correct_ranges: true}\n", data)
    assert wrong_m == pytest.approx(8.0, abs=0.03)
    assert wrong_m / right_m == pytest.approx(1.029, abs=2e-3)


def test_a_speed_that_no_water_has_is_refused() -> None:
    with pytest.raises(ConfigError, match="speed_of_sound 900 is below 1300; allowed: 0, or 1300"):
        config_from_text("water: {speed_of_sound: 900}\n")
