import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.localization.extraction import BurstWatch, unexplained_share

BEARINGS = np.radians(np.linspace(-60, 60, 121))
WALL = 10 / np.cos(BEARINGS)
SECOND = 1_000_000_000


def watch() -> BurstWatch:
    return BurstWatch(1.0, np.radians(30))


def shares(*pings: NDArray[np.float64], step_ns: int = SECOND // 10) -> list[float]:
    one = watch()
    return [one.share(k * step_ns, BEARINGS, ping, 0.02) for k, ping in enumerate(pings)]


def test_steady_scene_is_explained() -> None:
    noise = np.random.default_rng(1).normal(0, 0.005, (4, 121))
    assert max(shares(*(WALL + noise))) == 0


def test_burst_is_seen_and_the_ping_after_it_is_not() -> None:
    assert shares(WALL, WALL, np.full(121, 4.0), WALL, WALL) == [0, 0, 1, 0, 0]


def test_what_really_changed_is_believed_the_second_time() -> None:
    other = np.full(121, 4.0)
    assert shares(WALL, WALL, other, other, other) == [0, 0, 1, 0, 0]


def test_a_vehicle_moves_as_far_as_it_can() -> None:
    ring = np.full(121, 4.0)
    assert shares(ring, ring - 0.11)[1] == 0
    assert shares(ring, ring - 0.13)[1] == 1
    assert shares(ring, ring - 0.13, step_ns=2 * SECOND // 10)[1] == 0


def test_a_turn_moves_returns_to_other_beams() -> None:
    steps = np.where(BEARINGS < 0, 5.0, 12.0)
    turned = np.where(np.radians(3) > BEARINGS, 5.0, 12.0)
    far = np.where(np.radians(20) > BEARINGS, 5.0, 12.0)
    assert shares(steps, turned)[1] == 0
    assert shares(steps, far)[1] == pytest.approx(15 / 121, abs=2 / 121)


def test_returns_out_of_open_water_are_unexplained_and_missing_ones_are_no_returns() -> None:
    nothing = np.full(121, np.nan)
    assert shares(nothing, np.full(121, 4.0))[1] == 1
    assert shares(WALL, nothing)[1] == 0
    half = np.where(BEARINGS < 0, WALL, np.nan)
    assert shares(half, half)[1] == 0


def test_of_few_returns_nothing_is_reported() -> None:
    few = np.full(121, np.nan)
    few[:10] = 3.0
    assert shares(WALL, few)[1] == 0


def test_pings_of_other_beams_are_not_compared() -> None:
    one = watch()
    one.share(0, BEARINGS, WALL, 0.02)
    assert one.share(1, BEARINGS[:60], np.full(60, 3.0), 0.02) == 0


def test_one_beam_has_a_share_too() -> None:
    share = unexplained_share(np.zeros(1), np.ones(1), np.full(1, 3.0), moved_m=1, turned_rad=1)
    assert share == 1
