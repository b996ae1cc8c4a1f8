"""The vehicle's odometry as native records: one MessagePack map each."""

import msgpack

from sonar_sim.vehicle import OdometrySample

FORMAT_VERSION = 1


def odometry_record(sample: OdometrySample, unix_ns: int) -> bytes:
    """Encode what the vehicle's navigation says at one time.

    Args:
        sample: what it says.
        unix_ns: the time of its validity.

    Returns:
        A MessagePack map: position and quaternion of the base (FLU) in the map (ENU), velocity
        in m/s and turn rates in rad/s in the body frame.
    """
    record = {
        "v": FORMAT_VERSION,
        "t": unix_ns,
        "clk": "unix",
        "w": "enu",
        "b": "flu",
        "p": sample.pose.position_m.tolist(),
        "q": sample.pose.quaternion.tolist(),
        "u": sample.velocity_mps.tolist(),
        "r": sample.turn_rates_rps.tolist(),
        "rst": 0,
        "src": "sonar_sim",
    }
    packed: bytes = msgpack.packb(record)
    return packed
