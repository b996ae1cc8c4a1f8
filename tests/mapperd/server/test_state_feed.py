"""What the daemon knows, as messages."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard

from mapperd.client.validation import check_message
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config, LocalizationConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import Pose, pose_from_rpy, quaternion_to_matrix
from mapperd.imaging.ping_image import PingImage
from mapperd.localization.status import LocalizationSnapshot
from mapperd.mapping.sonar_map import PingStats
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.step import PingResult
from mapperd.server.state_feed import SettingLog, StateFeed
from mapperd.server.state_messages import IMAGE_SIZES, VehiclePath, first_returns, image_message
from mapperd.wire.framing import client_inbox
from mapperd.wire.messages import (
    FanMessage,
    ImageMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
)
from oculus_driver.ping import Ping
from tests.mapperd.localization.believed import snapshot
from tests.support.control_server import FakeDaemon

MOUNTED = config_from_text(
    "mounting: {position: {x: 1, y: 0, z: 0.5}, orientation: {roll: 0, pitch: 30, yaw: 0}}"
)

MAPS_NOTHING = LocalizationConfig(mode="track", mapping="off")


@dataclass
class SentState:
    """As the mapping thread's facts, as far as the feed reads them."""

    odometry: dict[str, Any] = field(default_factory=lambda: {"source": "odometry"})
    robots: list[dict[str, Any]] = field(default_factory=list)
    localization: LocalizationSnapshot | None = None


@pytest.fixture(name="ping")
def one_ping(ping: Callable[..., Ping]) -> Ping:
    return ping()


def fused(x: float, yaw_deg: float = 0.0) -> FusedPose:
    pose = pose_from_rpy((x, 2.0, -3.0), (0, 0, yaw_deg))
    return FusedPose(pose, np.array([1.0, 0, 0]), None, np.eye(6) * 0.04, 0, 0.0)


def ping_result(ping: Ping, pose: FusedPose | Reject, stats: PingStats | Reject) -> PingResult:
    return PingResult(PosedPing(0, ping, pose, 2_000, 1_000), pose, stats)


def feed_of(config: Config = MOUNTED) -> tuple[StateFeed, SentState, FakeDaemon]:
    sent, daemon = SentState(), FakeDaemon(config)
    return StateFeed(daemon, lambda: sent, 100), sent, daemon  # type: ignore[arg-type,return-value]


def message(frame: bytes) -> Any:
    (one,) = client_inbox().feed(frame)
    return one


def test_the_pose_is_the_pings_and_the_sonars_beside_it(ping: Ping) -> None:
    feed, _, _ = feed_of()
    feed.refresh({"pose"}, 0.0)
    assert feed.newest("pose").number == 0
    feed.put(ping_result(ping, fused(5.0, yaw_deg=90.0), PingStats()))
    feed.refresh({"pose"}, 0.1)
    feed.refresh({"pose"}, 0.2)
    assert feed.newest("pose").number == 1
    output = message(feed.newest("pose").frame)
    assert isinstance(output, PoseMessage)
    assert (output.stamp_ns, output.source) == (1_000, "odometry")
    assert output.position_m == feed.position_m == (5.0, 2.0, -3.0)
    np.testing.assert_allclose(output.sonar_position_m, (5.0, 3.0, -2.5), atol=1e-12)
    x, y, z, w = output.sonar_orientation_xyzw
    ahead = quaternion_to_matrix((w, x, y, z)) @ [1, 0, 0]
    down = math.sin(math.radians(30))
    np.testing.assert_allclose(ahead, (0, math.cos(math.radians(30)), -down), atol=1e-12)
    assert output.covariance is not None
    assert output.covariance[:8] == (0.04, 0, 0, 0, 0, 0, 0, 0.04)


def test_a_corrected_pose_has_that_of_the_odometry_beside_it(ping: Ping) -> None:
    feed, _, _ = feed_of()
    odom, corrected = fused(5.0, yaw_deg=90.0), fused(7.0, yaw_deg=180.0)
    posed = PosedPing(0, ping, odom, 2_000, 1_000)
    feed.put(PingResult(posed, corrected, PingStats()))
    feed.refresh({"pose"}, 0.0)
    output = message(feed.newest("pose").frame)
    assert (output.position_m, output.odom_position_m) == ((7.0, 2.0, -3.0), (5.0, 2.0, -3.0))
    half = math.sqrt(0.5)
    assert output.odom_orientation_xyzw == pytest.approx((0, 0, half, half))
    check_message(output)
    feed.put(ping_result(ping, odom, PingStats()))
    feed.refresh({"pose"}, 0.1)
    assert b"odom_" not in feed.newest("pose").frame  # earlier clients get what they know


def test_where_nothing_is_mapped_the_estimate_has_its_odometry() -> None:
    feed, sent, _ = feed_of(msgspec.structs.replace(MOUNTED, localization=MAPS_NOTHING))
    sent.localization = snapshot(0.0, pose=fused(7.0).pose, odom=fused(5.0).pose, odom_ns=77)
    feed.refresh({"pose"}, 0.0)
    output = message(feed.newest("pose").frame)
    assert (output.source, output.position_m) == ("localization", (7.0, 2.0, -3.0))
    assert output.odom_position_m == (5.0, 2.0, -3.0)
    assert output.stamp_ns == 77  # not that of the last update, which is older


def test_a_ping_without_a_pose_moves_nothing(ping: Ping) -> None:
    feed, _, _ = feed_of()
    refused = Reject("no_odometry", "")
    feed.put(ping_result(ping, refused, refused))
    feed.refresh({"pose", "returns"}, 0.0)
    assert feed.position_m is None
    assert len(feed.path) == 0
    feed.draw({"returns"}, [])
    output = message(feed.newest("returns").frame)
    assert isinstance(output, ReturnsMessage)
    assert (output.outcome, output.sonar_position_m) == ("no_odometry", None)


def test_the_fan_is_reported_when_it_changes(ping: Ping) -> None:
    feed, _, daemon = feed_of()
    for n in range(3):
        feed.put(ping_result(ping, fused(n), PingStats()))
        feed.refresh({"fan"}, n)
    assert feed.newest("fan").number == 1
    output = message(feed.newest("fan").frame)
    assert isinstance(output, FanMessage)
    assert output.bearings_rad[0] == pytest.approx(ping.bearings_rad[0], abs=1e-4)
    assert output.vertical_aperture_rad == pytest.approx(math.radians(14))
    assert output.min_range_m == 0.5
    assert output.max_range_m == pytest.approx(ping.max_range_m, abs=1e-3)
    daemon.settings.apply({"filtering.min_range": 0.7}, "test")
    feed.put(ping_result(ping, fused(9), PingStats()))
    feed.refresh({"fan"}, 9)
    assert message(feed.newest("fan").frame).min_range_m == 0.7


def test_settings_that_change_are_reported() -> None:
    feed, _, daemon = feed_of()
    last = feed.settings.last
    daemon.settings.apply({"filtering.min_range": 0.7}, "somebody")
    feed.refresh(set(), 0.0)
    number, facts = feed.settings.since(last, 10)
    assert number == feed.settings.last
    assert [*facts] == ["filtering.min_range"]
    fact = msgspec.msgpack.decode(facts["filtering.min_range"])
    assert (fact["value"], fact["dynamic"]) == (0.7, True)


def test_robots_are_reported_when_they_come_and_go() -> None:
    feed, sent, _ = feed_of()
    feed.refresh({"robots"}, 0.0)
    sent.robots = [{"t_s": 2.5, "position_m": [1.0, 2.0, 3.0]}]
    feed.refresh({"robots"}, 0.1)
    feed.refresh({"robots"}, 0.2)
    output = message(feed.newest("robots").frame)
    assert isinstance(output, RobotsMessage)
    assert output.seen == [(2_500_000_000, 1.0, 2.0, 3.0)]
    sent.robots = []
    feed.refresh({"robots"}, 0.3)
    assert message(feed.newest("robots").frame).seen == []


def test_pictures_are_drawn_only_when_somebody_wants_them(ping: Ping) -> None:
    feed, _, _ = feed_of()
    feed.put(ping_result(ping, fused(1), PingStats()))
    feed.refresh({"pose"}, 0.0)
    assert not feed.wants_drawing({"pose"}, 0.0)
    assert feed.wants_drawing({"image"}, 0.0)
    feed.draw({"image"}, {0, 2})
    assert feed.image(0).number == feed.image(2).number == 1
    assert feed.image(1).number == 0
    assert not feed.wants_drawing({"image"}, 1.0)  # that ping has been drawn
    feed.put(ping_result(ping, fused(2), PingStats()))
    feed.refresh({"image"}, 2.0)
    assert feed.wants_drawing({"image"}, 2.0)


def test_a_picture_keeps_the_brightest_sample_of_each_pixel(ping: Ping) -> None:
    rows, beams = ping.image.shape
    for size in (*IMAGE_SIZES, (7, 5), (10_000, 10_000)):
        output = image_message(ping, 5, size)
        assert isinstance(output, ImageMessage)
        assert output.rows <= size[0]
        assert output.beams <= size[1]
        pixels = np.frombuffer(zstandard.decompress(output.body), np.uint8)
        pixels = pixels.reshape(output.rows, output.beams)
        by_row, by_beam = -(-rows // output.rows), -(-beams // output.beams)
        for row, beam in ((0, 0), (output.rows - 1, output.beams - 1), (output.rows // 2, 1)):
            part = ping.image[
                row * by_row : (row + 1) * by_row, beam * by_beam : (beam + 1) * by_beam
            ]
            assert pixels[row, beam] == round(int(part.max()) * 255 / ping.full_scale)
        bearings = np.frombuffer(output.bearings_rad, "<f4")
        assert len(bearings) == output.beams
        assert bearings[0] == pytest.approx(ping.bearings_rad[:by_beam].mean(), abs=1e-6)
        assert output.range_resolution_m == pytest.approx(ping.range_resolution_m * by_row)


def test_first_returns_are_the_nearest_above_the_threshold() -> None:
    intensity = np.zeros((20, 3), np.float32)
    intensity[2, 0] = 200  # nearer than filtering.min_range
    intensity[8, 0], intensity[12, 0] = 36, 255
    intensity[5, 2] = 35  # not above the threshold
    echo = PingImage(intensity, np.array([-0.5, 0.0, 0.5]), 0.1)
    points, intensities = first_returns(echo, Config())
    range_m = 0.85
    expected = [[range_m * math.cos(0.5), range_m * math.sin(0.5), 0.0]]  # to port
    np.testing.assert_allclose(points, expected, rtol=1e-6)
    assert intensities.tolist() == [36]
    assert len(first_returns(PingImage(intensity[:3], echo.bearings_rad, 0.1), Config())[0]) == 0


def test_a_path_is_bounded_and_numbered_again_when_it_is_thinned() -> None:
    track = VehiclePath(10, 1.0)
    for n in range(10):
        track.add(np.array([n, 0.0, 0.0]))
        track.add(np.array([n + 0.5, 0.0, 0.0]))  # too near
    version, first, points = track.since(0, 7, 100)
    assert (version, first, points[:, 0].tolist()) == (0, 7, [7, 8, 9])
    track.add(np.array([10.0, 0.0, 0.0]))
    version, first, points = track.since(0, 10, 100)
    assert (version, first) == (1, 0)
    assert points[:, 0].tolist() == [0, 2, 4, 6, 8, 10]
    track.add(np.array([11.0, 0.0, 0.0]))  # the distance has doubled
    assert len(track) == 6
    assert track.since(1, 6, 100)[1:2] == (6,)
    assert track.since(1, 99, 2)[2][:, 0].tolist() == [0, 2]  # a lie


def test_a_log_of_settings_holds_each_once_and_the_newest() -> None:
    log = SettingLog({"a": 1, "b": 2, "c": 3})
    number, facts = log.since(0, 1)
    assert (number, [*facts]) == (1, ["a"])
    log.put({"b": 9})
    sent: list[tuple[str, int]] = []
    while number < log.last:
        number, facts = log.since(number, 1)
        sent += [(name, msgspec.msgpack.decode(raw)) for name, raw in facts.items()]
    assert sent == [("c", 3), ("b", 9)]
    assert log.since(0, 1 << 20)[0] == 4


def test_the_sonar_sits_where_the_settings_report(ping: Ping) -> None:
    feed, _, _ = feed_of(Config())
    base = pose_from_rpy((1, 2, 3), (10, 20, 30))
    pose = FusedPose(base, None, None, np.full((6, 6), np.nan), 0, 0.0)
    feed.put(ping_result(ping, pose, PingStats()))
    feed.refresh({"pose"}, 0.0)
    output = message(feed.newest("pose").frame)
    assert output.covariance is None
    assert output.velocity_mps is None
    x, y, z, w = output.orientation_xyzw
    again = Pose(np.array(output.position_m), np.array([w, x, y, z]))
    np.testing.assert_allclose(again.map_T_base, base.map_T_base, atol=1e-12)


def test_what_is_no_number_is_counted_and_never_reported(ping: Ping) -> None:
    feed, _, _ = feed_of()
    for x, speed in ((1.0, math.nan), (2.0, math.inf), (1e300, 0.5)):
        pose = FusedPose(fused(x).pose, np.array([0, speed, 0]), None, np.eye(6), 0, 0.0)
        feed.put(ping_result(ping, pose, PingStats()))
        feed.refresh({"pose"}, x)
        output = message(feed.newest("pose").frame)
        check_message(output)  # a client takes it
        assert output.velocity_mps == (None if x < 3 else (0.0, 0.5, 0.0))
    assert feed.left_out == {"not_finite_velocity": 2}
    _, _, points = feed.path.since(0, 0, 100)
    assert points[:, 0].tolist() == [1.0, 2.0]
