"""State as messages: what is drawn lies where it should."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard

from mapperd.client.mirror import Cells
from mapperd.client.validation import bearings_of
from mapperd.foxglove.geometry import (
    Frames,
    PathDrawing,
    covariance_scene,
    fan_scene,
    robots_scene,
    transforms,
)
from mapperd.foxglove.map_publisher import map_cloud, map_rows
from mapperd.foxglove.messages import StateMessages, annotations, colour_image
from mapperd.imaging.ping_image import COLOURS, FanShape
from mapperd.wire.messages import ImageMessage, ReturnsMessage, RobotsMessage
from tests.mapperd.foxglove.foxglove_fakes import (
    FAN,
    LOCALIZATION,
    POSE,
    ROBOTS,
    T0,
    FakeStream,
    S,
    message_class,
    points_of_cloud,
)


def decoded(message: Any) -> Any:
    schema = type(message).get_schema()
    return message_class(schema.data, schema.name).FromString(message.encode())


def xyz(line: Any) -> np.ndarray[Any, Any]:
    return np.array([(point.x, point.y, point.z) for point in line.points])


def test_transforms_lead_from_the_map_to_the_sonar() -> None:
    to_base, to_sonar = decoded(transforms(POSE, Frames("map", {}))).transforms
    turn = _matrix(to_base.rotation)
    lever = to_sonar.translation
    sonar_m = _vector(to_base.translation) + turn @ _vector(lever)
    np.testing.assert_allclose(sonar_m, POSE.sonar_position_m, atol=1e-12)
    x, y, z, w = POSE.sonar_orientation_xyzw
    wanted = _matrix(_Quaternion(x, y, z, w))
    np.testing.assert_allclose(turn @ _matrix(to_sonar.rotation), wanted, atol=1e-12)


class _Quaternion:
    def __init__(self, x: float, y: float, z: float, w: float) -> None:
        self.x, self.y, self.z, self.w = x, y, z, w


def _matrix(q: Any) -> np.ndarray[Any, Any]:
    """By Rodrigues' formula."""
    angle = 2 * math.acos(max(-1.0, min(1.0, q.w)))
    axis = np.array([q.x, q.y, q.z])
    axis = axis / (np.linalg.norm(axis) or 1.0)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn: np.ndarray[Any, Any] = np.eye(3) + math.sin(angle) * cross
    turn += (1 - math.cos(angle)) * cross @ cross
    return turn


def _vector(v: Any) -> np.ndarray[Any, Any]:
    return np.array([v.x, v.y, v.z])


def test_cells_report_their_age_and_how_often_they_were_seen() -> None:
    cells = Cells(
        np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        np.zeros(2, np.float32),
        np.array([0.75, 1.0], np.float32),
        np.array([0, 4], np.uint16),
        np.array([T0 - 2 * S, T0 + S]),
    )
    rows = points_of_cloud(decoded(map_cloud(map_rows(cells, T0), "map", T0)))
    assert rows.tolist() == [(1, 2, 3, 0.75, 2.0, 0), (4, 5, 6, 1.0, 0.0, 4)]


def test_the_fan_is_drawn_as_the_sonar_sees() -> None:
    entity = decoded(fan_scene(FAN, "sonar", T0)).entities[0]
    assert (entity.frame_id, entity.frame_locked) == ("sonar", True)
    outline = np.concatenate([xyz(line) for line in entity.lines])
    ranges = np.linalg.norm(outline, axis=1)
    assert ranges.min() == pytest.approx(FAN.min_range_m)
    assert ranges.max() == pytest.approx(FAN.max_range_m)
    bearings = np.arctan2(-outline[:, 1], outline[:, 0])  # positive to starboard, y to port
    assert (bearings.min(), bearings.max()) == pytest.approx(FAN.bearings_rad)
    elevations = np.arcsin(outline[:, 2] / ranges)
    assert np.unique(elevations.round(9)).tolist() == pytest.approx([-0.175, 0.175])
    edges = xyz(entity.lines[2]).reshape(4, 2, 3)
    np.testing.assert_allclose(edges[:, 0, :2], edges[:, 1, :2])
    np.testing.assert_allclose(sorted(np.linalg.norm(edges[:, 0], axis=1)), [0.5, 0.5, 20.0, 20.0])


def test_fan_of_one_side_keeps_its_side() -> None:
    fan = msgspec.structs.replace(FAN, bearings_rad=(0.2, 0.6))
    outline = xyz(decoded(fan_scene(fan, "sonar", T0)).entities[0].lines[0])
    assert (outline[:, 1] < 0).all()


def test_robots_are_where_they_were_seen() -> None:
    update = decoded(robots_scene(ROBOTS, "map", T0))
    assert [deletion.type for deletion in update.deletions] == [1]
    (entity,) = update.entities
    assert _vector(entity.spheres[0].pose.position).tolist() == [1.0, 2.0, 3.0]
    assert entity.texts[0].text == "robot, 3 s ago"
    assert not decoded(robots_scene(RobotsMessage(seen=[]), "map", T0)).entities


def test_doubt_is_an_ellipse_of_two_deviations() -> None:
    turned = math.radians(30)
    axes = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = axes @ np.diag([9.0, 0.25]) @ axes.T
    fix = {"x_m": 5.0, "y_m": -1.0, "yaw_rad": 0.0, "covariance": covariance.tolist()}
    outline = xyz(decoded(covariance_scene(fix, "map", -4.0, T0)).entities[0].lines[0])
    assert (outline[:, 2] == -4.0).all()
    along, across = ((outline[:, :2] - (5.0, -1.0)) @ axes).T
    np.testing.assert_allclose((along / 6.0) ** 2 + (across / 1.0) ** 2, 1.0, atol=1e-9)
    gone = decoded(covariance_scene(None, "map", -4.0, T0))
    assert (len(gone.deletions), len(gone.entities)) == (1, 0)


def test_only_pieces_of_the_path_that_changed_are_reported() -> None:
    way = np.cumsum(np.ones((3500, 3), np.float32), axis=0)
    drawing = PathDrawing()

    def changing(path: Any) -> Any:
        update = drawing.update(path, "map", T0)
        return None if update is None else decoded(update)

    first = changing(way[:2500])
    assert [entity.id for entity in first.entities] == ["path 0", "path 1", "path 2"]
    drawn = np.concatenate([xyz(entity.lines[0]) for entity in first.entities])
    np.testing.assert_array_equal(np.unique(drawn, axis=0), way[:2500])
    ends = [xyz(entity.lines[0])[[0, -1]] for entity in first.entities]
    np.testing.assert_array_equal(ends[0][1], ends[1][0])  # no gap between pieces
    assert changing(way[:2500]) is None
    assert [entity.id for entity in changing(way[:3500]).entities] == ["path 2", "path 3"]
    shorter = changing(way[:1200])
    assert [deletion.id for deletion in shorter.deletions] == ["path 2", "path 3"]
    assert [entity.id for entity in shorter.entities] == ["path 1"]
    other = way[:1200].copy()
    other[3] += 1
    assert [entity.id for entity in changing(other).entities] == ["path 0", "path 1"]
    assert [deletion.id for deletion in changing(way[:1]).deletions] == ["path 0", "path 1"]


def test_polar_image_becomes_a_fan_image() -> None:
    rows, beams = 40, 31
    bearings = np.linspace(-0.9, 0.9, beams).astype("<f4")
    pixels = np.zeros((rows, beams), np.uint8)
    targets = {(25, 3): 50, (35, 15): 100, (39, 30): 150, (20, 27): 200}
    for (row, beam), value in targets.items():
        pixels[row, beam] = value
    image = ImageMessage(
        stamp_ns=T0,
        ping_id=1,
        rows=rows,
        beams=beams,
        range_resolution_m=0.1,
        bearings_rad=bearings.tobytes(),
        body=zstandard.ZstdCompressor().compress(pixels.tobytes()),
    )
    bent = FanShape().fan_image(bearings_of(image), pixels)
    height, width = bent.shape
    for (row, beam), value in targets.items():
        there = np.argwhere(bent == value).mean(axis=0)
        across, ahead = there[1] + 0.5 - width / 2, height - (there[0] + 0.5)
        assert math.hypot(across, ahead) == pytest.approx(row + 0.5, abs=1.0)
        assert math.atan2(across, ahead) == pytest.approx(bearings[beam], abs=0.06)
    assert bent[0, 0] == bent[-1, 0] == bent[-1, -1] == 0


def test_rings_and_detections_lie_over_the_fan_image() -> None:
    rows, beams, step_m = 80, 61, 0.1
    bearings = np.linspace(-0.9, 0.9, beams).astype("<f4")
    pixels = np.zeros((rows, beams), np.uint8)
    pixels[60, 10] = 255
    image = ImageMessage(
        stamp_ns=T0,
        ping_id=1,
        rows=rows,
        beams=beams,
        range_resolution_m=step_m,
        bearings_rad=bearings.tobytes(),
        body=b"",
    )
    range_m, bearing = 60.5 * step_m, float(bearings[10])
    points = np.array([[range_m * math.cos(bearing), -range_m * math.sin(bearing), 0.0]], "<f4")
    returns = ReturnsMessage(stamp_ns=T0, ping_id=1, points=points.tobytes(), intensities=b"x")
    drawn = decoded(annotations(image, returns))
    fan = FanShape().fan_image(bearings_of(image), pixels)
    height, width = fan.shape
    *rings, detections = drawn.points
    y, x = np.argwhere(fan == 255).mean(axis=0) + 0.5
    (echo,) = detections.points
    assert (echo.x, echo.y) == pytest.approx((x, y), abs=1.0)
    assert [text.text for text in drawn.texts] == ["2 m", "4 m", "6 m", "8 m"]
    for ring, wanted_m in zip(rings, (2.0, 4.0, 6.0, 8.0), strict=True):
        for point in ring.points:
            radius = math.hypot(point.x - width / 2, point.y - height)
            assert radius * step_m == pytest.approx(wanted_m)
    coloured = decoded(colour_image(fan, "oculus", T0))
    assert (coloured.encoding, coloured.step) == ("rgb8", 3 * width)
    assert coloured.data == COLOURS[fan].tobytes()
    assert (np.diff(COLOURS.sum(axis=1, dtype=int)) >= 0).all()
    assert COLOURS[[0, 255]].tolist() == [[0, 0, 0], [255, 255, 255]]


def test_another_shape_gets_another_lookup_table() -> None:
    shape = FanShape()
    one = ImageMessage(
        stamp_ns=T0,
        ping_id=1,
        rows=4,
        beams=2,
        range_resolution_m=0.1,
        bearings_rad=np.array([-0.1, 0.1], "<f4").tobytes(),
        body=b"",
    )
    narrow = shape.fan_image(bearings_of(one), np.ones((4, 2), np.uint8))
    wide = msgspec.structs.replace(one, bearings_rad=np.array([-1.0, 1.0], "<f4").tobytes())
    assert shape.fan_image(bearings_of(wide), np.ones((4, 2), np.uint8)).shape != narrow.shape


@pytest.mark.parametrize(
    "pose",
    [
        None,
        "lost",
        {},
        {"x_m": 1.0, "y_m": math.nan, "yaw_rad": 0.0, "covariance": np.eye(3).tolist()},
        {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.0, "covariance": [[1.0]]},
        {"x_m": "1", "y_m": 2.0, "yaw_rad": 0.0, "covariance": np.eye(3).tolist()},
    ],
)
def test_an_estimate_that_is_invalid_is_not_drawn(pose: Any) -> None:
    client = FakeStream()
    client.feed(msgspec.structs.replace(LOCALIZATION, report={"pose": pose}))
    state = StateMessages(client)
    assert state.message("/localization/pose", S) is None
    assert not decoded(state.message("/localization/covariance", S)).entities


def test_nothing_is_reported_of_what_nobody_knows() -> None:
    state = StateMessages(FakeStream())
    changing = {topic for topic in state.topics if state.message(topic, S) is not None}
    assert changing == {"/status", "/settings"}
