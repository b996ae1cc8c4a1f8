from collections.abc import Callable

from mapperd.errors import Reject
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import Arrival, PingStream
from oculus_driver.encode import encode_dummy
from oculus_driver.ping import Ping
from oculus_driver.wire import HEADER, MessageId

PingBytes = Callable[..., bytes]


def outcome(arrival: Arrival) -> int | str:
    ping = arrival.ping
    return ping.reason if isinstance(ping, Reject) else ping.ping_id


def test_pings_come_out_with_their_arrival(ping_bytes: PingBytes) -> None:
    data = ping_bytes(1) + encode_dummy(source_id=7) + ping_bytes(2)
    stream = PingStream()
    arrivals = [*stream.feed("sonar", data[:5000], 10), *stream.feed("sonar", data[5000:], 20)]
    assert [outcome(each) for each in arrivals] == [1, 2]
    assert [arrival.arrival_ns for arrival in arrivals] == [10, 20]
    assert isinstance(arrivals[0][1], Ping)


def test_duplicates_are_reported_once(ping_bytes: PingBytes) -> None:
    stream = PingStream()
    data = b"".join(ping_bytes(number) for number in (1, 1, 2, 5))
    assert [outcome(each) for each in stream.feed("sonar", data, 0)] == [1, "duplicate", 2, 5]
    counters = PipelineCounters()
    stream.count(counters)
    assert counters.pings_lost == 2


def test_second_sonar_is_not_mixed_in(ping_bytes: PingBytes) -> None:
    stream = PingStream()
    assert [outcome(each) for each in stream.feed("bow", ping_bytes(1), 0)] == [1]
    assert [outcome(each) for each in stream.feed("stern", ping_bytes(9), 1)] == ["other_link"]
    assert [outcome(each) for each in stream.feed("bow", ping_bytes(2), 2)] == [2]


def test_links_are_parsed_apart_and_their_bytes_added_up(ping_bytes: PingBytes) -> None:
    stream, data = PingStream(), ping_bytes(1)
    assert list(stream.feed("bow", data[:100], 0)) == []
    assert list(stream.feed("stern", b"x" * 50, 0)) == []
    assert [outcome(each) for each in stream.feed("bow", data[100:], 1)] == [1]
    assert list(stream.finish()) == []
    counters = PipelineCounters()
    stream.count(counters)
    assert counters.bytes_total == len(data) + 50
    assert counters.bytes_rejected == 50
    assert counters.resyncs == 1


def test_message_that_is_no_ping_after_all_is_a_reject(ping_bytes: PingBytes) -> None:
    stream = PingStream()
    bad = ping_bytes(1, range_resolution_m=float("nan"))
    (arrival,) = stream.feed("sonar", bad, 0)
    assert outcome(arrival) == "bad_resolution"


def test_dropped_messages_are_not_counted_as_lost_too(ping_bytes: PingBytes) -> None:
    stream = PingStream()
    strange = bytearray(ping_bytes(4))
    strange[8] = 9  # a version that nobody knows: its ping number cannot be read
    data = [
        ping_bytes(1),
        ping_bytes(2, range_resolution_m=float("nan")),
        ping_bytes(3),
        bytes(strange),
        ping_bytes(6),
        ping_bytes(6, range_resolution_m=float("nan")),
        ping_bytes(7),
    ]
    came = [outcome(each) for each in stream.feed("sonar", b"".join(data), 0)]
    assert came == [1, "bad_resolution", 3, "unknown_version", 6, "bad_resolution", 7]
    counters = PipelineCounters()
    stream.count(counters)
    assert counters.pings_lost == 1


def test_recording_s_ping_that_lost_bytes_is_refused_and_the_next_one_found(
    ping_bytes: PingBytes,
) -> None:
    first, cut, last = (ping_bytes(number) for number in (1, 2, 3))
    stream = PingStream(confirm=True)
    data = first + cut[:1000] + cut[1500:] + last
    came = [*stream.feed("sonar", data, 0), *stream.finish()]
    assert [outcome(each) for each in came] == [1, 3]
    counters = PipelineCounters()
    stream.count(counters)
    assert counters.messages_rejected == {"bytes_missing": 1}
    assert counters.bytes_rejected == len(cut) - 500


def test_ping_without_a_message_behind_it_is_taken_and_called_doubtful(
    ping_bytes: PingBytes,
) -> None:
    stream = PingStream(confirm=True)
    data = ping_bytes(1) + b"\x12" * 777 + ping_bytes(2)
    came = [*stream.feed("sonar", data, 0), *stream.finish()]
    assert [outcome(each) for each in came] == [1, 2]
    counters = PipelineCounters()
    stream.count(counters)
    assert counters.messages_doubtful == {"unconfirmed_end": 1}
    assert counters.bytes_rejected == 777


def test_known_gap_in_a_recording_starts_the_parser_again(ping_bytes: PingBytes) -> None:
    stream = PingStream(confirm=True)
    came = [
        *stream.feed("sonar", ping_bytes(1)[:2000], 0),
        *stream.feed("sonar", ping_bytes(3), 1, gap_before=True),
        *stream.finish(),
    ]
    assert [outcome(each) for each in came] == [3]


def test_full_ping_results_are_counted_and_not_mapped(ping_bytes: PingBytes) -> None:
    header = {"message_id": MessageId.FULL_PING_RESULT, "source_id": 7, "payload_size": 584}
    full = HEADER.pack(header) + bytes(584)
    stream = PingStream()
    data = ping_bytes(1) + full + ping_bytes(2)
    assert [outcome(each) for each in stream.feed("sonar", data, 0)] == [1, "full_ping", 2]
