"""A client of the map stream fed by a test, and another decoder of messages."""

import asyncio
from collections.abc import AsyncIterator, Collection, Mapping
from functools import cache
from typing import Any

import numpy as np
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from numpy.typing import NDArray

from mapperd.client.changes import ClientChange, ConnectionStatus, LinkChanged, MapChanged, MapReset
from mapperd.client.mirror import MapMirror
from mapperd.client.validation import AskError
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet, path_message
from mapperd.wire.messages import (
    EventMessage,
    FanMessage,
    ImageMessage,
    Interest,
    LocalizationMessage,
    MapInfo,
    PathMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
    WelcomeMessage,
)

T0 = 1_790_000_000_000_000_000
S = 1_000_000_000

MAP_INFO = MapInfo(
    id="one",
    resolution_m=0.25,
    log_odds_step=0.25,
    occupied_log_odds=0.5,
    free_log_odds=-0.5,
    frame="map",
)
CONNECTED = ConnectionStatus("connected", "/run/map.sock", "", 0.0, connects=1, bytes=10)

POSE = PoseMessage(
    stamp_ns=T0 + 5,
    position_m=(10.0, 20.0, -3.0),
    orientation_xyzw=(0.0, 0.0, 0.5**0.5, 0.5**0.5),  # a quarter turn to port
    sonar_position_m=(9.5, 21.0, -3.5),  # 1 m ahead, 0.5 m to port, 0.5 m below
    sonar_orientation_xyzw=(0.5, -0.5, 0.5, 0.5),
    velocity_mps=(0.0, 1.5, 0.0),
    covariance=tuple(float(k) for k in range(36)),
)
FAN = FanMessage(
    bearings_rad=(-1.0, 1.0), vertical_aperture_rad=0.35, min_range_m=0.5, max_range_m=20.0
)
RETURNS = ReturnsMessage(
    stamp_ns=T0 + 6,
    ping_id=1,
    sonar_position_m=POSE.sonar_position_m,
    sonar_orientation_xyzw=POSE.sonar_orientation_xyzw,
    points=np.array([[1, 2, 3], [4, 5, 6]], "<f4").tobytes(),
    intensities=bytes([7, 200]),
)
PIXELS = np.arange(12, dtype=np.uint8).reshape(4, 3)
IMAGE = ImageMessage(
    stamp_ns=T0 + 7,
    ping_id=1,
    rows=4,
    beams=3,
    range_resolution_m=0.5,
    bearings_rad=np.array([-0.5, 0.0, 0.5], "<f4").tobytes(),
    body=zstandard.ZstdCompressor().compress(PIXELS.tobytes()),
)
ROBOTS = RobotsMessage(seen=[(T0 - 3 * S, 1.0, 2.0, 3.0)])
LOCALIZATION = LocalizationMessage(
    report={
        "state": "localized",
        "pose": {
            "x_m": 1.0,
            "y_m": 2.0,
            "yaw_rad": 0.5,
            "covariance": [[4.0, 0, 0], [0, 1.0, 0], [0, 0, 0.1]],
        },
    },
    particles=np.array([[1, 2, 0.5, 0.7], [3, 4, 1.5, 0.3]], "<f4").tobytes(),
    scan=np.array([[1, 2, 3]], "<f4").tobytes(),
)
STATUS = StatusMessage(stamp_ns=T0 + 8, status={"phase": "mapping"}, link={"left": 3})
EVENT = EventMessage(
    event={
        "number": 1,
        "t_s": T0 / S,
        "severity": "warning",
        "code": "sonar_link",
        "text": "sonar lost",
        "facts": {},
    },
    lost=2,
)
SETTINGS = SettingsMessage(
    facts={
        "filtering.min_range": {"value": 1.5, "dynamic": True},
        "filtering.intensity_threshold": {"value": 50, "dynamic": True},
        "octree.voxel_resolution": {"value": 0.25, "dynamic": False},
        "frames.sonar": {"value": "oculus", "dynamic": False},
    }
)
WAY = np.arange(30, dtype=np.float64).reshape(10, 3)


class FakeStream:
    """Has all that a client has; `feed` makes it know something."""

    def __init__(self) -> None:
        self.mirror: MapMirror | None = MapMirror(MAP_INFO, Interest())
        self.link = CONNECTED
        self.welcome: WelcomeMessage | None = None
        self.pose: PoseMessage | None = None
        self.path: NDArray[np.float64] = np.zeros((0, 3))
        self.fan: FanMessage | None = None
        self.returns: ReturnsMessage | None = None
        self.image: ImageMessage | None = None
        self.robots: RobotsMessage | None = None
        self.localization: LocalizationMessage | None = None
        self.status: StatusMessage | None = None
        self.settings: dict[str, Any] = {}
        self.wants: Collection[str] = ()
        self.asked: list[dict[str, Any]] = []
        self.error: Exception | None = None
        self._waiting: asyncio.Queue[ClientChange | None] = asyncio.Queue()

    def feed(self, change: ClientChange | None) -> None:
        """None is the end."""
        if isinstance(change, LinkChanged):
            self.link = change.link
        elif isinstance(change, SettingsMessage):
            self.settings = {**self.settings, **change.facts}
        elif isinstance(change, PathMessage):
            self.path = WAY
        elif not isinstance(change, EventMessage | MapReset | MapChanged | None):
            setattr(self, str(change.__struct_config__.tag), change)
        self._waiting.put_nowait(change)

    def feed_all(self) -> None:
        """One of each."""
        for change in (
            LinkChanged(CONNECTED),
            MapReset(MAP_INFO),
            SETTINGS,
            FAN,
            path_message(0, WAY),
            POSE,
            RETURNS,
            IMAGE,
            ROBOTS,
            LOCALIZATION,
            STATUS,
            EVENT,
        ):
            self.feed(change)

    def occupy(self, key: tuple[int, int, int], cells: Mapping[int, int], stamp_ns: int) -> None:
        """A block has these cells; without any it is unknown."""
        assert self.mirror is not None
        self.mirror.put(block(key, cells), stamp_ns)
        self.feed(MapChanged(np.array([key], np.int32), stamp_ns, 0))

    @property
    def unread(self) -> int:
        """Changes that nobody took yet."""
        return self._waiting.qsize()

    async def changes(self) -> AsyncIterator[ClientChange]:
        while (change := await self._waiting.get()) is not None:
            yield change
        if self.error is not None:
            raise self.error

    async def set(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        self.asked.append(dict(changes))
        if any(value == "wrong" for value in changes.values()):
            raise AskError("refused", "not in range")
        return {name: [self.settings[name]["value"], value] for name, value in changes.items()}

    async def change(self, *, wants: Collection[str]) -> None:
        self.wants = wants


def block(key: tuple[int, int, int], cells: Mapping[int, int]) -> BlockSet:
    plane = np.full((1, CELLS), UNKNOWN, np.int8)
    for at, value in cells.items():
        plane[0, at] = value
    return BlockSet(np.array([key], np.int32), np.zeros(1, np.uint32), plane)


@cache
def message_class(schema: bytes, name: str) -> Any:
    """Of a schema as it stands in a file or is advertised: a set of protobuf descriptors."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def points_of_cloud(cloud: Any) -> NDArray[np.void]:
    """The rows of a foxglove.PointCloud, by its own description of them."""
    types = {1: "u1", 5: "<u4", 7: "<f4"}
    kind = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [types[field.type] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_stride,
        }
    )
    return np.frombuffer(cloud.data, kind)
