"""The vehicle's odometry as native records: one MessagePack map each."""

from dataclasses import dataclass

import msgpack
import numpy as np

from sonar_sim.poses import Pose, rotation_of
from sonar_sim.trajectory import Trajectory

FORMAT_VERSION = 1


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Standard deviations of the white error of each record."""

    position_m: float = 0.005
    attitude_deg: float = 0.1


def odometry_record(
    trajectory: Trajectory,
    time_s: float,
    unix_ns: int,
    noise: OdometryNoise,
    generator: np.random.Generator,
) -> bytes:
    """Encode what the vehicle's navigation says at one time.

    Args:
        trajectory: the true path.
        time_s: time on the path.
        unix_ns: the same instant as Unix time.
        noise: error to add to the pose.
        generator: where the error comes from.

    Returns:
        A MessagePack map: position and quaternion of the base (FLU) in the map (ENU), velocity
        in m/s and turn rates in rad/s in the body frame.
    """
    errors = generator.standard_normal(6)
    tilt = rotation_of(*(np.radians(noise.attitude_deg) * errors[3:]))
    measured = trajectory.pose(time_s) @ Pose(noise.position_m * errors[:3], tilt)
    record = {
        "v": FORMAT_VERSION,
        "t": unix_ns,
        "clk": "unix",
        "w": "enu",
        "b": "flu",
        "p": measured.position_m.tolist(),
        "q": measured.quaternion.tolist(),
        "u": trajectory.velocity_mps(time_s).tolist(),
        "r": trajectory.turn_rates_rps(time_s).tolist(),
        "rst": 0,
        "src": "sonar_sim",
    }
    packed: bytes = msgpack.packb(record)
    return packed
