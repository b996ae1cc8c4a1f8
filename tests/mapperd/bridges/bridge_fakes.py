"""A client of the map stream fed by a test, and state of a daemon that is sure."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import numpy as np

from mapperd.client.changes import ConnectionStatus, LinkChanged, MapReset
from mapperd.client.mirror import MapMirror
from mapperd.wire.messages import (
    Interest,
    LocalizationMessage,
    MapInfo,
    PoseMessage,
    ReturnsMessage,
    StatusMessage,
    WelcomeMessage,
)
from tests.mapperd.foxglove.foxglove_fakes import FakeStream

if TYPE_CHECKING:
    from mapperd.client.validation import AskError

T0 = 1_790_000_000_000_000_000
S = 1_000_000_000
INFO = MapInfo("one", 0.5, 0.25, 0.6, -0.6)


class BridgeStream(FakeStream):
    """Has all that a bridge needs; requests are kept in `requests`."""

    def __init__(self) -> None:
        super().__init__()
        self.mirror = MapMirror(INFO, Interest())
        self.requests: list[dict[str, Any]] = []
        self.refusal: AskError | None = None
        self.hangs: set[str] = set()
        self.connect("s-1")

    def connect(self, session: str, map_id: str = "one") -> LinkChanged:
        """Connect to a daemon's session; return the change."""
        info = MapInfo(map_id, 0.5, 0.25, 0.6, -0.6)
        self.welcome = WelcomeMessage(
            version=1,
            server="test",
            vehicle="diver",
            session=session,
            map=info,
            revision=1,
            resumed=False,
        )
        return linked("connected")

    def forget(self) -> None:
        """Drop a change that nobody has taken."""
        self._waiting.get_nowait()

    async def ask(self, do: str, **fields: Any) -> dict[str, Any]:
        fields.pop("timeout_s", None)
        self.requests.append({"do": do, **fields})
        if do in self.hangs:
            await asyncio.Event().wait()
        if self.refusal is not None:
            raise self.refusal
        return {}


def linked(state: str, reason: str = "") -> LinkChanged:
    return LinkChanged(ConnectionStatus(state, "/run/map.sock", reason, 0.0))  # type: ignore[arg-type]


def began() -> MapReset:
    return MapReset(INFO)


def a_pose(
    at_s: float = 0.0,
    place: tuple[float, float, float] = (1.0, 2.0, -5.0),
    yaw_rad: float = 0.0,
    **changes: Any,
) -> PoseMessage:
    """Pose by localization, of a vehicle that moves along its heading at 1 m/s."""
    turn = (0.0, 0.0, float(np.sin(yaw_rad / 2)), float(np.cos(yaw_rad / 2)))
    fields: dict[str, Any] = {
        "stamp_ns": T0 + round(at_s * S),
        "position_m": place,
        "orientation_xyzw": turn,
        "sonar_position_m": place,
        "sonar_orientation_xyzw": turn,
        "velocity_mps": (float(np.cos(yaw_rad)), float(np.sin(yaw_rad)), 0.0),
        "covariance": tuple(np.diag([0.04, 0.09, 0.01, 0.001, 0.002, 0.003]).ravel().tolist()),
        "source": "localization",
    }
    return PoseMessage(**(fields | changes))


def sure(**changes: Any) -> LocalizationMessage:
    report = {
        "state": "localized",
        "sure": True,
        "t_s": T0 / S,
        "pose": {
            "x_m": 1.0,
            "y_m": 2.0,
            "yaw_rad": 0.0,
            "covariance": np.diag([0.04, 0.09, 0.003]).tolist(),
        },
        "map_odom": {"position_m": [0.0, 0.0, 0.0], "orientation_wxyz": [1.0, 0.0, 0.0, 0.0]},
        "diagnostics": {"level": "OK", "text": "the estimate is within its levels"},
    }
    return LocalizationMessage(
        report=report | changes,
        particles=np.array([[1, 2, 0.5, 0.7], [3, 4, 1.5, 0.3]], "<f4").tobytes(),
    )


def a_ping(at_s: float = 0.0, points: Any = ((3.0, -1.0, 0.0),), **changes: Any) -> ReturnsMessage:
    rows = np.asarray(points, "<f4").reshape(-1, 3)
    pose = a_pose(at_s)
    fields: dict[str, Any] = {
        "stamp_ns": pose.stamp_ns,
        "ping_id": 7,
        "sonar_position_m": pose.position_m,
        "sonar_orientation_xyzw": pose.orientation_xyzw,
        "points": rows.tobytes(),
        "intensities": bytes(len(rows)),
    }
    return ReturnsMessage(**(fields | changes))


def beat(at_s: float = 0.0) -> StatusMessage:
    """Return a heartbeat that has no room for the status."""
    return StatusMessage(stamp_ns=T0 + round(at_s * S))


def a_status(*codes: str, at_s: float = 0.0, **status: Any) -> StatusMessage:
    problems = [{"code": code, "text": f"{code}: it is so. Do this"} for code in codes]
    return StatusMessage(
        stamp_ns=T0 + round(at_s * S), status={"phase": "mapping", "problems": problems, **status}
    )
