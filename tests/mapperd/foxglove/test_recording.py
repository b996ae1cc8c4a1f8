"""Published messages are written, and read back by another reader."""

import asyncio
import errno
import json
import math
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader

from mapperd.client.changes import ConnectionStatus, LinkChanged, MapReset
from mapperd.errors import ExportError
from mapperd.foxglove import mcap_recorder
from mapperd.foxglove import mcap_recorder as mcap_file
from mapperd.foxglove.channels import CHANNELS
from mapperd.foxglove.map_publisher import PublishPace
from mapperd.foxglove.recording import FoxgloveRecording
from mapperd.wire.framing import StreamError
from tests.mapperd.foxglove.foxglove_fakes import (
    MAP_INFO,
    PIXELS,
    POSE,
    STATUS,
    T0,
    WAY,
    FakeStream,
    S,
    message_class,
    points_of_cloud,
)
from tests.support.waiting import until


def recorded(
    path: Path, changing: Callable[[FakeStream, FoxgloveRecording], Awaitable[None]]
) -> None:
    """Record while something is published."""

    async def run() -> None:
        client = FakeStream()
        recording = FoxgloveRecording(client, path)
        recording.start()
        try:
            await changing(client, recording)
        finally:
            await recording.stop()

    asyncio.run(run())


async def feed_all(client: FakeStream, recording: FoxgloveRecording) -> None:
    client.feed_all()
    client.occupy((0, 0, 0), {0: 8, 1: -8}, T0 + 9)
    before = recording.messages
    client.feed(STATUS)
    await until(lambda: recording.messages > before and not client.unread)


def read(path: Path) -> dict[str, list[tuple[Message, Any]]]:
    """Every topic's messages, decoded."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages: dict[str, list[tuple[Message, Any]]] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            messages.setdefault(channel.topic, []).append((message, decoded(schema, message)))
    return messages


def decoded(schema: Schema, message: Message) -> Any:
    if schema.encoding == "jsonschema":
        return json.loads(message.data)
    return message_class(schema.data, schema.name).FromString(message.data)


def occupied(messages: list[tuple[str, Any]]) -> dict[tuple[float, ...], float]:
    """Cells by their place, from whole maps and the changes after them."""
    cells: dict[tuple[float, ...], float] = {}
    for topic, cloud in messages:
        rows = points_of_cloud(cloud)
        if topic == "/map":
            cells.clear()
        for row in rows:
            place = (float(row["x"]), float(row["y"]), float(row["z"]))
            if topic == "/map_changes" and not row["occupied"]:
                assert cells.pop(place, None) is not None, "removed, and never published"
            else:
                cells[place] = float(row["probability"])
    return cells


def test_every_channel_is_in_the_file_with_its_schema(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_recorder, "RECORDING", PublishPace(shortest_s=0.0, share=math.inf))
    recorded(tmp_path / "a.mcap", feed_all)
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = {
        channel.topic: summary.schemas[channel.schema_id].name
        for channel in summary.channels.values()
    }
    wanted = {channel.topic: channel.schema_name for channel in CHANNELS}
    assert schemas == wanted
    assert sum(name.startswith("foxglove.") for name in schemas.values()) == len(wanted) - 3


def test_what_is_reported_is_what_is_written(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", feed_all)
    messages = read(tmp_path / "a.mcap")
    pose = MessageToDict(messages["/pose"][0][1])["pose"]
    assert pose["position"] == {"x": 10.0, "y": 20.0, "z": -3.0}
    odometry = messages["/odometry"][0][1]
    assert odometry.body_frame_id == "base_link"
    assert list(odometry.pose_covariance) == list(range(36))
    assert odometry.linear_velocity.x == pytest.approx(1.5)  # ahead, though north in the map
    assert odometry.linear_velocity.y == pytest.approx(0.0)
    polar = messages["/sonar/polar"][0][1]
    assert (polar.width, polar.height, polar.encoding, polar.step) == (3, 4, "mono8", 3)
    assert polar.data == PIXELS.tobytes()
    assert polar.frame_id == "oculus"
    returns = messages["/returns"][0][1]
    assert points_of_cloud(returns)["intensity"].tolist() == [7, 200]
    assert points_of_cloud(returns)["z"].tolist() == [3, 6]
    assert (returns.pose.position.x, returns.frame_id) == (9.5, "map")
    path = messages["/path"][-1][1].entities[0].lines[0].points
    np.testing.assert_array_equal([(p.x, p.y, p.z) for p in path], WAY)
    logs = [message for _, message in messages["/log"]]
    assert [(log.message, log.level) for log in logs[-2:]] == [
        ("2 events were lost", 3),
        ("sonar lost", 3),
    ]
    assert messages["/status"][-1][1]["daemon"] == {"phase": "mapping"}
    assert messages["/status"][-1][1]["connection"]["state"] == "connected"
    assert messages["/settings"][0][1]["filtering.min_range"] == 1.5
    particles = messages["/localization/particles"][0][1].poses
    assert [(p.position.x, p.position.z) for p in particles] == [(1.0, -3.0), (3.0, -3.0)]
    assert messages["/localization/report"][0][1]["state"] == "localized"


def test_stamps_are_the_daemons_and_logs_go_forward(tmp_path: Path) -> None:
    async def changing(client: FakeStream, recording: FoxgloveRecording) -> None:
        await feed_all(client, recording)
        before = recording.messages
        client.feed(POSE)  # older than what was published
        await until(lambda: recording.messages == before + 3)

    recorded(tmp_path / "a.mcap", changing)
    with (tmp_path / "a.mcap").open("rb") as file:
        messages = list(make_reader(file).iter_messages(log_time_order=False))
    times = [message.log_time for _, _, message in messages]
    assert times == sorted(times)
    assert min(times) >= T0
    assert max(times) < T0 + S
    for _, message in read(tmp_path / "a.mcap")["/pose"]:
        assert (message.timestamp.seconds, message.timestamp.nanos) == (T0 // S, 5)


def test_changes_after_a_whole_map_give_the_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_recorder, "RECORDING", PublishPace(shortest_s=0.0, share=math.inf))
    rng = np.random.default_rng(3)

    async def changing(client: FakeStream, recording: FoxgloveRecording) -> None:
        await feed_all(client, recording)
        for _ in range(150):
            await asyncio.sleep(0)
            x, y = (int(k) for k in rng.integers(-2, 3, 2))
            cells = {int(at): int(v) for at, v in rng.integers(-8, 9, (40, 2)) if at >= 0}
            client.occupy((x, y, 0), cells, T0 + 10)
        before = recording.messages
        client.feed(POSE)
        await until(lambda: recording.messages > before)
        wanted.update(_of_mirror(client))

    wanted: dict[tuple[float, ...], float] = {}
    recorded(tmp_path / "a.mcap", changing)
    order: list[tuple[str, Any]] = []
    with (tmp_path / "a.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.topic.startswith("/map"):
                assert schema is not None
                order.append((channel.topic, decoded(schema, message)))
    assert order.pop()[0] == "/map"  # of the end
    assert occupied(order) == wanted
    assert [topic for topic, _ in order].count("/map_changes") > 50
    assert len(wanted) > 50


def _of_mirror(client: FakeStream) -> dict[tuple[float, ...], float]:
    assert client.mirror is not None
    cells = client.mirror.cells()
    return {
        (x, y, z): p
        for (x, y, z), p in zip(
            cells.centres_m.astype(np.float32).tolist(), cells.probability.tolist(), strict=True
        )
    }


def test_a_file_that_was_never_ended_is_read_up_to_its_last_chunk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    monkeypatch.setattr(mcap_recorder, "RECORDING", PublishPace(shortest_s=0.0, share=math.inf))
    monkeypatch.setattr(mcap_recorder, "KEEP_S", 0.0)
    whole: list[bytes] = []

    async def changing(client: FakeStream, recording: FoxgloveRecording) -> None:
        await feed_all(client, recording)
        await until(lambda: path.stat().st_size == recording.bytes)
        whole.append(path.read_bytes())

    recorded(path, changing)
    topics = {channel.topic for channel in CHANNELS}
    assert _salvaged(whole[0], tmp_path) == topics
    assert _salvaged(whole[0] + path.read_bytes()[len(whole[0]) :][:30], tmp_path) == topics


def _salvaged(data: bytes, folder: Path) -> set[str]:
    """Topics of the messages before the file is cut."""
    cut = folder / "cut.mcap"
    cut.write_bytes(data)
    channels: dict[int, str] = {}
    topics: set[str] = set()
    with cut.open("rb") as file:
        records = StreamReader(file).records
        while True:
            try:
                record = next(records)
            except Exception:  # noqa: BLE001 whatever the reader raises for a cut file
                return topics
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message):
                topics.add(channels[record.channel_id])


def test_a_full_disk_is_one_clear_error_and_leaves_whole_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    monkeypatch.setattr(mcap_recorder, "KEEP_S", 0.0)
    good: list[bytes] = []

    class Full(mcap_file.ChunkFile):
        """Of a disk that has room again when it is too late."""

        def append_held(self) -> None:
            file, is_full = self._file, len(good) == 1
            if is_full:
                good.append(b"")
                self._file = _FullFile(file)  # type: ignore[assignment]
            try:
                super().append_held()
            finally:
                self._file = file

    async def changing(client: FakeStream, recording: FoxgloveRecording) -> None:
        await feed_all(client, recording)
        await until(lambda: path.stat().st_size == recording.bytes)
        good.append(path.read_bytes())
        client.feed(POSE)
        await until(lambda: recording.ended)

    monkeypatch.setattr(mcap_recorder, "ChunkFile", Full)
    with pytest.raises(ExportError, match=r"a\.mcap: .*No space left"):
        recorded(path, changing)
    assert path.read_bytes() == good[0]


class _FullFile:
    """Takes a few bytes more."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def write(self, data: Any) -> int:
        if len(data) < 10:
            raise OSError(errno.ENOSPC, "No space left on device")
        return int(self._file.write(data[: len(data) // 2]))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def test_attempts_to_connect_are_logged_once(tmp_path: Path) -> None:
    async def changing(client: FakeStream, recording: FoxgloveRecording) -> None:
        await feed_all(client, recording)
        for state, reason in (
            ("waiting", "nobody answers"),
            ("connecting", ""),
            ("waiting", "nobody answers"),
            ("waiting", "no route"),
            ("connected", ""),
        ):
            client.feed(LinkChanged(ConnectionStatus(state, "sub:1", reason, 0.0)))  # type: ignore[arg-type]
        await until(lambda: not client.unread)

    recorded(tmp_path / "a.mcap", changing)
    texts = [log.message for _, log in read(tmp_path / "a.mcap")["/log"]]
    assert texts[-3:] == [
        "waiting: sub:1 nobody answers",
        "waiting: sub:1 no route",
        "connected: sub:1",
    ]


def test_another_map_is_reported_as_one_that_is_empty(tmp_path: Path) -> None:
    async def changing(client: FakeStream, recording: FoxgloveRecording) -> None:
        await feed_all(client, recording)
        assert client.mirror is not None
        client.mirror.forget()
        before = recording.messages
        client.feed(MapReset(MAP_INFO))
        await until(lambda: recording.messages > before)
        client.occupy((4, 4, 4), {0: 8, 1: 8}, T0 + 11)
        await until(lambda: not client.unread)

    recorded(tmp_path / "a.mcap", changing)
    clouds = [cloud for _, cloud in read(tmp_path / "a.mcap")["/map"]]
    assert [len(points_of_cloud(cloud)) for cloud in clouds] == [1, 0, 2]


def test_a_file_that_is_there_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"mine")

    async def start() -> None:
        FoxgloveRecording(FakeStream(), path).start()

    with pytest.raises(ExportError, match="file exists"):
        asyncio.run(start())
    assert path.read_bytes() == b"mine"


def test_it_ends_with_the_client_and_reports_the_reason(tmp_path: Path) -> None:
    async def run() -> None:
        client = FakeStream()
        client.error = StreamError("no such token", "wrong_token")
        recording = FoxgloveRecording(client, tmp_path / "a.mcap")
        recording.start()
        client.feed_all()
        client.feed(None)
        with pytest.raises(StreamError, match="no such token"):
            await recording.wait()
        assert recording.ended

    asyncio.run(run())
    assert "/pose" in read(tmp_path / "a.mcap")
