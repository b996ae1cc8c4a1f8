"""Cut a dive anywhere: what was saved, and the rest, give what the whole dive gives, to the bit."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.odometry.bridge import ENCODING_PREFIX
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import (
    PingStream,
    PingStreamState,
    SessionDecoder,
    SessionDecoderState,
)
from mapperd.pipeline.pose_lookup import OdometryPoses, PoseLookupState, ping_time_ns
from mapperd.store.checkpoint import decode_state, encode_state
from oculus_driver.clock import SonarClock, SonarClockState
from oculus_driver.ping import Ping
from oculus_driver.recording import Chunk
from tests.mapperd.store.checkpoint_streams import FORMATS, chunks_of


class State(NamedTuple):
    poses: PoseLookupState
    stream: PingStreamState
    clocks: dict[int, SonarClockState]


class Estimators:
    """All that lies between the bytes and a ping with its pose."""

    def __init__(self, config: Config) -> None:
        self.poses = OdometryPoses(config)
        self.stream = PingStream()
        self.clocks: dict[int, SonarClock] = {}

    def save(self) -> bytes:
        clocks = {source_id: clock.state() for source_id, clock in self.clocks.items()}
        return encode_state(State(self.poses.state(), self.stream.state(), clocks))

    def restore(self, data: bytes) -> "Estimators":
        poses, stream, clocks = decode_state(data, State)
        self.poses.restore(poses)
        self.stream.restore(stream)
        for source_id, clock in clocks.items():
            self.clocks[source_id] = SonarClock()
            self.clocks[source_id].restore(clock)
        return self

    def take(self, chunk: Chunk) -> list[Any]:
        if chunk.encoding.startswith(ENCODING_PREFIX):
            self.poses.add_odometry(
                chunk.link,
                chunk.data,
                chunk.arrival_ns,
                encoding=chunk.encoding,
                gap_before=chunk.gap_before,
            )
        else:
            for _, ping, _ in self.stream.feed(chunk.link, chunk.data, chunk.arrival_ns):
                assert isinstance(ping, Ping)
                clock = self.clocks.setdefault(ping.source_id, SonarClock())
                self.poses.add_ping(ping, ping_time_ns(ping, clock))
        return self.settled(chunk.arrival_ns)

    def settled(self, now_ns: int | None, *, final: bool = False) -> list[Any]:
        return [bits(*pair) for pair in self.poses.resolved(now_ns, final=final)]

    def rest(self, chunks: Iterable[Chunk]) -> list[Any]:
        out = [one for chunk in chunks for one in self.take(chunk)]
        return [*out, *self.settled(None, final=True), self.poses.odometry.status()]


def bits(ping: Ping, pose: Any) -> tuple[Any, ...]:
    if not isinstance(pose, FusedPose):
        return ping.ping_id, ping.image.tobytes(), pose
    held = (pose.pose.position_m, pose.pose.map_q_base, pose.velocity_mps, pose.rate_radps)
    arrays = [None if one is None else np.asarray(one).tobytes() for one in held]
    image, covariance = ping.image.tobytes(), pose.covariance.tobytes()
    return ping.ping_id, image, arrays, covariance, pose.segment, pose.reckoned_s


SETTINGS = {
    "plain": "",
    "levelled": "world_init: {enabled: true, init_samples: 5, max_spread: 10, max_rate: 90}",
    "recent": "time_sync: {policy: nearest}\nodometry: {at_jump: follow}",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_every_format(name: str) -> None:
    config, chunks = Config(), chunks_of(name)
    whole = Estimators(config)
    outs: list[Any] = []
    saves = []
    for chunk in chunks:
        saves.append((len(outs), whole.save()))
        outs += whole.take(chunk)
    outs += whole.rest([])
    assert sum(len(one) > 3 for one in outs[:-1]) > 10  # pings with a pose
    for at, (before, saved) in list(enumerate(saves))[:: 1 + len(saves) // 60]:
        again = Estimators(config).restore(saved)
        assert again.save() == saved
        assert again.rest(chunks[at:]) == outs[before:], at


@pytest.mark.slow
@pytest.mark.parametrize("text", SETTINGS.values(), ids=SETTINGS)
def test_other_settings(text: str) -> None:
    config = config_from_text(text)
    chunks = chunks_of("native_serial")
    for at in range(0, len(chunks), 9):
        whole = Estimators(config)
        for chunk in chunks[:at]:
            whole.take(chunk)
        again = Estimators(config).restore(whole.save())
        assert again.rest(chunks[at:]) == whole.rest(chunks[at:])


def test_the_whole_engine_with_the_sonars_clock_and_every_third_ping() -> None:
    config = config_from_text("processing: {frame_skip: 3}")
    chunks = chunks_of("native")

    def engine_of() -> SessionDecoder:
        poses = OdometryPoses(config)
        return SessionDecoder(config, poses, PipelineCounters(), confirm=False, obey=True)

    def works(engine: SessionDecoder, some: Iterable[Chunk]) -> list[Any]:
        settled: list[Any] = [work for chunk in some for work in engine.feed(chunk)] + engine.end()
        placed = [clock.placed for clock in engine.clocks.values()]
        return [(one.number, one.complete_ns, bits(one.ping, one.pose)) for one in settled] + placed

    truth = works(engine_of(), chunks)
    assert len(truth) > 10
    for at in range(0, len(chunks), 7):
        cut = engine_of()
        before = [work for chunk in chunks[:at] for work in cut.feed(chunk)]
        again = engine_of()
        again.restore(decode_state(encode_state(cut.state()), SessionDecoderState))
        assert works(again, chunks[at:]) == truth[len(before) :], at
