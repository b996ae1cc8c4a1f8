"""A record of any maker is checked once more where it enters: what it holds are numbers.

The formats check what comes from a wire, by the limits of each quantity. Records may also be made
by a program that uses the library; one NaN of such a one would stay in the series, and every pose
beside it could not be made.
"""

from mapperd.geometry.frames import UNIT_TOLERANCE
from mapperd.odometry.convert import bad_numbers
from mapperd.odometry.records import Odometry
from mapperd.reject import Reject

__all__ = ["bad_record"]

LARGEST = 1e12
"""Of any number, in its unit: nobody is so far off, so fast, or so unsure."""

ARRAYS = (
    "position_m",
    "velocity_mps",
    "rate_radps",
    "velocity_map_mps",
    "velocity_east_north_mps",
    "specific_force_mps2",
    "pose_covariance",
    "twist_covariance",
)
NUMBERS = ("depth_m", "heading_rad", "altitude_m", "confidence")


def bad_record(odometry: Odometry) -> Reject | None:
    """Why a record is of no use: it holds what is no number, no possible one, or no rotation."""
    for key in ARRAYS:
        array = getattr(odometry, key)
        if array is not None and (bad := bad_numbers(key, array.ravel().tolist(), LARGEST)):
            return bad
    scalars = [getattr(odometry, key) for key in NUMBERS]
    if (geo := odometry.geo) is not None:
        scalars += [geo.latitude_rad, geo.longitude_rad, geo.altitude_m]
    said = [number for number in scalars if number is not None]
    if bad := bad_numbers("the record", said, LARGEST):
        return bad
    if (turn := odometry.map_q_base) is None:
        return None
    square = sum(number * number for number in turn.tolist())
    if not abs(square - 1.0) <= UNIT_TOLERANCE:  # also where it is NaN
        return Reject("no_rotation", f"map_q_base has the norm {square**0.5:.4g}, not 1")
    return None
