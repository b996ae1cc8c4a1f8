"""The pretended sonar without its sockets: commands, pace, numbers, settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver import Ping, StreamParser, decode_ping, encode_dummy, encode_fire
from oculus_driver.recording import OCULUS, RecordingWriter
from oculus_driver.virtual_sonar.device import CommandReader, FireRequest
from oculus_driver.virtual_sonar.faults import FaultInjector, Faults
from oculus_driver.virtual_sonar.playback import MessageSource, PlaybackDevice
from oculus_driver.virtual_sonar.resample import requested_range_m

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.net

VENDOR_FIRE = bytes.fromhex(
    "534f00000000150000000000000000000100ff7f4d"
    "0000000000003e4000000000000049400000000000000000"
    "0000000000804140"
)
"""A fire message as the vendor's program sends it: version 0 and payload size 0."""


def played(pings: list[bytes], *fires: bytes, resampled: bool = False) -> PlaybackDevice:
    device = PlaybackDevice(MessageSource(pings), resampled=resampled)
    reader = CommandReader()
    for fire in fires:
        device.receive(reader, fire)
    return device


def taken(device: PlaybackDevice) -> Ping:
    data, _ = device.take()
    (message,) = StreamParser().feed(data)
    ping = decode_ping(message)
    assert isinstance(ping, Ping)
    return ping


def test_a_fire_message_of_payload_size_0_is_obeyed() -> None:
    (fire,) = CommandReader().feed(VENDOR_FIRE)
    assert isinstance(fire, FireRequest)
    assert (fire.version, fire.range_demand, fire.gamma, fire.salinity_ppt) == (1, 30.0, 127, 35.0)


@given(st.lists(st.integers(1, 40), max_size=12), st.binary(max_size=60))
def test_commands_do_not_depend_on_the_pieces_they_come_in(cuts: list[int], end: bytes) -> None:
    data = encode_fire(gain_percent=1.0) + VENDOR_FIRE + encode_dummy() + encode_fire(version=1)
    data += end
    reader = CommandReader()
    found = []
    for size in cuts:
        found += reader.feed(data[:size])
        data = data[size:]
    found += reader.feed(data)
    fires = [command for command in found if isinstance(command, FireRequest)]
    assert [(fire.version, fire.gain_percent) for fire in fires[:3]] == [
        (2, 1.0),
        (1, 50.0),
        (1, 50.0),
    ]


def test_noise_between_commands_is_passed_over() -> None:
    reader = CommandReader()
    assert len(reader.feed(b"00SOS" * 9 + encode_fire())) == 1  # quirk 36
    assert reader.ignored_bytes == 45


def test_the_pace_is_the_recorders_where_it_noted_times(
    tmp_path: Path, make_ping: Callable[..., bytes]
) -> None:
    path = tmp_path / "dive.mcap"
    with RecordingWriter(path) as writer:
        link = writer.add_link("sonar", OCULUS)
        for index, stamp_ns in enumerate((10**9, 10**9 + 70_000_000, 10**9 + 90_000_000)):
            writer.write(link, make_ping(ping_id=index, start_time=index), stamp_ns)
    assert [step.wait_ns for step in MessageSource(path)] == [0, 70_000_000, 20_000_000]


def test_the_pace_is_the_sonars_own_where_nobody_noted_times(capture_path: Path) -> None:
    assert [step.wait_ns for step in MessageSource(capture_path)] == [0, 500_017_040, 500_016_776]


def test_the_pace_goes_on_where_the_recording_begins_again(capture_path: Path) -> None:
    device = PlaybackDevice(MessageSource(capture_path), loops=2)
    waits = []
    while not device.ended:
        waits.append(device.wait_ns())
        device.take()
    assert [round(wait / 1e6) for wait in waits] == [0, 500, 500, 500, 500, 500]


def test_times_that_cannot_be_give_the_usual_pace(make_ping: Callable[..., bytes]) -> None:
    times = (5.0, 4.0, float("nan"), 6.0)
    pings = [make_ping(ping_id=index, start_time=time) for index, time in enumerate(times)]
    assert [step.wait_ns for step in MessageSource(pings)] == [0, *[100_000_000] * 3]


@pytest.mark.parametrize(("rate", "wait_ms"), [(0, 100), (1, 67), (2, 30), (3, 200), (4, 500)])
def test_pings_come_no_faster_than_asked_for_and_no_faster_than_recorded(
    make_ping: Callable[..., bytes], rate: int, wait_ms: int
) -> None:
    pings = [make_ping(ping_id=index, start_time=1.0 + 0.03 * index) for index in range(2)]
    device = played(pings, encode_fire(ping_rate=rate))
    device.take()
    assert round(device.wait_ns() / 1e6) == wait_ms


def test_a_ping_rate_that_nobody_knows_is_as_recorded(make_ping: Callable[..., bytes]) -> None:
    pings = [make_ping(ping_id=index, start_time=1.0 + 0.03 * index) for index in range(2)]
    device = played(pings, encode_fire(ping_rate=195))  # quirk 2
    device.take()
    assert round(device.wait_ns() / 1e6) == 30


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(("flags", "beams"), [(0x09, 256), (0x49, 512)])
def test_the_result_has_the_version_and_the_beams_of_the_fire_message(
    capture: bytes, version: int, flags: int, beams: int
) -> None:  # quirk 14
    fire = encode_fire(version=version, flags=flags, range_demand=2.0, mode=2)
    ping = taken(played([capture[:182016]], fire, resampled=True))
    assert (ping.version, ping.beams, ping.gains) == (version, beams, None)
    assert np.degrees(ping.bearings_rad[[0, -1]]) == pytest.approx([-30.0, 30.0])
    assert ping.image[:, 0].tolist() == [*np.frombuffer(capture, "u1", 703 * 256, 2048)[::256], 0]
    assert ping.warnings == frozenset()


@pytest.mark.parametrize(
    ("flags", "extended", "bits"), [(0x0D, 0, 8), (0x0F, 0, 16), (0x0F, 0x200, 32)]
)
def test_samples_have_the_width_asked_for_and_rows_their_gains(
    capture: bytes, flags: int, extended: int, bits: int
) -> None:  # quirks 10, 11
    fire = encode_fire(flags=flags, extended_flags=extended, range_demand=2.0, mode=2)
    ping = taken(played([capture[:182016]], fire, resampled=True))
    assert ping.bits_per_sample == bits
    assert ping.gains is not None
    full = (1 << bits) - 1
    assert int(ping.image[100, 100]) * 255 == 5 * full
    assert int(ping.image[351, 128]) * 255 == 149 * full


@pytest.mark.parametrize(
    ("range_m", "rows", "times"),
    [(0.5, 176, 1), (2.0, 704, 1), (3.0, 528, 2), (4.0, 704, 2), (5.0, 440, 4), (10.0, 440, 8)],
)
def test_rows_follow_the_range_by_powers_of_two(
    capture: bytes, range_m: float, rows: int, times: int
) -> None:  # quirk 25
    fire = encode_fire(range_demand=range_m, mode=2)
    ping = taken(played([capture[:182016]], fire, resampled=True))
    assert (ping.rows, ping.range_resolution_m) == (rows, 0.0028421889710794315 * times)
    assert ping.max_range_m == pytest.approx(range_m, abs=ping.range_resolution_m)


def test_a_range_beyond_the_model_is_cut(capture: bytes) -> None:  # quirk 24
    ping = taken(played([capture[:182016]], encode_fire(range_demand=70.0, mode=2), resampled=True))
    assert ping.max_range_m == pytest.approx(40.0, abs=0.1)  # taken for an M750d


def test_a_range_in_percent_is_of_the_models_largest(capture: bytes) -> None:  # quirk 29
    fire = encode_fire(range_demand=50.0, flags=0x48, mode=1)
    ping = taken(played([capture[:182016]], fire, resampled=True))
    assert ping.max_range_m == pytest.approx(60.0, abs=0.1)


def test_the_echo_is_as_doubtful_as_real_ones(capture: bytes) -> None:
    fire = encode_fire(range_demand=2.0, mode=2, gamma=127, speed_of_sound_demand_mps=0.0)
    device = played([capture[:182016]], fire, resampled=True)
    data, _ = device.take()
    assert (data[17], data[18]) == (195, 25)  # quirks 2, 3
    (message,) = StreamParser().feed(data)
    ping = decode_ping(message)
    assert isinstance(ping, Ping)
    assert (ping.gamma, ping.mode) == (127, 2)
    assert ping.speed_of_sound_mps == 1490.658551265436  # quirk 4


def test_the_same_number_gives_the_same_faults(make_ping: Callable[..., bytes]) -> None:
    faults = Faults(cut=0.2, flip=0.3, lose=0.1, garbage=0.2, stall=0.1, seed=7)
    data = make_ping()
    runs = [
        [(dice.before_ping(), dice.apply(data)) for _ in range(200)]
        for dice in (FaultInjector(faults), FaultInjector(faults))
    ]
    assert runs[0] == runs[1]
    changed = [deed for _, deed in runs[0] if deed.damaged]
    assert 0.35 < len(changed) / 200 < 0.65
    assert all(deed.data != data for deed in changed)
    assert all(deed.data == data for _, deed in runs[0] if not deed.damaged)


@pytest.mark.parametrize(
    ("asked", "metres"),
    [(np.nan, 0.1), (-np.inf, 0.1), (np.inf, 120.0), (1e300, 120.0), (7.5, 7.5)],
)
def test_whatever_range_is_asked_for_is_one_that_the_model_has(asked: float, metres: float) -> None:
    assert requested_range_m(FireRequest(range_demand=asked), 1032) == metres
