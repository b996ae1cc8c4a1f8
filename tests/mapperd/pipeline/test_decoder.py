import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.geometry.frames import pose_from_rpy
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import NewSettings, PosedPing, SessionDecoder
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses, PoseLookup
from mapperd.session_log import Decision, Drop, Gap, Reset, Session, Settings, Skip, chunk_of
from mapperd.store.checkpoint import encode_state
from oculus_driver.link.receiver import PingReceiver
from oculus_driver.ping import Ping
from oculus_driver.recording import OCULUS, Chunk

MakeBytes = Callable[..., bytes]
T0 = 1_700_000_000_000_000_000
MS = 1_000_000


def engine_of(poses: PoseLookup | None = None, *, obey: bool = True) -> SessionDecoder:
    if poses is None:
        poses = FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0)))
    return SessionDecoder(Config(), poses, PipelineCounters(), confirm=False, obey=obey)


def sonar(data: bytes, t_ns: int = T0) -> Chunk:
    return Chunk("sonar", OCULUS, t_ns, data)


def numbers(work: list[Any]) -> list[int]:
    return [one.number for one in work if isinstance(one, PosedPing)]


def reported(engine: SessionDecoder, decision: Decision) -> list[Any]:
    return engine.feed(chunk_of(decision, T0))


def test_ping_comes_out_with_its_number_and_the_time_of_its_last_byte(
    ping_bytes: MakeBytes,
) -> None:
    engine, data = engine_of(), ping_bytes(1)
    assert engine.feed(sonar(data[:500], T0)) == []
    (posed,) = engine.feed(sonar(data[500:], T0 + 5 * MS))
    assert isinstance(posed, PosedPing)
    assert (posed.number, posed.complete_ns) == (0, T0 + 5 * MS)
    assert posed.ping.arrival_ns == T0


def test_numbers_count_every_ping_message(ping_bytes: MakeBytes) -> None:
    engine = engine_of()
    reported(engine, Settings({"processing.frame_skip": 2}))
    twice = ping_bytes(1)
    work = [engine.feed(sonar(data)) for data in (twice, twice, ping_bytes(2), ping_bytes(3))]
    assert [numbers(one) for one in work] == [[0], [], [], [3]]
    assert engine.counters.pings_dropped == {"duplicate": 1, "frame_skip": 1}
    assert engine.pings == engine.counters.pings_total == 4


def test_bytes_behind_a_gap_do_not_join_those_before_it(ping_bytes: MakeBytes) -> None:
    first, second = ping_bytes(1), ping_bytes(2)
    for gap in (Gap("sonar"), Skip("sonar", 7)):
        engine = engine_of()
        engine.feed(sonar(first[:-200]))
        reported(engine, gap)
        assert numbers(engine.feed(sonar(second)) + engine.feed(sonar(ping_bytes(3)))) == [0, 1]
        engine.end()
        assert engine.counters.messages_rejected == {"truncated": 1}


def test_gap_is_of_its_link_and_of_the_next_bytes_alone(ping_bytes: MakeBytes) -> None:
    engine = engine_of()
    reported(engine, Gap("vehicle"))
    data = ping_bytes(1)
    engine.feed(sonar(data[:100]))
    assert numbers(engine.feed(sonar(data[100:]))) == [0]
    reported(engine, Gap("sonar"))
    for piece in (ping_bytes(2)[:100], ping_bytes(2)[100:]):
        engine.feed(sonar(piece))
    engine.end()
    assert engine.counters.pings_total == 2
    assert engine.counters.bytes_rejected == 0


def test_orders_are_obeyed_where_they_stand(ping_bytes: MakeBytes) -> None:
    engine = engine_of()
    (settings,) = reported(engine, Settings({"filtering.min_range": 2.0}))
    assert isinstance(settings, NewSettings)
    assert settings.config.filtering.min_range == engine.config.filtering.min_range == 2.0
    assert reported(engine, Reset(4)) == [Reset(4)]
    assert reported(engine, Session("a", "1", {})) == []
    assert reported(engine, Drop(0)) == []
    assert numbers(engine.feed(sonar(ping_bytes(1)))) == [0]


def test_only_gaps_are_believed_where_decisions_are_not_obeyed(ping_bytes: MakeBytes) -> None:
    engine = engine_of(obey=False)
    assert reported(engine, Settings({"filtering.min_range": 2.0})) == []
    assert reported(engine, Reset(4)) == []
    data = ping_bytes(1)
    engine.feed(sonar(data[:100]))
    reported(engine, Skip("sonar", 5))
    assert numbers(engine.feed(sonar(data[100:]))) == [0]


def test_damaged_decisions_are_not_obeyed(ping_bytes: MakeBytes) -> None:
    engine = engine_of()
    before = engine.config
    for decision in (Settings({"filtering.min_range": 2.0}), Reset(4), Skip("sonar", 7)):
        assert engine.feed(replace(chunk_of(decision, T0), damaged=True)) == []
    assert engine.config == before
    assert engine.bytes_taken == 0
    data = ping_bytes(1)
    engine.feed(sonar(data[:100]))
    engine.feed(replace(chunk_of(Gap("sonar"), T0), damaged=True))  # nothing is joined over it
    assert numbers(engine.feed(sonar(data[100:])) + engine.end()) == []


def test_no_decision_settles_a_ping(ping_bytes: MakeBytes, odometry_bytes: MakeBytes) -> None:
    config = config_from_text("odometry: {sources: [{name: vehicle}]}")
    engine = engine_of(OdometryPoses(config))
    engine.feed(Chunk("vehicle", "odometry-native", T0, odometry_bytes()))
    engine.feed(sonar(ping_bytes(1), T0 + 50 * MS))
    assert engine.feed(chunk_of(Reset(1), T0 + 60_000 * MS)) == [Reset(1)]
    assert engine.waiting == 1
    assert numbers(engine.feed(sonar(b"x", T0 + 60_000 * MS))) == [0]


def test_place_in_the_stream_is_the_same_however_it_was_cut(ping_bytes: MakeBytes) -> None:
    whole, cut = engine_of(), engine_of()
    data = ping_bytes(1)
    for engine, skips in ((whole, [9]), (cut, [4, 5])):
        reported(engine, Session("a", "1", {}))
        for size in skips:
            reported(engine, Skip("sonar", size))
        reported(engine, Drop(3))
    whole.feed(sonar(data))
    cut.feed(sonar(data[:9]))
    cut.feed(sonar(data[9:]))
    assert (whole.bytes_taken, whole.orders_taken) == (len(data) + 9, 1)
    assert (cut.bytes_taken, cut.orders_taken) == (len(data) + 9, 1)


def test_a_ping_that_comes_late_is_of_the_time_when_it_was(ping: Callable[..., Ping]) -> None:
    times_ns: list[int | None] = []

    class Poses(FixedPose):
        def add_ping(self, ping: Ping, t_ns: int | None = None, *, damaged: bool = False) -> None:
            times_ns.append(t_ns)
            super().add_ping(ping, damaged=damaged)

    config = config_from_text("device: {latency_sec: 0.005}")
    poses = Poses(pose_from_rpy((0, 0, 0), (0, 0, 0)))
    engine = SessionDecoder(config, poses, PipelineCounters(), confirm=False, obey=True)
    late_ns = {40: 200_000_000}
    for k in range(1, 41):
        one = ping(k, 10**18 + 100_000_000 * k + late_ns.get(k, 0))
        engine.offer(one, engine._time_ns(one), None)
    # 5 m at 1500 m/s: the image's middle is met 1/4 of the way of the last echo.
    expected_ns = 10**18 + 4_000_000_000 - 5_000_000 - 0.75 * 2 * 5.0 / 1500.0 * 1e9
    assert times_ns[-1] is not None
    assert abs(times_ns[-1] - expected_ns) < 1e6


def test_checkpoints_with_the_drivers_messages_are_those_without_at_any_byte(
    ping_bytes: MakeBytes,
) -> None:
    chance = random.Random(5)  # noqa: S311 for the bytes
    driver, adopting, parsing = PingReceiver(), engine_of(), engine_of()
    for k in range(1, 40):
        data = ping_bytes(k) if k % 6 else ping_bytes(k)[: chance.randrange(3000)]
        t_ns = T0 + 100 * k * MS
        while data:
            size = chance.randrange(1, 3000)
            piece, data = data[:size], data[size:]
            if chance.random() < 0.05:
                driver.finish()
                adopting.feed(chunk_of(Gap("sonar"), t_ns))
                parsing.feed(chunk_of(Gap("sonar"), t_ns))
            driver.feed(piece, t_ns)
            found = adopting.feed(sonar(piece, t_ns), framing=driver.framing)
            assert numbers(found) == numbers(parsing.feed(sonar(piece, t_ns)))
            if chance.random() < 0.3:
                assert encode_state(adopting.state()) == encode_state(parsing.state())
    adopting.end()
    parsing.end()
    assert adopting.counters == parsing.counters
    assert adopting.counters.pings_total > 25
