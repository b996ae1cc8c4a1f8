"""Real pings, field by field, against values found by hand in the captures."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver.ping import Ping, decode_ping
from oculus_driver.wire import HEADER, PING_RESULT_V1

if TYPE_CHECKING:
    from oculus_driver.stream import Message


@dataclass(frozen=True)
class Golden:
    offset: int
    ping_id: int
    ticks: int
    total: int
    mean: float
    deviation: float
    median: int
    zeros_254_255: tuple[int, int, int]
    first: tuple[int, ...]
    last: tuple[int, ...]
    spots: tuple[int, ...]
    row_means: tuple[float, ...]
    gap_nonzero: int
    sha256: str


GOLDEN = (
    Golden(
        0,
        415323,
        3103899264,
        10052524,
        55.85728573968706,
        52.071297,
        43,
        (37, 1500, 0),
        (42, 45, 47, 48, 48, 49, 48, 46),
        (61, 51, 94, 103, 68, 47, 62, 55),
        (5, 149, 49, 47, 55),
        (39.668, 8.8594, 10.1953, 167.707, 66.8867),
        786,
        "cd46b919b737bda01b24982ca4ec32b50ab65721ca29690620f0afaa295068ad",
    ),
    Golden(
        182016,
        415324,
        3166401394,
        10101513,
        56.12949524359886,
        52.118633,
        44,
        (38, 1514, 0),
        (42, 45, 47, 48, 49, 49, 48, 46),
        (75, 56, 93, 96, 75, 57, 52, 68),
        (13, 132, 55, 76, 68),
        (39.6875, 8.3125, 10.0156, 170.4961, 71.7266),
        782,
        "986ebee6c35f00df4e7ff068314a558791463e9dd281efc80701cf671877b54d",
    ),
    Golden(
        364032,
        415325,
        3228903491,
        10008409,
        55.61215882823613,
        51.531873,
        43,
        (38, 1364, 0),
        (41, 44, 46, 48, 48, 49, 47, 45),
        (82, 68, 59, 48, 51, 36, 36, 24),
        (5, 108, 55, 68, 24),
        (38.9922, 9.0156, 9.5898, 169.7422, 64.5625),
        783,
        "d7b5bfe4bf057b17548aacea0b7d5f838148cf99a08b9e4f668e36f8037df7e8",
    ),
)

SPEED = 1490.658551265436
RESOLUTION = 0.0028421889710794315

pytestmark = pytest.mark.parametrize("index", [0, 1, 2])


@pytest.fixture
def golden(index: int) -> Golden:
    return GOLDEN[index]


@pytest.fixture
def message(captured: list[Message], index: int) -> Message:
    return captured[index]


@pytest.fixture
def ping(message: Message) -> Ping:
    ping = decode_ping(message)
    assert isinstance(ping, Ping)
    return ping


def test_the_header_is_read(message: Message, golden: Golden) -> None:
    assert message.data[:16].hex() == "534fd41e000023000000f0c602000000"
    assert HEADER.unpack(message.data) == {
        "magic": 0x4F53,
        "source_id": 7892,
        "destination_id": 0,
        "message_id": 35,
        "version": 0,
        "payload_size": 182000,
        "part_number": 0,
    }
    assert (message.offset, len(message.data)) == (golden.offset, 182016)
    assert (message.message_id, message.version, message.source_id) == (35, 0, 7892)
    assert message.arrival_ns == 10**18


def test_every_field_of_the_fixed_part_is_read(message: Message, golden: Golden) -> None:
    fields = PING_RESULT_V1.unpack(message.data)
    header = HEADER.unpack(message.data)
    assert {name: value for name, value in fields.items() if name not in header} == {
        "mode": 2,
        "ping_rate": 195,
        "network_speed_mbps": 25,
        "gamma": 127,
        "flags": 0x19,
        "range_demand": 2.0,
        "gain_percent": 50.0,
        "speed_of_sound_demand_mps": SPEED,
        "salinity_ppt": 0.0,
        "ping_id": golden.ping_id,
        "status": 0,
        "frequency_hz": 2098880.5970149254,
        "temperature_c": 2.5996505664141207e-76,
        "pressure_bar": -1.373314399516124e194,
        "speed_of_sound_mps": SPEED,
        "start_ticks": golden.ticks,
        "data_size": 0,
        "range_resolution_m": RESOLUTION,
        "rows": 703,
        "beams": 256,
        "image_offset": 2048,
        "image_size": 179968,
        "message_size": 182016,
    }
    assert PING_RESULT_V1.pack(fields) == message.data[:122]


def test_the_ping_holds_what_the_message_holds(ping: Ping, golden: Golden) -> None:
    assert (ping.ping_id, ping.offset, ping.version) == (golden.ping_id, golden.offset, 1)
    assert (ping.source_id, ping.part_number, ping.mode) == (7892, 0, 2)
    assert (ping.flags, ping.status, ping.gamma) == (0x19, 0, 127)
    assert ping.frequency_hz == 2098880.5970149254 == 140.625e6 / 67
    assert (ping.range_setting_m, ping.gain_percent) == (2.0, 50.0)
    assert (ping.speed_of_sound_mps, ping.salinity_ppt) == (SPEED, 0.0)
    assert (ping.rows, ping.beams, ping.bits_per_sample, ping.full_scale) == (703, 256, 8, 255)
    assert (ping.start_ticks, ping.start_time_s) == (golden.ticks, None)
    assert ping.gains is None
    assert ping.warnings == frozenset()


def test_left_over_memory_is_no_measurement(ping: Ping) -> None:
    assert ping.temperature_c is None
    assert ping.pressure_bar is None
    assert (ping.heading_rad, ping.pitch_rad, ping.roll_rad) == (None, None, None)


def test_the_image_is_that_of_the_file(ping: Ping, golden: Golden) -> None:
    image = ping.image
    assert hashlib.sha256(image.tobytes()).hexdigest() == golden.sha256
    assert image.dtype == np.uint8
    assert image.shape == (703, 256)
    assert (image.min(), image.max(), image.sum()) == (0, 254, golden.total)
    assert image.mean() == golden.mean
    assert image.std() == pytest.approx(golden.deviation, abs=1e-6)
    assert np.median(image) == golden.median
    counts = tuple(int((image == value).sum()) for value in (0, 254, 255))
    assert counts == golden.zeros_254_255
    assert tuple(image[0, :8]) == golden.first
    assert tuple(image[702, 248:]) == golden.last
    assert (
        image[100, 100],
        image[351, 128],
        image[500, 200],
        image[702, 0],
        image[702, 255],
    ) == golden.spots
    assert divmod(int(image.argmax()), 256) == (251, 146)
    assert (image.mean(axis=1).argmax(), image.mean(axis=0).argmax()) == (348, 129)
    np.testing.assert_allclose(
        image.mean(axis=1)[[0, 10, 100, 351, 702]], golden.row_means, atol=1e-3
    )


def test_the_image_is_a_view_that_cannot_be_written(ping: Ping, message: Message) -> None:
    assert np.shares_memory(ping.image, np.frombuffer(message.data, np.uint8))
    for array in (ping.image, ping.bearings_rad):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_the_bearings_are_those_of_the_file(ping: Ping, message: Message) -> None:
    table = np.round(np.degrees(ping.bearings_rad) * 100).astype(int)
    assert table[:10].tolist() == [
        -3000, -2974, -2948, -2922, -2896, -2871, -2845, -2819, -2794, -2769,
    ]  # fmt: skip
    assert table[124:132].tolist() == [-78, -56, -33, -11, 11, 33, 56, 78]
    assert table[-5:].tolist() == [2896, 2922, 2948, 2974, 3000]
    assert table.sum() == 0
    steps = np.diff(table)
    assert (steps.min(), steps.max()) == (22, 26)
    digest = hashlib.sha256(message.data[122 : 122 + 512]).hexdigest()
    assert digest.startswith("c409ac8c75899774")


def test_the_derived_ranges_are_right(ping: Ping) -> None:
    assert ping.max_range_m == pytest.approx(1.9980588466688405, abs=1e-15)
    np.testing.assert_allclose(
        ping.ranges_m[[0, 351, 702]],
        [0.0014210944855397158, 0.9990294233344202, 1.9966377521833008],
        rtol=1e-14,
    )
    row_rate_hz = SPEED / (2 * RESOLUTION)
    assert row_rate_hz == pytest.approx(562.5e6 / 2145, rel=1e-9)


def test_the_gap_behind_the_table_is_left_alone(message: Message, golden: Golden) -> None:
    gap = np.frombuffer(message.data, np.uint8, 1414, 634)
    assert np.count_nonzero(gap) == golden.gap_nonzero


def test_the_echo_meets_its_target_half_way(ping: Ping) -> None:
    flight_ns = 2 * 1.9980588466688405 / SPEED * 1e9
    start = ping.transmit_time_ns()
    assert start is not None
    assert 10**18 - start == round(flight_ns)
    assert ping.transmit_time_ns(latency_ns=1000) == start - 1000
    assert ping.echo_time_ns(1.0) == start + round(1e9 / SPEED)


def test_the_edges_enclose_the_beams(ping: Ping) -> None:
    edges = ping.beam_edges_rad()
    assert edges.shape == (257,)
    assert (edges[:-1] < ping.bearings_rad).all()
    assert (ping.bearings_rad < edges[1:]).all()
    assert math.degrees(edges[-1]) == pytest.approx(30.13, abs=0.01)
