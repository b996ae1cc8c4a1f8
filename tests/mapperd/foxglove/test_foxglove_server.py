"""Viewers are served what the client receives; they are plain WebSocket clients here."""

import asyncio
import base64
import json
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus

from mapperd.client.changes import ConnectionStatus, LinkChanged
from mapperd.errors import LiveError
from mapperd.foxglove import server
from mapperd.foxglove.channels import CHANNELS
from mapperd.foxglove.server import serve
from mapperd.wire.messages import SettingsMessage, StatusMessage
from tests.mapperd.foxglove.foxglove_fakes import (
    POSE,
    T0,
    FakeStream,
    S,
    message_class,
    points_of_cloud,
)
from tests.support.waiting import until

pytestmark = pytest.mark.net


class Viewer:
    """What Foxglove would do, by its protocol."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.channels: dict[str, Any] = {}
        self.texts: list[Any] = []
        self.messages: list[tuple[str, int, bytes]] = []
        self.times: list[int] = []
        self._topics: dict[int, str] = {}

    async def ask(self, op: str, **fields: Any) -> None:
        await self._socket.send(json.dumps({"op": op, **fields}))

    async def watch(self, *topics: str) -> None:
        await self.hear(lambda: all(topic in self.channels for topic in topics))
        chosen = []
        for topic in topics:
            number = len(self._topics) + 1
            self._topics[number] = topic
            chosen.append({"id": number, "channelId": self.channels[topic]["id"]})
        await self.ask("subscribe", subscriptions=chosen)

    async def hear(self, enough: Callable[[], Any]) -> None:
        """Read until it is enough."""
        async with asyncio.timeout(20):
            while not enough():
                self._take(await self._socket.recv())

    async def of(self, op: str, ident: str | None = None) -> Any:
        """The next text of a kind."""
        found: list[Any] = []

        def look() -> list[Any]:
            found.extend(
                text
                for text in self.texts
                if text["op"] == op and (ident is None or text.get("id") == ident)
            )
            return found

        await self.hear(look)
        self.texts.remove(found[0])
        return found[0]

    def newest(self, topic: str) -> Any:
        """Decoded by the schema that was advertised."""
        channel = self.channels[topic]
        data = next(data for name, _, data in reversed(self.messages) if name == topic)
        if channel["encoding"] == "json":
            return json.loads(data)
        schema = base64.b64decode(channel["schema"])
        return message_class(schema, channel["schemaName"]).FromString(data)

    def count(self, topic: str) -> int:
        return [name for name, _, _ in self.messages].count(topic)

    def _take(self, message: str | bytes) -> None:
        if isinstance(message, str):
            text = json.loads(message)
            if text["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in text["channels"]}
            self.texts.append(text)
        elif message[0] == 1:
            number, time_ns = struct.unpack_from("<IQ", message, 1)
            self.messages.append((self._topics[number], time_ns, message[13:]))
        elif message[0] == 2:
            self.times.append(struct.unpack_from("<Q", message, 1)[0])


@asynccontextmanager
async def viewer(port: int) -> AsyncIterator[Viewer]:
    uri = f"ws://127.0.0.1:{port}"
    async with connect(uri, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:  # type: ignore[list-item]
        yield Viewer(socket)


def served(
    changing: Callable[[FakeStream, int], Awaitable[None]], *, may_change: bool = True
) -> None:
    """Serve while something is done."""

    async def run() -> None:
        client, ports = FakeStream(), list[int]()
        serving = asyncio.create_task(
            serve(client, "127.0.0.1", 0, ports.append, may_change=may_change)
        )
        try:
            await until(lambda: ports)
            await changing(client, ports[0])
        finally:
            serving.cancel()
            await asyncio.wait((serving,))
        if not serving.cancelled():
            serving.result()

    asyncio.run(run())


def test_all_channels_are_advertised() -> None:
    async def changing(_: FakeStream, port: int) -> None:
        async with viewer(port) as eye:
            info = await eye.of("serverInfo")
            await eye.hear(lambda: len(eye.channels) == len(CHANNELS))
        assert {"parameters", "time"} <= set(info["capabilities"])
        advertised = {topic: channel["schemaName"] for topic, channel in eye.channels.items()}
        assert advertised == {channel.topic: channel.schema_name for channel in CHANNELS}

    served(changing)


def test_an_older_viewers_protocol_is_refused() -> None:
    async def changing(_: FakeStream, port: int) -> None:
        with pytest.raises(InvalidStatus, match="400"):
            await connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.websocket.v1"])  # type: ignore[list-item]

    served(changing)


def test_a_late_viewer_sees_the_map_as_the_mirror_has_it() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        client.feed_all()
        rng = np.random.default_rng(1)
        for x in range(3):
            client.occupy((x, -1, 0), {int(k): 8 for k in rng.integers(0, 512, 60)}, T0 + 9)
        await until(lambda: not client.unread)
        async with viewer(port) as eye:
            await eye.watch("/map")
            await eye.hear(lambda: eye.count("/map"))
        cloud = eye.newest("/map")
        rows = points_of_cloud(cloud)
        assert client.mirror is not None
        cells = client.mirror.cells()
        got = np.stack([rows[name] for name in ("x", "y", "z", "probability")], axis=1)
        want = np.column_stack([cells.centres_m, cells.probability]).astype(np.float32)
        assert len(want) > 100
        assert _sorted(got).tobytes() == _sorted(want).tobytes()
        assert (cloud.frame_id, cloud.timestamp.seconds) == ("map", T0 // S)

    served(changing)


def test_what_does_not_change_is_reported_to_every_new_viewer() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        client.feed_all()
        client.occupy((0, 0, 0), {0: 8}, T0 + 9)
        await until(lambda: not client.unread)
        topics = ("/map", "/path", "/fan", "/settings")
        for _ in range(2):
            async with viewer(port) as eye:
                await eye.watch(*topics)
                await eye.hear(lambda eye=eye: all(map(eye.count, topics)))  # type: ignore[misc]

    served(changing)


def _sorted(rows: Any) -> Any:
    return np.ascontiguousarray(rows[np.lexsort(rows.T)])


def test_viewers_see_what_they_watch_and_the_daemons_time() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        async with viewer(port) as one, viewer(port) as other:
            await one.watch("/pose", "/tf")
            await other.watch("/status", "/fan", "/path", "/robots", "/log", "/settings")
            await asyncio.gather(one.of("serverInfo"), other.of("serverInfo"))
            client.feed_all()
            await one.hear(lambda: one.count("/tf") and one.count("/pose"))
            await other.hear(
                lambda: {"/fan", "/path", "/robots"} <= {name for name, *_ in other.messages}
            )
            await one.hear(lambda: one.times)
        assert one.newest("/pose").pose.position.y == 20.0
        assert {name for name, *_ in one.messages} == {"/pose", "/tf"}
        assert T0 <= one.times[-1] < T0 + S
        map_to_base, base_to_sonar = one.newest("/tf").transforms
        assert (map_to_base.parent_frame_id, map_to_base.child_frame_id) == ("map", "base_link")
        lever = base_to_sonar.translation
        assert (lever.x, lever.y, lever.z) == pytest.approx((1.0, 0.5, -0.5))
        assert base_to_sonar.child_frame_id == "oculus"

    served(changing)


def test_costly_kinds_are_wanted_only_while_somebody_watches() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        async with viewer(port) as eye:
            await eye.watch("/sonar/fan", "/returns")
            await until(lambda: "image" in client.wants and "returns" in client.wants)
            assert "localization" not in client.wants
        await until(lambda: "image" not in client.wants)
        assert set(client.wants) == set(server.FIRST_WANTS)

    served(changing)


def test_parameters_go_both_ways() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        client.feed_all()
        await until(lambda: not client.unread)
        async with viewer(port) as eye:
            await eye.ask("getParameters", parameterNames=[], id="all")
            assert _values(await eye.of("parameterValues", "all")) == {
                "filtering.min_range": 1.5,
                "filtering.intensity_threshold": 50,
            }
            one = [{"name": "filtering.min_range", "value": 2.25, "type": "float64"}]
            await eye.ask("setParameters", parameters=one, id="set")
            answer = await eye.of("parameterValues", "set")
            assert _values(answer) == {"filtering.min_range": 2.25}
            assert client.asked == [{"filtering.min_range": 2.25}]
            whole = [{"name": "filtering.intensity_threshold", "value": 60.0, "type": "float64"}]
            await eye.ask("setParameters", parameters=whole, id="whole")
            await eye.of("parameterValues", "whole")
            assert repr(client.asked[1]) == "{'filtering.intensity_threshold': 60}"
            await eye.ask("subscribeParameterUpdates", parameterNames=["filtering.min_range"])
            await eye.ask("getParameters", parameterNames=["filtering.min_range"], id="now")
            await eye.of("parameterValues", "now")
            eye.texts.clear()
            client.feed(
                SettingsMessage(facts={"filtering.min_range": {"value": 3.5, "dynamic": True}})
            )
            update = await eye.of("parameterValues")
            assert _values(update) == {"filtering.min_range": 3.5}

    served(changing)


def test_a_refused_parameter_goes_back_with_a_warning() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        client.feed_all()
        await until(lambda: not client.unread)
        async with viewer(port) as eye:
            await eye.watch("/log")
            for name, why in (
                ("filtering.min_range", "not in range"),
                ("octree.voxel_resolution", "not a live setting"),
            ):
                one = [{"name": name, "value": "wrong"}]
                await eye.ask("setParameters", parameters=one, id=name)
                answer = await eye.of("parameterValues", name)
                kept = {"filtering.min_range": 1.5} if why == "not in range" else {}
                assert _values(answer) == kept
                assert why in (await eye.of("status"))["message"]
            await eye.hear(lambda: eye.count("/log") == 2)
            assert "not a live setting" in eye.newest("/log").message
            assert eye.newest("/log").level == 3
            assert len(client.asked) == 1

    served(changing)


def test_viewers_may_look_and_change_nothing_where_it_is_not_allowed() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        client.feed_all()
        await until(lambda: not client.unread)
        async with viewer(port) as eye:
            one = [{"name": "filtering.min_range", "value": 2.5}]
            await eye.ask("setParameters", parameters=one, id="set")
            answer = await eye.of("parameterValues", "set")
            assert _values(answer) == {"filtering.min_range": 1.5}
            assert "--allow-changes" in (await eye.of("status"))["message"]
        assert client.asked == []

    served(changing, may_change=False)


def _values(answer: Any) -> dict[str, Any]:
    return {one["name"]: one["value"] for one in answer["parameters"]}


def test_a_lost_link_is_reported_and_taken_back() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        async with viewer(port) as eye:
            await eye.of("serverInfo")
            client.feed(LinkChanged(ConnectionStatus("waiting", "sub:1", "nobody answers", 0.0)))
            status = await eye.of("status")
            assert status["message"] == "waiting: sub:1 nobody answers"
            client.feed(LinkChanged(ConnectionStatus("connected", "sub:1", "", 0.0)))
            removed = await eye.of("removeStatus")
            assert removed["statusIds"] == [status["id"]]

    served(changing)


def test_a_daemons_clock_that_is_set_back_begins_a_session() -> None:
    async def changing(client: FakeStream, port: int) -> None:
        client.feed_all()
        await until(lambda: not client.unread)
        async with viewer(port) as eye:
            first = (await eye.of("serverInfo"))["sessionId"]
            await eye.watch("/status")
            client.feed(StatusMessage(stamp_ns=S))
            assert (await eye.of("serverInfo"))["sessionId"] != first
            await eye.hear(lambda: any(time_ns == S for _, time_ns, _ in eye.messages))
            client.feed(POSE)
            client.feed(StatusMessage(stamp_ns=T0 + S))
            await eye.hear(lambda: any(time_ns == T0 + S for _, time_ns, _ in eye.messages))

    served(changing)


def test_a_port_in_use_is_one_clear_error() -> None:
    async def changing(_: FakeStream, port: int) -> None:
        with pytest.raises(LiveError, match=f"127.0.0.1:{port}: cannot listen"):
            await serve(FakeStream(), "127.0.0.1", port)

    served(changing)
