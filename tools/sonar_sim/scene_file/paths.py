"""Paths and motions of a scene's file."""

from sonar_sim.errors import SceneError
from sonar_sim.motions import Drift, ObjectMotion, Tour
from sonar_sim.scene_file import schema
from sonar_sim.trajectory import Motion, Trajectory, Waypoint

Triple = tuple[float, float, float]


def path_of(section: schema.PathSection) -> Trajectory:
    """Build a path.

    Raises:
        SceneError: it has no two waypoints that differ.
    """
    waypoints = [Waypoint(*w.position_m, w.yaw_deg, w.roll_deg) for w in section.waypoints]
    if len(set(waypoints)) < 2:  # noqa: PLR2004 a path has two ends
        raise SceneError("a path needs two waypoints that differ")
    motion = Motion(
        section.speed_mps,
        section.turn_rate_dps,
        section.smoothing_s,
        section.sway_deg,
        section.heave_m,
    )
    return Trajectory(waypoints, motion)


def motion_of(
    section: schema.DriftMotion | schema.TourMotion | None,
    position_m: Triple,
    roll_pitch_yaw_deg: Triple,
) -> ObjectMotion | None:
    """Build a motion that begins at a place; a tour has its own.

    Raises:
        SceneError: its path cannot be.
    """
    match section:
        case None:
            return None
        case schema.TourMotion(path=path):
            return Tour(path_of(path))
        case schema.DriftMotion():
            return Drift(
                position_m,
                *roll_pitch_yaw_deg,
                velocity_mps=section.velocity_mps,
                yaw_rate_dps=section.yaw_rate_dps,
                swing_m=section.swing_m,
                swing_deg=section.swing_deg,
                period_s=section.period_s,
                phase_deg=section.phase_deg,
            )
