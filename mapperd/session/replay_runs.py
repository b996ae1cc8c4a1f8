"""Sessions of recordings, ready to be mapped: with settings of today, or as they were mapped."""

import time
from collections.abc import Sequence

import numpy as np

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.errors import ReplayError
from mapperd.geometry.frames import Pose
from mapperd.localization.session import Localizing, begun, begun_again
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import ReplayCounters
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.recordings import RecordedSession
from mapperd.session.replay import Replay, Window
from mapperd.session_log import Remarks, Session, remarks_in

__all__ = ["Run", "as_asked", "as_recorded", "not_empty"]


class Run:
    """A session that is to be mapped: what with, and what was decided in it.

    Args:
        session: its recordings.
        config: the settings at its beginning.
        pose: of a vehicle that stood still; None takes the odometry.
        remarks: what was decided, to be decided again; None decides anew.
        localizing: None where that is off.

    Attributes:
        session, config, remarks: as given.
        poses: of its pings.
        onboard: localizes.
    """

    def __init__(
        self,
        session: RecordedSession,
        config: Config,
        pose: Pose | None,
        remarks: Remarks | None,
        localizing: Localizing | None = None,
    ) -> None:
        self.session = session
        self.config = config
        self.poses = OdometryPoses(config) if pose is None else FixedPose(pose)
        self.remarks = remarks
        self.onboard = None if localizing is None else localizing.onboard

    def replay(
        self, sonar_map: SonarMap, window: Window, counters: ReplayCounters | None = None
    ) -> Replay:
        """The session on its way into a map, which takes the session's settings now."""
        sonar_map.reconfigure(self.config)
        return Replay(
            sonar_map,
            self.poses,
            window,
            time.perf_counter,
            confirm=self.session.session is None,
            remarks=self.remarks,
            counters=counters,
            onboard=self.onboard,
        )


def not_empty(sessions: Sequence[RecordedSession]) -> Sequence[RecordedSession]:
    """Those with anything in them: who was killed before the first piece leaves one without."""
    return [session for session in sessions if any(True for _ in session)] or sessions


def as_asked(session: RecordedSession, pose: Pose | None, config: Config) -> Run:
    """With settings of today.

    Raises:
        ConfigError: localization cannot begin with them.
    """
    return Run(session, config, pose, None, begun(config))


def as_recorded(session: RecordedSession) -> Run:
    """As it was mapped.

    Raises:
        ReplayError: nobody knows how that was.
        ConfigError: its settings are none of this version.
    """
    beginning = session.beginning()
    if beginning is None:
        raise ReplayError(
            f"{session.paths[0].name} does not begin a session of the daemon, so nobody knows how "
            "it was mapped; begin with the session's first file, or leave out --as-recorded"
        )
    config = config_of(beginning.settings, f"settings in {session.paths[0].name}")
    localizing = begun_again(config, beginning)
    return Run(session, config, _pose_of(beginning), remarks_in(session), localizing)


def _pose_of(beginning: Session) -> Pose | None:
    if beginning.pose is None:
        return None
    return Pose(np.array(beginning.pose[:3]), np.array(beginning.pose[3:]))
