"""Foxglove messages of the newest state of the map stream."""

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd.client.changes import ConnectionStatus
from mapperd.client.mirror import MapMirror
from mapperd.client.validation import image_of
from mapperd.foxglove.geometry import (
    Frames,
    odometry,
    particle_poses,
    planar_fix,
    pose_in_frame,
    transforms,
)
from mapperd.foxglove.map_publisher import returns_cloud, scan_cloud
from mapperd.foxglove.scene import covariance_scene, fan_scene, robots_scene
from mapperd.foxglove.sonar_image import FanShape, annotations, colour_image, polar_image
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

__all__ = ["Follows", "StateMessages", "values_of"]


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
        facts = mirror.facts if mirror else welcome.map if welcome else None
        return Frames(facts.frame if facts else "map", self._client.settings)

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
        pixels = self._shape.fan_image(image, image_of(image))
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
