"""What calibration needs of a recording: images and times of its pings, and the vehicle's path."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from mapperd.config.tree import Config
from mapperd.errors import MapError, Reject, ReplayError
from mapperd.imaging.ping_image import PingImage, ping_image_of
from mapperd.odometry.fusion import PoseSampler
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PosedPing, SessionDecoder, Work
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.recordings import RecordedSession

__all__ = ["CalibrationDive", "VehicleMotion", "read_dive"]

Floats = NDArray[np.float64]

MAX_ROWS, MAX_BEAMS = 400, 256
"""Size of the kept images; larger ones are averaged."""

MAX_PINGS = 250
"""Number of kept pings, evenly over the recording."""

MIN_PINGS = 50

POSE_STEP_NS = 20_000_000

MARGIN_S = 0.6
"""A ping keeps so much distance from the ends of the path, for time offsets."""

SMOOTHING_S = 0.06
"""Standard deviation of the smoothing of the path: noise of single records goes, turns stay."""

DIFFERENCE_S = 0.02
"""Half the step of the differences that give velocities."""


@dataclass(frozen=True, slots=True, eq=False)
class VehicleMotion:
    """Pose and motion of the base at the times of the pings.

    Attributes:
        rotation: (N, 3, 3), base to map.
        position_m: (N, 3), map frame.
        rate_radps: (N, 3), base frame.
        velocity_mps: (N, 3), base frame.
    """

    rotation: Floats
    position_m: Floats
    rate_radps: Floats
    velocity_mps: Floats


@dataclass(eq=False)
class CalibrationDive:
    """Pings of one recording with equal ranges, and the path of the vehicle.

    Attributes:
        images: (N, rows, beams) float32, 0..255, row 0 nearest, most negative bearing first.
        t_s: (N,) times of the pings, seconds.
        row_m: thickness of a row.
        first_sine, sine_step: sine of the first column's bearing and its step; positive to
            starboard.
        sound_mps: speed of sound that the ranges were computed with.
        path_s, path_m: (M,) and (M, 3), times and positions of the base, map frame.
        attitudes: M rotations, base to map.
        refitted: sources of odometry whose clock was fitted again within the recording, so that the
            time between pings and poses changes.
    """

    images: NDArray[np.float32]
    t_s: Floats
    row_m: float
    first_sine: float
    sine_step: float
    sound_mps: float
    path_s: Floats
    path_m: Floats
    attitudes: Rotation
    refitted: tuple[str, ...] = ()
    _slerp: Slerp = field(init=False)

    def __post_init__(self) -> None:
        self._slerp = Slerp(self.path_s, self.attitudes)

    @property
    def range_m(self) -> float:
        """Far edge of the last row."""
        return float(self.images.shape[1] * self.row_m)

    def motion(self, offset_s: float) -> VehicleMotion:
        """Return the motion at the times of the pings plus an offset.

        Args:
            offset_s: at most `MARGIN_S` less `DIFFERENCE_S` to either side.
        """
        t_s = self.t_s + offset_s
        rotation, position_m = self._pose(t_s)
        (before, before_m), (after, after_m) = (
            self._pose(t_s + step_s) for step_s in (-DIFFERENCE_S, DIFFERENCE_S)
        )
        span_s = 2 * DIFFERENCE_S
        turns = Rotation.from_matrix(np.einsum("nji,njk->nik", before, after)).as_rotvec()
        velocity = np.einsum("nji,nj->ni", rotation, (after_m - before_m) / span_s)
        return VehicleMotion(rotation, position_m, turns / span_s, velocity)

    def drift(
        self,
        motion: VehicleMotion,
        mounting: Floats,
        lever_m: Floats,
        ping: NDArray[np.intp],
        sonar: Floats,
    ) -> Floats:
        """Return how the sonar's motion within the ping shifts points, (N, 3) m, sonar frame.

        Poses hold when sound has reached the middle of the image. Ranges come about at the echo,
        bearings at the reception.

        Args:
            motion: of the base.
            mounting: (3, 3), sonar to base.
            lever_m: (3,) position of the sonar in the base.
            ping: (N,) index of each point's ping.
            sonar: (N, 3) points, sonar frame.
        """
        range_m = np.sqrt(np.einsum("ni,ni->n", sonar, sonar))
        middle_m = self.range_m / 2
        echo_s = (range_m - middle_m) / self.sound_mps
        reception_s = (2 * range_m - middle_m) / self.sound_mps
        velocity = (motion.velocity_mps + np.cross(motion.rate_radps, lever_m)) @ mounting
        turned = np.cross((motion.rate_radps @ mounting)[ping], sonar)
        shift: Floats = velocity[ping] * echo_s[:, None] + turned * reception_s[:, None]
        return shift

    def _pose(self, t_s: Floats) -> tuple[Floats, Floats]:
        columns = [np.interp(t_s, self.path_s, column) for column in self.path_m.T]
        return self._slerp(t_s).as_matrix(), np.stack(columns, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _KeptImage:
    t_ns: int
    image: NDArray[np.float32]
    row_m: float
    first_sine: float
    sine_step: float
    sound_mps: float


class _Thinned:
    """Pings, evenly over the recording, few enough to hold."""

    def __init__(self) -> None:
        self.count = 0
        self.kept: list[_KeptImage] = []
        self._every = 1

    def add(self, ping: _KeptImage) -> None:
        if self.count % self._every == 0:
            self.kept.append(ping)
        self.count += 1
        if len(self.kept) == 2 * MAX_PINGS:
            del self.kept[1::2]
            self._every *= 2


def read_dive(
    session: RecordedSession, config: Config, progress: Callable[[float], None] = lambda _: None
) -> CalibrationDive:
    """Read the pings and the path of a recorded session.

    Of a sonar whose range or mode changed, the images of the most common size are read.

    Args:
        session: with sonar data and odometry.
        config: settings of the odometry and of the sonar.
        progress: called with the share of the recording that is read.

    Raises:
        ReplayError: it has too few pings with poses.
        RecordingError: the recording cannot be read.
    """
    poses = OdometryPoses(config)
    decoder = SessionDecoder(config, poses, PipelineCounters(), confirm=True, obey=False)
    path = PoseSampler(poses.odometry.fusion, POSE_STEP_NS)
    alike: dict[object, _Thinned] = {}
    for work, arrival_ns in _works(session, decoder):
        path.advance(arrival_ns)
        for ping in _pings(work, config):
            alike.setdefault((ping.image.shape, ping.row_m), _Thinned()).add(ping)
        progress(session.bytes_read / max(session.size_bytes, 1))
    path.finish()
    most = max(alike.values(), key=lambda pings: pings.count, default=_Thinned())
    return _dive(most.kept, path)


def _works(
    session: RecordedSession, decoder: SessionDecoder
) -> Iterator[tuple[list[Work], int | None]]:
    for chunk in session:
        yield decoder.feed(chunk), chunk.arrival_ns
    yield decoder.end(), None


def _pings(works: Sequence[Work], config: Config) -> Iterator[_KeptImage]:
    for work in works:
        if not isinstance(work, PosedPing) or work.t_ns is None or isinstance(work.pose, Reject):
            continue
        try:
            image = ping_image_of(work.ping, config.sonar)
        except MapError:
            continue
        yield _kept(image, work.t_ns, work.ping.credible_speed_of_sound_mps)


def _kept(image: PingImage, t_ns: int, sound_mps: float) -> _KeptImage:
    """Average rows and beams to the kept size."""
    rows, beams = image.intensity.shape
    by_row, by_beam = -(-rows // MAX_ROWS), -(-beams // MAX_BEAMS)
    height, width = rows // by_row, beams // by_beam
    whole = image.intensity[: height * by_row, : width * by_beam]
    small = whole.reshape(height, by_row, width, by_beam).mean(axis=(1, 3))
    sines = np.sin(image.bearings_rad[: width * by_beam]).reshape(width, by_beam).mean(axis=1)
    step = float(sines[-1] - sines[0]) / max(width - 1, 1)
    row_m = image.range_resolution_m * by_row
    return _KeptImage(t_ns, small.astype(np.float32), row_m, float(sines[0]), step, sound_mps)


def _dive(kept: list[_KeptImage], path: PoseSampler) -> CalibrationDive:
    zero_ns = path.t_ns[0] if path.t_ns else 0
    path_s = (np.array(path.t_ns) - zero_ns) / 1e9
    t_s = np.array([(one.t_ns - zero_ns) / 1e9 for one in kept])
    if len(path_s):
        inside = (t_s > path_s[0] + MARGIN_S) & (t_s < path_s[-1] - MARGIN_S)
        places = np.flatnonzero(inside)
    else:
        places = np.zeros(0, dtype=np.intp)
    if len(places) < MIN_PINGS:
        raise ReplayError(
            f"{len(places)} pings have poses before and after them; calibration needs {MIN_PINGS}"
        )
    if len(places) > MAX_PINGS:
        places = places[np.linspace(0, len(places) - 1, MAX_PINGS).round().astype(np.intp)]
    first = kept[places[0]]
    poses = [fused.pose for fused in path.poses]
    position_m, attitudes = _smoothed(
        np.array([pose.position_m for pose in poses]), np.array([pose.map_q_base for pose in poses])
    )
    return CalibrationDive(
        np.stack([kept[place].image for place in places]),
        t_s[places],
        first.row_m,
        first.first_sine,
        first.sine_step,
        first.sound_mps,
        path_s,
        position_m,
        attitudes,
        path.refitted(),
    )


def _smoothed(position_m: Floats, quaternion: Floats) -> tuple[Floats, Rotation]:
    """Smooth a path; quaternions (w, x, y, z) are first given signs that follow each other."""
    steps = np.sum(quaternion[1:] * quaternion[:-1], axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(steps < 0, -1.0, 1.0)]))
    width = SMOOTHING_S / (POSE_STEP_NS / 1e9)
    even = gaussian_filter1d(quaternion * signs[:, None], width, axis=0, mode="nearest")
    return (
        gaussian_filter1d(position_m, width, axis=0, mode="nearest"),
        Rotation.from_quat(even[:, [1, 2, 3, 0]]),
    )
