"""Foxglove messages of the newest state of the map stream.

The sonar's image is polar, and a fan with range rings and detections over it.
"""

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, Protocol

import numpy as np
from foxglove.messages import (
    Color,
    ImageAnnotations,
    Point2,
    PointsAnnotation,
    PointsAnnotationType,
    RawImage,
    TextAnnotation,
)
from numpy.typing import NDArray

from mapperd.client.changes import ConnectionStatus
from mapperd.client.mirror import MapMirror
from mapperd.client.validation import bearings_of, image_of
from mapperd.foxglove.geometry import (
    Frames,
    covariance_scene,
    fan_scene,
    odometry,
    particle_poses,
    planar_fix,
    pose_in_frame,
    robots_scene,
    stamp,
    transforms,
)
from mapperd.foxglove.map_publisher import returns_cloud, scan_cloud
from mapperd.imaging.ping_image import COLOURS, FanShape, fan_edges, fan_half_width
from mapperd.wire.messages import (
    FanMessage,
    ImageMessage,
    LocalizationMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
    StatusMessage,
    WelcomeMessage,
)
from oculus_driver.fan import ring_ranges_m

__all__ = [
    "Follows",
    "StateMessages",
    "annotations",
    "colour_image",
    "polar_image",
    "values_of",
]

RING = Color(r=0.6, g=0.7, b=0.8, a=0.6)
INK = Color(r=0.9, g=0.95, b=1.0, a=1.0)
BACKGROUND = Color(r=0.0, g=0.0, b=0.0, a=0.5)
DETECTION = Color(r=0.3, g=0.9, b=0.5, a=1.0)
RING_POINTS = 49
DETECTION_PX = 4.0
LETTERS_PX = 16.0


def polar_image(pixels: NDArray[np.uint8], frame: str, stamp_ns: int) -> RawImage:
    """Grey image message."""
    height, width = pixels.shape
    return RawImage(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        width=width,
        height=height,
        encoding="mono8",
        step=width,
        data=pixels.tobytes(),
    )


def colour_image(pixels: NDArray[np.uint8], frame: str, stamp_ns: int) -> RawImage:
    """Image message in the colours of `COLOURS`."""
    height, width = pixels.shape
    return RawImage(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        width=width,
        height=height,
        encoding="rgb8",
        step=3 * width,
        data=COLOURS[pixels].tobytes(),
    )


def annotations(image: ImageMessage, returns: ReturnsMessage) -> ImageAnnotations:
    """Return range rings with metres, and detections, in pixels of the fan image.

    Args:
        image: gives the geometry.
        returns: detections, in the sonar's frame.
    """
    low, high = fan_edges(bearings_of(image))
    bearings = np.linspace(low, high, RING_POINTS)
    rings, texts = [], []
    for range_m in ring_ranges_m(image.rows * image.range_resolution_m):
        arc = _pixels(image, range_m * np.cos(bearings), -range_m * np.sin(bearings))
        rings.append(_points(PointsAnnotationType.LineStrip, arc, RING, 1.0))
        text = TextAnnotation(
            position=arc[-1],
            text=f"{range_m:g} m",
            font_size=LETTERS_PX,
            text_color=INK,
            background_color=BACKGROUND,
        )
        texts.append(text)
    points_m = np.frombuffer(returns.points, "<f4").reshape(-1, 3).astype(np.float64)
    echoes = _pixels(image, points_m[:, 0], points_m[:, 1])
    detections = _points(PointsAnnotationType.Points, echoes, DETECTION, DETECTION_PX)
    return ImageAnnotations(
        timestamp=stamp(returns.stamp_ns), points=[*rings, detections], texts=texts
    )


def _pixels(
    image: ImageMessage, forward_m: NDArray[np.float64], port_m: NDArray[np.float64]
) -> list[Point2]:
    """Places in the fan image."""
    across = fan_half_width(bearings_of(image), image.rows) - port_m / image.range_resolution_m
    down = image.rows - forward_m / image.range_resolution_m
    return [Point2(x=x, y=y) for x, y in zip(across.tolist(), down.tolist(), strict=True)]


def _points(
    kind: PointsAnnotationType, points: list[Point2], colour: Color, thickness_px: float
) -> PointsAnnotation:
    return PointsAnnotation(
        type=kind,
        points=points,
        outline_color=colour,
        outline_colors=[],
        fill_color=colour,
        thickness=thickness_px,
    )


class Follows(Protocol):
    """The state of a map stream client."""

    @property
    def mirror(self) -> MapMirror | None: ...  # noqa: D102
    @property
    def link(self) -> ConnectionStatus: ...  # noqa: D102
    @property
    def welcome(self) -> WelcomeMessage | None: ...  # noqa: D102
    @property
    def pose(self) -> PoseMessage | None: ...  # noqa: D102
    @property
    def path(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def fan(self) -> FanMessage | None: ...  # noqa: D102
    @property
    def returns(self) -> ReturnsMessage | None: ...  # noqa: D102
    @property
    def image(self) -> ImageMessage | None: ...  # noqa: D102
    @property
    def robots(self) -> RobotsMessage | None: ...  # noqa: D102
    @property
    def localization(self) -> LocalizationMessage | None: ...  # noqa: D102
    @property
    def status(self) -> StatusMessage | None: ...  # noqa: D102
    @property
    def settings(self) -> Mapping[str, Any]: ...  # noqa: D102


class StateMessages:
    """Makes the message of a topic on demand.

    Args:
        client: source of the state.
    """

    def __init__(self, client: Follows) -> None:
        self._client = client
        self._shape = FanShape()
        self._makers: Mapping[str, Callable[[int], Any]] = {
            "/tf": lambda _: self._of_pose(transforms),
            "/pose": lambda _: self._of_pose(pose_in_frame),
            "/odometry": lambda _: self._of_pose(odometry),
            "/fan": self._fan,
            "/returns": self._returns,
            "/sonar/polar": self._polar,
            "/sonar/fan": self._fan_image,
            "/sonar/annotations": self._annotations,
            "/robots": self._robots,
            "/localization/particles": self._particles,
            "/localization/pose": self._fix,
            "/localization/covariance": self._covariance,
            "/localization/scan": self._scan,
            "/localization/report": self._report,
            "/status": self._status,
            "/settings": self._settings,
        }

    @property
    def topics(self) -> Collection[str]:
        """Topics that have messages."""
        return self._makers.keys()

    def message(self, topic: str, stamp_ns: int) -> Any:  # noqa: ANN401 one class for each topic
        """Return the message of a topic, or None while there is no data.

        Args:
            topic: one of `topics`.
            stamp_ns: stamp of messages without one of their own.
        """
        return self._makers[topic](stamp_ns)

    def frames(self) -> Frames:
        """Frame names of the daemon."""
        welcome, mirror = self._client.welcome, self._client.mirror
        info = mirror.info if mirror else welcome.map if welcome else None
        return Frames(info.frame if info else "map", self._client.settings)

    def _of_pose(self, make: Callable[[PoseMessage, Frames], Any]) -> Any:  # noqa: ANN401 as above
        pose = self._client.pose
        return None if pose is None else make(pose, self.frames())

    def _fan(self, stamp_ns: int) -> Any:  # noqa: ANN401 as above
        fan = self._client.fan
        return None if fan is None else fan_scene(fan, self.frames().sonar, stamp_ns)

    def _returns(self, _: int) -> Any:  # noqa: ANN401 as above
        returns, frames = self._client.returns, self.frames()
        return None if returns is None else returns_cloud(returns, frames.map, frames.sonar)

    def _polar(self, _: int) -> Any:  # noqa: ANN401 as above
        image = self._client.image
        if image is None:
            return None
        return polar_image(image_of(image), self.frames().sonar, image.stamp_ns)

    def _fan_image(self, _: int) -> Any:  # noqa: ANN401 as above
        image = self._client.image
        if image is None:
            return None
        pixels = self._shape.fan_image(bearings_of(image), image_of(image))
        return colour_image(pixels, self.frames().sonar, image.stamp_ns)

    def _annotations(self, _: int) -> Any:  # noqa: ANN401 as above
        image, returns = self._client.image, self._client.returns
        return None if image is None or returns is None else annotations(image, returns)

    def _robots(self, stamp_ns: int) -> Any:  # noqa: ANN401 as above
        robots = self._client.robots
        return None if robots is None else robots_scene(robots, self.frames().map, stamp_ns)

    def _particles(self, stamp_ns: int) -> Any:  # noqa: ANN401 as above
        localization = self._client.localization
        if localization is None:
            return None
        return particle_poses(localization, self.frames().map, self._height_m(), stamp_ns)

    def _fix(self, stamp_ns: int) -> Any:  # noqa: ANN401 as above
        fix = self._best()
        if fix is None:
            return None
        return planar_fix(fix, self.frames().map, self._height_m(), stamp_ns)

    def _covariance(self, stamp_ns: int) -> Any:  # noqa: ANN401 as above
        if self._client.localization is None:
            return None
        return covariance_scene(self._best(), self.frames().map, self._height_m(), stamp_ns)

    def _scan(self, stamp_ns: int) -> Any:  # noqa: ANN401 as above
        localization = self._client.localization
        if localization is None:
            return None
        return scan_cloud(localization, self.frames().map, stamp_ns)

    def _report(self, _: int) -> Any:  # noqa: ANN401 as above
        localization = self._client.localization
        return None if localization is None else localization.report

    def _status(self, _: int) -> Any:  # noqa: ANN401 as above
        status, link = self._client.status, self._client.link
        return {
            "connection": {
                "state": link.state,
                "address": link.address,
                "reason": link.reason,
                "connects": link.connects,
                "bytes": link.bytes,
            },
            "stream": status.link if status else {},
            "daemon": status.status if status else {},
        }

    def _settings(self, _: int) -> Any:  # noqa: ANN401 as above
        return values_of(self._client.settings)

    def _best(self) -> Mapping[str, Any] | None:
        """Pose from localization; None if it is absent or incomplete."""
        localization = self._client.localization
        fix = localization.report.get("pose") if localization else None
        if not isinstance(fix, Mapping):
            return None
        try:
            numbers = [fix["x_m"], fix["y_m"], fix["yaw_rad"]]
            covariance = np.asarray(fix["covariance"], np.float64)
            finite = all(math.isfinite(number) for number in numbers)
        except (KeyError, TypeError, ValueError):
            return None
        good = covariance.shape == (3, 3) and np.isfinite(covariance).all()
        return fix if finite and good else None

    def _height_m(self) -> float:
        pose = self._client.pose
        return pose.position_m[2] if pose else 0.0


def values_of(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Values of settings by name."""
    return {name: fact["value"] for name, fact in facts.items() if "value" in fact}
