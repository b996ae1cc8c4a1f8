"""The demo's survey: how a vehicle passes through the harbour to see it from several sides.

A ping does not know an echo's elevation, so a surface is only sharp where the fan cuts it along
its normal. Legs along the quay, rolled towards it, cut the quay; legs across them cut the piles'
and the wreck's other sides, and carve away what the first legs smeared along the track.
"""

from sonar_sim.trajectory import Motion, Trajectory, Waypoint

CRUISE_Z_M = -2.6
ROLL_TO_QUAY_DEG = 25.0


def harbour_survey() -> Trajectory:
    """Drive two legs along the quay and three across."""
    z = CRUISE_Z_M
    return Trajectory(
        [
            Waypoint(-6.2, 1.2, z, 0.0, ROLL_TO_QUAY_DEG),
            Waypoint(6.2, 1.2, z, 0.0, ROLL_TO_QUAY_DEG),
            Waypoint(6.2, -0.5, z, 0.0, ROLL_TO_QUAY_DEG),
            Waypoint(6.2, -3.8, z, 0.0),
            Waypoint(4.5, -3.8, z, 180.0),
            Waypoint(-4.5, -3.8, z, 180.0),
            Waypoint(-2.8, -4.2, z, 90.0),
            Waypoint(-2.8, 2.9, z, 90.0),
            Waypoint(0.0, 2.9, z, 90.0),
            Waypoint(0.0, -4.2, z, 90.0),
            Waypoint(2.8, -4.2, z, 90.0),
            Waypoint(2.8, 2.9, z, 90.0),
        ],
        Motion(),
    )
