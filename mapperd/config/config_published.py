"""Sections of the published mapper that tell a ROS node what to call things and what to show.

Here they name frames in telemetry and draw debug pictures. What only a ROS node could do keeps its
name and its default, so that files written for it load; any other value is refused with what to
say instead.
"""

from typing import Annotated

from msgspec import Struct

from mapperd.config.field import rule

__all__ = ["Frames", "Topics", "Visualization"]

FRAME_PATTERN = "[A-Za-z0-9][A-Za-z0-9_/-]{0,63}"

NO_NODE = "this is no ROS node; the map's files and mapperctl show it"

INSTEAD = {
    "sonar": ("/sensor/sonar/oculus/m750d/image", "set device.address: the sonar itself"),
    "odometry": ("/fast_lio/odometry", "set odometry.sources"),
    "pointcloud": ("/sonar_3d_map", NO_NODE),
    "marker": ("/sonar_3d_map_markers", NO_NODE),
}
"""Topic to its default, and what to do instead of saying another."""

CLOUD_RATE_HZ = 10.0


class Frames(Struct, frozen=True, forbid_unknown_fields=True):
    """What telemetry, and bags of ROS 2, call the frames of reference."""

    sonar: Annotated[str, rule("Frame of the sonar.", "a name", pattern=f"^{FRAME_PATTERN}$")] = (
        "sonar_link"
    )
    base: Annotated[str, rule("Frame of the vehicle.", "a name", pattern=f"^{FRAME_PATTERN}$")] = (
        "base_link"
    )
    map: Annotated[str, rule("Frame of the map.", "a name", pattern=f"^{FRAME_PATTERN}$")] = "map"
    publish_tf: Annotated[
        bool, rule("Publish where the sonar sits on the vehicle, and again when that changes.")
    ] = True


class Topics(Struct, frozen=True, forbid_unknown_fields=True):
    """Topics of ROS, which bags have: their defaults load, and nothing listens there."""

    sonar: Annotated[
        str, rule("Images of the sonar; instead: `device.address`.", "the default")
    ] = INSTEAD["sonar"][0]
    odometry: Annotated[str, rule("Odometry; instead: `odometry.sources`.", "the default")] = (
        INSTEAD["odometry"][0]
    )
    pointcloud: Annotated[str, rule("The map as a cloud of points.", "the default")] = INSTEAD[
        "pointcloud"
    ][0]
    marker: Annotated[str, rule("The map as markers.", "the default")] = INSTEAD["marker"][0]

    def __post_init__(self) -> None:
        """Refuse what would be waited for in vain."""
        for name, (default, instead) in INSTEAD.items():
            if getattr(self, name) != default:
                raise ValueError(f"{name} can only be {default}: {instead}")


class Visualization(Struct, frozen=True, forbid_unknown_fields=True):
    """What is shown while mapping."""

    show_opencv_visualization: Annotated[
        bool,
        rule(
            "Draw what the filters make of the pings, once a second, into `debug` in the state "
            "folder; a daemon has no windows.",
            live=True,
        ),
    ] = False
    pointcloud_publish_rate: Annotated[
        float,
        rule(
            "Of clouds of points, which nothing publishes: only the default.",
            "Hz",
            live=True,
            gt=0,
            le=1000,
        ),
    ] = CLOUD_RATE_HZ
    tile_save_interval: Annotated[
        float,
        rule("Between saves of the map on disk.", "s", live=True, gt=0, le=3600),
    ] = 5.0

    def __post_init__(self) -> None:
        """Refuse what would do nothing."""
        if self.pointcloud_publish_rate != CLOUD_RATE_HZ:
            raise ValueError(
                f"pointcloud_publish_rate can only be {CLOUD_RATE_HZ:g}: no cloud is published; "
                "mqtt.pose_rate is the telemetry's"
            )
