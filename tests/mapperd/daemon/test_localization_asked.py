"""What is asked of localization: checked before it becomes an order among the bytes."""

import asyncio
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mapperd.api import STD_XY_M, STD_YAW_RAD, OperationError, PoseRequest
from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.config.loader import config_of
from mapperd.daemon.localization_service import LocalizationRequests, known_map_path
from mapperd.errors import MapError, Reject
from mapperd.events import EventLog
from mapperd.localization.map_io import write_nav2_map
from mapperd.session_log import (
    GlobalLocalization,
    InitialPose,
    NewMap,
    NoMotionUpdate,
    Request,
    SetMap,
)
from tests.mapperd.localization.believed import known

POSE = PoseRequest(1.0, -2.0, 0.5)
ON = {"localization": {"mode": "track"}, "amcl": {"global_frame_id": "harbour"}}


class Bench:
    """Requests of which nothing is done, but all is noted."""

    def __init__(self, folder: Path, settings: dict[str, Any] | None = None) -> None:
        self.events = EventLog(lambda: 0)
        self.orders: list[Request] = []
        self.refusal: Reject | None = None
        self.bad_map = False
        self.resume = asyncio.Event()
        self.resume.set()
        store = ConfigStore(Layered(config_of(ON if settings is None else settings, "")))
        self.requests = LocalizationRequests(store, self.events, folder, self._ask)

    async def _ask(self, request: Request) -> Reject | None:
        await self.resume.wait()
        if self.bad_map:
            raise MapError("tank.yaml: too large", "too_large")
        self.orders.append(request)
        return self.refusal

    def codes(self) -> list[str]:
        return [event.code for event in self.events.since(0)[0]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    maps = tmp_path / "maps"
    maps.mkdir()
    write_nav2_map(known().grid, maps / "tank.yaml")
    return maps


@pytest.fixture
def bench(folder: Path) -> Bench:
    return Bench(folder)


def refused(work: Any) -> OperationError:
    with pytest.raises(OperationError) as caught:
        asyncio.run(work)
    assert "\n" not in str(caught.value)
    return caught.value


def test_initial_pose_becomes_an_order(bench: Bench) -> None:
    assert asyncio.run(bench.requests.initial_pose(POSE, "me")) == {}
    (order,) = bench.orders
    assert isinstance(order, InitialPose)
    assert (order.number, order.x_m, order.y_m, order.yaw_rad) == (0, 1.0, -2.0, 0.5)
    xy, yaw = STD_XY_M**2, STD_YAW_RAD**2
    assert order.covariance == (xy, 0, 0, 0, xy, 0, 0, 0, yaw)
    assert (order.frame, order.origin) == ("harbour", "me")
    assert bench.codes() == ["pose_set"]


def test_other_requests_become_orders(bench: Bench) -> None:
    asyncio.run(bench.requests.global_localization("me"))
    asyncio.run(bench.requests.request_nomotion_update("me"))
    assert bench.orders == [GlobalLocalization(0, "me"), NoMotionUpdate(0, "me")]
    assert bench.codes() == ["global_localization"]


def test_map_comes_with_and_without_a_pose(bench: Bench, folder: Path) -> None:
    path = str(folder / "tank.yaml")
    done = asyncio.run(bench.requests.set_map("tank.yaml", None, "me"))
    assert done == {"path": path}
    covariance = ((1.0, 0.5, 0.0), (0.5, 2.0, 0.0), (0.0, 0.0, 0.1))
    pose = PoseRequest(1.0, 2.0, 7.0, covariance=covariance, frame="tank")
    asyncio.run(bench.requests.set_map("tank.yaml", pose, "me"))
    bare, placed = bench.orders
    assert bare == NewMap(0, path, "", "me")
    assert isinstance(placed, SetMap)
    assert placed.covariance == (1.0, 0.5, 0.0, 0.5, 2.0, 0.0, 0.0, 0.0, 0.1)
    assert placed.yaw_rad == pytest.approx(7.0 - 2 * 3.141592653589793)
    assert placed.frame == "tank"
    assert bench.codes() == ["map_set", "map_set"]


def test_refusal_is_an_error_and_an_event(bench: Bench) -> None:
    bench.refusal = Reject("no_map", "there is no map to be found on")
    error = refused(bench.requests.global_localization("me"))
    assert error.reason == "no_map"
    assert bench.codes() == ["localization_refused"]


def test_nothing_is_ordered_while_it_is_off(folder: Path) -> None:
    bench = Bench(folder, {})
    requests = bench.requests
    for work in (
        requests.initial_pose(POSE, "me"),
        requests.global_localization("me"),
        requests.request_nomotion_update("me"),
        requests.set_map("tank.yaml", POSE, "me"),
    ):
        assert refused(work).reason == "localization_off"
    assert bench.orders == []


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (PoseRequest(NAN, 0, 0), "a pose is finite"),
        (PoseRequest(0, INF, 0), "a pose is finite"),
        (PoseRequest(0, 0, NAN), "a pose is finite"),
        (PoseRequest(0, 0, 0, std_xy_m=NAN), "finite numbers"),
        (PoseRequest(0, 0, 0, std_yaw_rad=INF), "finite numbers"),
        (PoseRequest(0, 0, 0, covariance=((1, 2, 0), (2, 1, 0), (0, 0, 1))), "semi-definite"),
        (PoseRequest(0, 0, 0, covariance=((1, 0, 0), (0, -1, 0), (0, 0, 1))), "semi-definite"),
        (PoseRequest(0, 0, 0, covariance=((1, 1, 0), (0, 1, 0), (0, 0, 1))), "not symmetric"),
        (PoseRequest(0, 0, 0, 1.0, covariance=((1, 0, 0), (0, 1, 0), (0, 0, 1))), "not both"),
    ],
)
def test_pose_that_is_invalid_is_refused(bench: Bench, pose: PoseRequest, words: str) -> None:
    for work in (
        bench.requests.initial_pose(pose, "me"),
        bench.requests.set_map("tank.yaml", pose, "me"),
    ):
        error = refused(work)
        assert error.reason == "bad_pose"
        assert words in str(error)
    assert bench.orders == []


@pytest.mark.parametrize(
    "stated",
    [
        {"x_m": 1e7, "y_m": 0, "yaw_rad": 0},
        {"x_m": 0, "y_m": 0, "yaw_rad": 1e3},
        {"x_m": 0, "y_m": 0},
        {"x_m": "0", "y_m": 0, "yaw_rad": 0},
        {"x_m": 0, "y_m": 0, "yaw_rad": 0, "std_xy_m": -1},
        {"x_m": 0, "y_m": 0, "yaw_rad": 0, "covariance": [[1, 0, 0], [0, 1, 0]]},
        {"x_m": 0, "y_m": 0, "yaw_rad": 0, "covariance": [[1e13, 0, 0], [0, 1, 0], [0, 0, 1]]},
        {"x_m": 0, "y_m": 0, "yaw_rad": 0, "frame": "m" * 65},
        {"x_m": 0, "y_m": 0, "yaw_rad": 0, "z_m": 0},
    ],
)
def test_pose_of_another_form_is_not_read(stated: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(stated, PoseRequest)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("../tank.yaml", "bad_name"),
        ("/etc/passwd.yaml", "bad_name"),
        ("..", "bad_name"),
        (".yaml", "bad_name"),
        ("a/b.yaml", "bad_name"),
        ("tank\0.yaml", "bad_name"),
        ("tank\n.yaml", "bad_name"),
        ("x" * 300 + ".yaml", "bad_name"),
        ("", "bad_name"),
        ("tank.pgm", "bad_format"),
        ("none.yaml", "no_such_map"),
        ("link.map", "no_such_map"),
        ("pipe.map", "no_such_map"),
        ("folder.map", "no_such_map"),
        ("far.yaml", "bad_map"),
        ("up.yaml", "bad_map"),
        ("linked.yaml", "no_such_map"),
        ("text.yaml", "bad_map"),
    ],
)
def test_only_maps_of_the_folder_are_taken(
    bench: Bench, folder: Path, name: str, reason: str
) -> None:
    outside = folder.parent / "secret.pgm"
    outside.write_bytes((folder / "tank.pgm").read_bytes())
    (folder / "link.map").symlink_to(outside)
    os.mkfifo(folder / "pipe.map")
    (folder / "folder.map").mkdir()
    text = (folder / "tank.yaml").read_text(encoding="utf-8")
    for yaml, image in (("far", str(outside)), ("up", "../secret.pgm"), ("linked", "linked.pgm")):
        (folder / f"{yaml}.yaml").write_text(text.replace("tank.pgm", image), encoding="utf-8")
    (folder / "linked.pgm").symlink_to(outside)
    (folder / "text.yaml").write_text("image: [", encoding="utf-8")
    assert known_map_path(folder, "tank.yaml") == folder / "tank.yaml"
    assert refused(bench.requests.set_map(name, POSE, "me")).reason == reason
    assert bench.orders == []


def test_map_that_cannot_be_loaded_orders_nothing(bench: Bench) -> None:
    bench.bad_map = True
    error = refused(bench.requests.set_map("tank.yaml", POSE, "me"))
    assert error.reason == "bad_map"
    assert "too large" in str(error)
    assert bench.orders == []


def test_one_map_is_set_at_a_time(bench: Bench) -> None:
    async def work() -> None:
        bench.resume.clear()
        first = asyncio.create_task(bench.requests.set_map("tank.yaml", POSE, "me"))
        while not bench.requests.is_changing_map:  # noqa: ASYNC110 what is waited for has no event
            await asyncio.sleep(0.001)
        with pytest.raises(OperationError, match="another map") as caught:
            async with asyncio.timeout(10):
                await bench.requests.set_map("tank.yaml", POSE, "me")
        assert caught.value.reason == "busy"
        bench.resume.set()
        await first
        await bench.requests.set_map("tank.yaml", POSE, "me")

    asyncio.run(work())
    assert len(bench.orders) == 2


def test_request_that_waits_for_too_long_is_busy(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.daemon.localization_service.REQUEST_TIMEOUT_S", 0.0)
    bench.resume.clear()
    assert refused(bench.requests.global_localization("me")).reason == "busy"
