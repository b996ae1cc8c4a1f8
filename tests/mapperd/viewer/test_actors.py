"""The vehicle and its way on the page, as they change and as they end."""

import asyncio
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.cli.mapperctl.view import open_page
from mapperd.client import LinkChanged, MapClient
from mapperd.viewer.actors import PATH_PIECE, Actors
from mapperd.viewer.app import ViewerPage
from mapperd.viewer.shapes import strip
from mapperd.wire.messages import (
    FanMessage,
    LocalizationMessage,
    PathMessage,
    ReturnsMessage,
    RobotsMessage,
)
from tests.mapperd.viewer.view_fakes import FakePageClient, pose_at, some_map

if TYPE_CHECKING:
    from viser import ViserServer


@pytest.fixture
def server() -> Iterator["ViserServer"]:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    one = open_page("127.0.0.1", 0)
    try:
        yield one
    finally:
        one.stop()


def way(length: int, x: float) -> NDArray[np.float64]:
    return np.column_stack([np.full(length, x), np.arange(length), np.zeros(length)])


def test_a_path_that_starts_again_leaves_nothing_of_the_one_before(server: "ViserServer") -> None:
    actors = Actors(server.scene)
    actors.take(PathMessage(first=0, points=b""), way(3 * PATH_PIECE, 1.0), 0.0)
    longer = way(4 * PATH_PIECE, 2.0)
    actors.take(PathMessage(first=0, points=b""), longer, 0.0)
    drawn = [server.scene.get_handle_by_name(f"/path/{number}") for number in range(4)]
    drawn_points = np.concatenate([segments_of(one) for one in drawn])
    np.testing.assert_array_equal(drawn_points, strip(longer))


def test_a_path_far_from_the_maps_zero_is_drawn_to_the_millimetre(server: "ViserServer") -> None:
    actors = Actors(server.scene)
    metres = np.arange(2 * PATH_PIECE)
    points = np.column_stack([500_000.3 + 0.1 * metres, 4_649_776.7 - 0.1 * metres, 0.0 * metres])
    actors.take(PathMessage(first=0, points=b""), points, 0.0)
    drawn = [server.scene.get_handle_by_name(f"/path/{number}") for number in range(2)]
    drawn_points = np.concatenate([segments_of(one)[:, 0] for one in drawn])
    np.testing.assert_allclose(drawn_points, points[:-1], rtol=0, atol=1e-3)


def segments_of(drawn: object) -> NDArray[np.float64]:
    """Ends in the map's frame, (N, 2, 3)."""
    node = cast("Any", drawn)
    assert node.points.dtype == np.float32
    return np.asarray(node.points.astype(np.float64) + np.asarray(node.position, np.float64))


def test_an_ellipse_goes_with_the_covariance(server: "ViserServer") -> None:
    actors = Actors(server.scene)
    sure = pose_at(1, 2, -4, 0.0)
    actors.pose(msgspec.structs.replace(sure, covariance=tuple(np.eye(6).ravel().tolist())))
    assert server.scene.get_handle_by_name("/localization/pose") is not None
    actors.pose(sure)
    assert server.scene.get_handle_by_name("/localization/pose") is None
    actors.pose(sure)


def test_what_moves_is_moved_and_not_made_again(server: "ViserServer") -> None:
    actors = Actors(server.scene)
    names = ["localization/pose", "localization/particles", "localization/scan", "sonar/fan"]
    names += ["returns/last", "robots/0", "robots/0_label", "path/0"]

    def feed(step: int) -> dict[str, Any]:
        pose = pose_at(step, 2, -4, 0.0)
        plane = tuple((np.eye(6) * (1 + step)).ravel().tolist())
        actors.pose(msgspec.structs.replace(pose, covariance=plane))
        points = np.full((3 + step, 4), step, "<f4")
        flat = np.ascontiguousarray(points[:, :3]).tobytes()
        drawn_points = LocalizationMessage(report={}, particles=points.tobytes(), scan=flat)
        actors.localization(drawn_points, -4.0)
        reach_m = 5.0 + step
        fan = FanMessage(
            bearings_rad=(-1.0, 1.0),
            vertical_aperture_rad=0.2,
            min_range_m=0.1,
            max_range_m=reach_m,
        )
        actors.fan(fan)
        at, turn = pose.sonar_position_m, pose.sonar_orientation_xyzw
        met = ReturnsMessage(
            stamp_ns=1, ping_id=1, sonar_position_m=at, sonar_orientation_xyzw=turn, points=flat
        )
        actors.returns(met)
        actors.robots(RobotsMessage(seen=[(1, float(step), 0.0, -4.0)]))
        actors.path(way(5 + step, 1.0), 5)
        return {name: server.scene.get_handle_by_name(f"/{name}") for name in names}

    first, second = feed(0), feed(1)
    for name in names:
        assert first[name] is second[name], name
    np.testing.assert_array_equal(second["localization/pose"].position, (1, 2, -4))
    assert np.abs(second["localization/pose"].points).max() == pytest.approx(2 * 2**0.5)
    assert [len(second[name].points) for name in names[1:3]] == [4, 4]
    assert np.abs(second["sonar/fan"].points).max() == pytest.approx(6.0, rel=0.01)
    np.testing.assert_array_equal(second["returns/last"].position, (1, 2, -4))
    np.testing.assert_array_equal(second["robots/0"].position, (1, 0, -4))
    np.testing.assert_array_equal(segments_of(second["path/0"]), strip(way(6, 1.0)))
    actors.localization(LocalizationMessage(report={}, particles=b"", scan=b""), -4.0)
    assert server.scene.get_handle_by_name("/localization/particles") is None


def test_a_new_session_removes_everything(server: "ViserServer") -> None:
    async def run() -> None:
        client = FakePageClient(some_map())
        view = ViewerPage(server, cast("MapClient", client))

        def shown() -> bool:
            return server.scene.get_handle_by_name("/robots/0") is not None

        client.connect()
        view.take(LinkChanged(client.link))
        view.take(pose_at(0, 0, -4, 0.0))
        view.take(RobotsMessage(seen=[(1, 0.0, 0.0, -4.0)]))
        view.take(LinkChanged(client.link))
        assert shown(), "the link broke, the daemon went on"
        assert client.welcome is not None
        client.welcome = msgspec.structs.replace(client.welcome, session="another")
        view.take(LinkChanged(client.link))
        assert not shown()

    asyncio.run(run())


def test_changes_are_boxes_with_their_size(server: "ViserServer") -> None:
    actors = Actors(server.scene)
    change: dict[str, Any] = {
        "kind": "appeared",
        "id": "appeared-1",
        "low_m": [1.0, 2.0, -3.0],
        "high_m": [2.0, 4.0, -2.5],
        "voxels": 12,
    }
    actors.changes([change])
    drawn = server.scene.get_handle_by_name("/changes/appeared-1")
    ends = segments_of(drawn)
    assert ends.shape == (12, 2, 3)
    np.testing.assert_allclose(ends.min(axis=(0, 1)), change["low_m"])
    np.testing.assert_allclose(ends.max(axis=(0, 1)), change["high_m"])
    lengths = sorted(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).round(3).tolist())
    assert lengths == [0.5] * 4 + [1.0] * 4 + [2.0] * 4
    actors.changes([])
    assert server.scene.get_handle_by_name("/changes/appeared-1") is None
