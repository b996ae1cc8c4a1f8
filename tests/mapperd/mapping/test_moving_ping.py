"""From odometry bytes to the map: the samples of a moving sonar lie where their echoes came from.

The judge knows no first order: an echo that comes from bearing b after the time of 2r lies on the
ray of the sonar as it is then, where the way there and back is 2r.
"""

import math
from collections.abc import Callable

import msgspec
import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import (
    Config,
    MappingConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
    PositionConfig,
    SonarConfig,
)
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.build import build_pipeline
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.pose_lookup import OdometryPoses
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]
OdometryBytes = Callable[..., bytes]
Floats = NDArray[np.float64]
MS = 1_000_000
T0 = 1_700_000_000_000_000_000
SOUND_MPS = 1480.0
RESOLUTION_M, ROW = 0.6, 45  # 50 rows: 30 m
RANGE_M = (ROW + 0.5) * RESOLUTION_M
SPEED_MPS, RATE_RADPS = 1.0, math.radians(20.0)
VOXEL_M = 0.1
CONFIG = Config(
    octree=OctreeConfig(voxel_resolution=VOXEL_M),
    sonar=SonarConfig(vertical_aperture=1.0),
    mounting=MountingConfig(
        position=PositionConfig(x=20.0, y=10.0, z=0.0),
        orientation=OrientationConfig(pitch=0.0, yaw=40.0),
    ),
)
SENT_NS = T0 + 500 * MS


def base_at(t_ns: int) -> Pose:
    """On a circle of 2.9 m, to port."""
    turned = RATE_RADPS * (t_ns - T0) / 1e9
    radius_m = SPEED_MPS / RATE_RADPS
    position = (radius_m * math.sin(turned), radius_m * (1 - math.cos(turned)), -3.0)
    return pose_from_rpy(position, (0.0, 0.0, math.degrees(turned)))


def true_points(ping: Ping, base_T_sonar: Floats) -> Floats:  # noqa: N803 frames are named
    """(beams, 3), map frame."""
    heard_ns = SENT_NS + round(2 * RANGE_M / SOUND_MPS * 1e9)
    sent_m = (base_at(SENT_NS).map_T_base @ base_T_sonar)[:3, 3]
    heard = base_at(heard_ns).map_T_base @ base_T_sonar
    bearing = ping.bearings_rad
    rays = np.column_stack([np.cos(bearing), -np.sin(bearing), 0 * bearing]) @ heard[:3, :3].T
    apart = heard[:3, 3] - sent_m
    # |apart + s·ray| = 2r - s
    s = (4 * RANGE_M**2 - apart @ apart) / (2 * (rays @ apart + 2 * RANGE_M))
    points: Floats = heard[:3, 3] + s[:, None] * rays
    return points


def mapped(ping: MakePing, record: OdometryBytes, config: Config) -> tuple[SonarMap, Floats]:
    image = np.zeros((50, 65), dtype=np.uint8)
    image[ROW, ::8] = 250
    far = {"range_resolution_m": RESOLUTION_M, "speed_of_sound_mps": SOUND_MPS, "image": image}
    arrival_ns = SENT_NS + round(2 * 50 * RESOLUTION_M / SOUND_MPS * 1e9)
    one = ping(1, arrival_ns, **far)
    sonar_map = SonarMap(config)
    poses = OdometryPoses(config)
    executor = build_pipeline(sonar_map, poses, remarks=None).executor
    poses.add_ping(one)
    for k in range(21):
        pose = base_at(T0 + 50 * k * MS)
        data = record(p=tuple(pose.position_m.tolist()), q=tuple(pose.map_q_base.tolist()))
        poses.add_odometry("odometry", data, T0 + 50 * k * MS)
    for each, fused in poses.resolved(T0 + 1000 * MS):
        executor.map_ping(PosedPing(0, each, fused, None))
    assert executor.counters.pings_mapped == 1
    return sonar_map, true_points(one, sonar_map.base_T_sonar)[::8]


def errors_m(sonar_map: SonarMap, points: Floats) -> Floats:
    """From each point to the middle of the occupied voxels around it."""
    centres = sonar_map.voxels("occupied").centres_m
    apart = np.linalg.norm(centres[:, None] - points[None], axis=2)
    owner = apart.argmin(axis=1)
    middles = [centres[owner == k].mean(axis=0) for k in range(len(points))]
    return np.asarray(np.linalg.norm(np.asarray(middles) - points, axis=1))


def test_samples_lie_where_their_echoes_came_from(
    ping: MakePing, odometry_bytes: OdometryBytes
) -> None:
    mapping = MappingConfig(detail=8.0)
    config = msgspec.structs.replace(CONFIG, mapping=mapping)
    found = errors_m(*mapped(ping, odometry_bytes, config))
    assert found.max() < 0.03, found
    rigid = msgspec.structs.replace(mapping, within_ping_motion=False)
    without = errors_m(
        *mapped(ping, odometry_bytes, msgspec.structs.replace(config, mapping=rigid))
    )
    # 27 m at 20°/s from the middle of the image to the echo's return: 16 ms, 15 cm and more.
    assert np.median(without) > 0.15, without
