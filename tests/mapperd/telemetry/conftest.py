"""A daemon with the state that a test sets, and its telemetry."""

import json
from typing import TYPE_CHECKING, Any

import pytest

from mapperd.api import OperationError, PoseRequest, ReportedChanges
from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.config.loader import config_of
from mapperd.events import EventLog
from mapperd.localization.report import localization_report, localization_summary
from mapperd.telemetry.broker import Kind, Outbox, QueuedMessage

if TYPE_CHECKING:
    from mapperd.localization.status import LocalizationSnapshot

T0_S = 1_700_000_000.0
ROOT = "mapperd/v1/rov-1/mapper"
ROBOT = {
    "t_s": T0_S,
    "position_m": [1.0, 2.0, -3.0],
    "range_m": 4.0,
    "bearing_rad": 0.1,
    "samples": 9,
    "peak": 250.0,
}
POSE = {
    "t_s": T0_S,
    "position_m": [1.0, 2.0, -3.0],
    "map_q_base_wxyz": [1.0, 0.0, 0.0, 0.0],
    "position_std_m": [0.1, 0.1, float("nan")],
    "rotation_std_rad": [0.01, 0.01, 0.01],
    "segment": 0,
    "reckoned_s": 0.0,
}


class FakeVehicle:
    """Operations that remember what they were asked."""

    def __init__(self, settings: dict[str, Any] | None = None) -> None:
        mqtt = {"host": "127.0.0.1", "vehicle": "rov-1", **(settings or {})}
        self.settings = ConfigStore(Layered(config_of({"mqtt": mqtt}, "")))
        self.settings.follow(("filtering", "mounting"), lambda _: None)
        self.events = EventLog(lambda: round(T0_S * 1e9))
        self.changes = ReportedChanges()
        self.asked: list[tuple[str, ...]] = []
        self.pings = 0
        self.pose: dict[str, Any] | None = None
        self.localized: LocalizationSnapshot | None = None
        self.robots: list[dict[str, Any]] = []
        self.phase = "mapping"
        self.asked_for_status = 0

    def status(self) -> dict[str, Any]:
        self.asked_for_status += 1
        return {
            "phase": self.phase,
            "reason": "pings and odometry come",
            "version": "1.2.3",
            "uptime_s": 7.0,
            "sonar": {"state": "pinging", "reason": "pings come", "range_m": 10.0},
            "odometry": {"quantities": {"position": {"owner": "dvl"}}},
            "pose": self.pose,
            "localization": localization_summary(self.localized, self.settings.current),
            "pings": {
                "total": self.pings,
                "mapped": self.pings,
                "dropped": {"no_pose": 1},
                "waiting": 2,
            },
            "latency_ms": {"p50": 1.0, "p95": 2.0, "p99": float("nan")},
            "behind": {"late": False, "dropped": 0, "ready": 0},
            "map": {"memory_bytes": 1000, "revision": 3, "resolution_m": 0.05},
            "store": {"saved_s": 5.0},
            "recording": {"bytes": 10},
            "robots": self.robots,
            "servers": {},
        }

    async def save(self, name: str, origin: str) -> dict[str, Any]:
        self.asked.append(("save", name, origin))
        if "/" in name:
            raise OperationError("a name without a folder is wanted", "bad_name")
        return {"path": f"/state/{name}", "bytes": 5, "seconds": 0.1}

    async def reset(self, origin: str) -> dict[str, Any]:
        self.asked.append(("reset", origin))
        return {}

    async def reload(self, origin: str) -> dict[str, Any]:
        raise RuntimeError(f"a fault, found by {origin}")

    def localization(self, particles: int = 0) -> dict[str, Any]:
        return localization_report(self.localized, self.settings.current, particles)

    async def initial_pose(self, asked: PoseRequest, origin: str) -> dict[str, Any]:
        self.asked.append(("initial_pose", str(asked.x_m), origin))
        return {}

    async def global_localization(self, origin: str) -> dict[str, Any]:
        raise OperationError(f"there is no map for {origin} to be found on", "no_map")

    async def request_nomotion_update(self, origin: str) -> dict[str, Any]:
        self.asked.append(("request_nomotion_update", origin))
        return {}

    async def set_map(self, name: str, asked: PoseRequest | None, origin: str) -> dict[str, Any]:
        self.asked.append(("set_map", name, "" if asked is None else str(asked.x_m), origin))
        return {"path": f"/state/maps/{name}"}

    async def snapshot(self, origin: str) -> dict[str, Any]:
        self.asked.append(("snapshot", origin))
        return {"bytes": 1, "seconds": 0.1}


@pytest.fixture
def daemon() -> FakeVehicle:
    return FakeVehicle()


def drained(outbox: Outbox) -> dict[str, list[Any]]:
    """What waits, by topic below the root; taken out. A status payload is no JSON."""
    found: dict[str, list[Any]] = {}
    while (message := outbox.take(*Kind)) is not None:
        found.setdefault(below(message.topic), []).append(json.loads(message.payload))
    return found


def below(topic: str) -> str:
    assert topic.startswith(f"{ROOT}/"), topic
    return topic.removeprefix(f"{ROOT}/")


def message(kind: Kind, number: int = 0, topic: str = "a") -> QueuedMessage:
    return QueuedMessage(topic, str(number).encode(), kind)
