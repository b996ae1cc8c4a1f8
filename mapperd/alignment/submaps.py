"""Submaps of a dive: short pieces of odometry, mapped in frames of their own.

Odometry is trusted over a few seconds. The pings of a piece make one small map in the levelled
frame of its middle ping: x forward, y to port, z up and absolute. Depth, roll and pitch come from
sensors, so submaps differ by x, y and yaw only.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mapperd._core import PingStats, Submap
from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.errors import MapError, Reject, ReplayError
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.fusion import PoseSampler
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.recordings import RecordedSession
from mapperd.session.replay import Window, as_asked
from oculus_driver.recording import Chunk

__all__ = [
    "Correction",
    "DiveReader",
    "DiveSubmaps",
    "OdometryTrack",
    "SonarSubmap",
    "compose",
    "inverse",
    "is_outage",
    "read_submaps",
]

Floats = NDArray[np.float64]

MIN_RESOLUTION_M, SHORT_RESOLUTION_M, SHORT_RANGE_M = 0.2, 0.1, 10.5
"""Smallest voxels, and those of submaps whose pings reach no farther than this. A moving sonar sees
another side of a pile at each place, so registrations are too short by a share of the way, which at
short range is several percent, and grows with the voxels."""

MAX_SUBMAP_S, MAX_SUBMAP_M, MAX_SUBMAP_TURN_RAD = 8.0, 5.0, math.radians(60.0)
"""Ends of a submap: the first that is reached."""

MAX_PAUSE_S = 2.0
"""A longer pause between pings ends a submap."""

MIN_OUTAGE_SHARE, MIN_OUTAGE_RATE = 0.02, 0.02
"""Where the odometry's own standard deviation grows by more than this share of the way and this
speed in m/s, velocity was missing: an outage."""

POSE_STEP_NS = 100_000_000

FRAGMENTS, OUTAGE_FRAGMENTS = 3, 8
"""Pieces of a submap, and most of one in an outage: from one second to the next a velocity cannot
err by the distance of two piles."""

MIN_VOXELS, MIN_FRAGMENT_VOXELS = 150, 60
"""Occupied voxels below which a submap and a fragment are not registered, of either size."""

WEIGHT_PROBABILITY_LIMITS = (0.52, 0.9999)
"""Probabilities of occupancy between which a voxel's weight in a distribution is its log-odds. So
the edge of a thing, which depends on where it is seen from, counts less. Up to `SHORT_RANGE_M` all
voxels count alike: weights made the errors of such dives larger by a fifth."""

MIN_PINGS = 3

RETURN_VOXELS, RETURN_GAP_M = 1.5, 0.5
"""Thickness of the front of a return in edges of a voxel, and the gap between two returns."""

FIRST_RETURN_MAX_RANGE_M = 15.0
"""Up to this range only the first return of a beam is kept: what lies behind is mostly the floor,
whose near edge moves with the vehicle."""


def is_outage(grown_m: Floats, path_m: Floats, seconds: float) -> NDArray[np.bool_]:
    """Whether the stated deviation grew as without velocity over a way and a time."""
    return np.asarray(grown_m > MIN_OUTAGE_SHARE * path_m + MIN_OUTAGE_RATE * seconds)


def compose(a: Floats, b: Floats) -> Floats:
    """Return a_T_c of a_T_b and b_T_c; planar poses (..., 3) of x, y (m) and yaw (rad)."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    yaw = np.remainder(a[..., 2] + b[..., 2] + math.pi, 2 * math.pi) - math.pi
    return np.stack([x, y, yaw], axis=-1)


def inverse(a: Floats) -> Floats:
    """Return b_T_a of a_T_b; planar poses (..., 3)."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = -c * a[..., 0] - s * a[..., 1]
    y = s * a[..., 0] - c * a[..., 1]
    return np.stack([x, y, -a[..., 2]], axis=-1)


def front_of_returns(
    image: PingImage, threshold: float, min_range_m: float, depth_m: float
) -> PingImage:
    """Keep the front of each return along a beam.

    Walls and piles echo at many elevations, the nearest first. What follows is put too near or too
    far, by how much depends on the range, and registrations of submaps that see a thing at
    different ranges become too short or too long by percents. A floor is one return. Of images up
    to `FIRST_RETURN_MAX_RANGE_M` only the first return is kept.

    Args:
        image: of a ping.
        threshold: samples above it are returns; they are separate if `RETURN_GAP_M` apart.
        min_range_m: nearer samples are ignored: ring-down of the transmitter, or the vehicle.
        depth_m: that is kept from the first sample of a return.
    """
    intensity, edge_m = image.intensity, image.range_resolution_m
    is_return = intensity > threshold
    is_return[: math.ceil(min_range_m / edge_m)] = False
    beam, row = np.divmod(np.flatnonzero(is_return.T), len(intensity))
    begins = np.ones(len(row), dtype=bool)
    begins[1:] = beam[1:] != beam[:-1]
    if image.max_range_m > FIRST_RETURN_MAX_RANGE_M:
        begins[1:] |= np.diff(row) > RETURN_GAP_M / edge_m
    rows = row[begins, None] + np.arange(math.floor(depth_m / edge_m) + 1)
    inside = rows < len(intensity)
    places = rows[inside], np.broadcast_to(beam[begins, None], rows.shape)[inside]
    kept = np.zeros_like(intensity)
    kept[places] = intensity[places]
    kept.setflags(write=False)
    return replace(image, intensity=kept)


def matrix_of(pose: Floats) -> Floats:
    """Return the (4, 4) transform of a planar pose (3,)."""
    matrix = np.eye(4)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    matrix[:2, :2] = (c, -s), (s, c)
    matrix[:2, 3] = pose[:2]
    return matrix


@dataclass(frozen=True, slots=True, eq=False)
class OdometryTrack:
    """The odometry of a dive at even times, also where no ping was mapped.

    Attributes:
        t_ns: (N,) int64, Unix time, increasing.
        position_m: (N, 3), base in the odometry's map frame.
        map_q_base: (N, 4) quaternions w, x, y, z.
        segment: (N,) int64, increases at each jump of the odometry.
        deviation_m: (N,) standard deviation that the odometry states for its horizontal position.
    """

    t_ns: NDArray[np.int64]
    position_m: Floats
    map_q_base: Floats
    segment: NDArray[np.int64]
    deviation_m: Floats

    def __post_init__(self) -> None:
        if not len(self.t_ns):
            raise ReplayError("no pose of the vehicle is known, so there is nothing to align")

    @property
    def planar(self) -> Floats:
        """(N, 3) x, y and yaw; the yaw is continuous."""
        w, x, y, z = self.map_q_base.T
        yaw = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        return np.column_stack([self.position_m[:, :2], yaw])

    def at(self, t_ns: NDArray[np.int64]) -> Floats:
        """Return interpolated planar poses (M, 3); beyond the ends those of the ends."""
        columns = [np.interp(t_ns, self.t_ns, column) for column in self.planar.T]
        return np.stack(columns, axis=-1)


@dataclass(eq=False)
class SonarSubmap:
    """A piece of a dive.

    Attributes:
        begin_ns, anchor_ns, end_ns: times of its first, middle and last ping.
        anchor: (3,) odometry at the middle ping; the submap's frame.
        segment: of the odometry.
        pings: number of pings.
        occupied, free: (N, 3) int32 voxels, in the submap's frame.
        weights: (N,) of the occupied ones in the distributions that registration matches.
        resolution_m: edge of a voxel.
    """

    begin_ns: int
    anchor_ns: int
    end_ns: int
    anchor: Floats
    segment: int
    pings: int
    occupied: NDArray[np.int32]
    free: NDArray[np.int32]
    weights: Floats
    resolution_m: float
    centre_m: Floats = field(init=False)
    radius_m: float = field(init=False)

    def __post_init__(self) -> None:
        points_m = (self.occupied[:, :2] + 0.5) * self.resolution_m
        self.centre_m = points_m.mean(axis=0) if len(points_m) else np.zeros(2)
        spread_m = points_m - self.centre_m
        self.radius_m = float(np.sqrt((spread_m**2).sum(axis=1).mean())) if len(points_m) else 0.0

    def build(self) -> Submap:
        """Return its distances and distributions, for registration.

        Raises:
            ReplayError: it extends too far for its voxels.
        """
        occupied, free = (
            np.multiply(voxels + 0.5, self.resolution_m, dtype=np.float64)
            for voxels in (self.occupied, self.free)
        )
        try:
            return Submap(occupied, free, self.resolution_m, self.weights)
        except ValueError as error:
            raise ReplayError(
                f"a submap cannot be registered: {error}; raise octree.voxel_resolution, which is "
                f"{self.resolution_m:g} m"
            ) from error


@dataclass(frozen=True, slots=True, eq=False)
class DiveSubmaps:
    """A dive as alignment reads it.

    Attributes:
        track: the odometry.
        submaps: in order of time, for revisits.
        fragments: thirds of the submaps, for the motion between them; shorter in an outage of
            velocity. A submap takes over the drift
            of its odometry: what it shares with the next one was seen by its last pings and by the
            first ones of the next, so the two agree at the drifting poses.
    """

    track: OdometryTrack
    submaps: list[SonarSubmap]
    fragments: list[SonarSubmap]


@dataclass(frozen=True, slots=True, eq=False)
class _HeldPing:
    image: PingImage
    map_T_sonar: Floats  # noqa: N815 frames are named
    motion: PingMotion | None
    t_ns: int
    base: Floats
    segment: int
    deviation_m: float


class _SubmapMapper(SonarMap):
    """Accepts and refuses pings like a map, and makes submaps of them; holds no voxels itself."""

    def __init__(self, config: Config, correction: "Correction | None") -> None:
        super().__init__(_submap_settings(config, MIN_RESOLUTION_M))
        self._long_map = SonarMap(self.config)
        self._short_map = SonarMap(_submap_settings(config, SHORT_RESOLUTION_M))
        self._correction = correction
        self.submaps: list[SonarSubmap] = []
        self.fragments: list[SonarSubmap] = []
        self.posed: PosedPing | None = None
        self._held: list[_HeldPing] = []
        self._path_m = 0.0

    def integrate(
        self,
        image: PingImage,
        map_T_sonar: Floats,  # noqa: N803 frames are named
        motion: PingMotion | None = None,
    ) -> PingStats:
        """Hold a ping until its submap is complete; raises like a map."""
        sonar_map = self._map_for(image)
        sonar_map.blocks_of(image, map_T_sonar, motion)
        posed = self.posed
        if posed is None or posed.t_ns is None or isinstance(posed.pose, Reject):
            return PingStats()
        matrix = posed.pose.pose.map_T_base
        yaw = math.atan2(matrix[1, 0], matrix[0, 0])
        base = np.array([matrix[0, 3], matrix[1, 3], yaw])
        depth_m = RETURN_VOXELS * sonar_map.resolution_m
        filtering = self.config.filtering
        front = front_of_returns(image, filtering.intensity_threshold, filtering.min_range, depth_m)
        variance_m2 = float(posed.pose.covariance[0, 0] + posed.pose.covariance[1, 1])
        ping = _HeldPing(
            front,
            map_T_sonar,
            motion,
            posed.t_ns,
            base,
            posed.pose.segment,
            math.sqrt(max(variance_m2, 0.0)),
        )
        if self._ends_before(ping):
            self.finish()
        if self._held:
            self._path_m += math.dist(self._held[-1].base[:2], base[:2])
        self._held.append(ping)
        return PingStats()

    def _map_for(self, image: PingImage) -> SonarMap:
        return self._short_map if image.max_range_m <= SHORT_RANGE_M else self._long_map

    def _ends_before(self, ping: _HeldPing) -> bool:
        if not self._held:
            return False
        first, last = self._held[0], self._held[-1]
        step_s = (ping.t_ns - last.t_ns) / 1e9
        turn = abs(math.remainder(ping.base[2] - first.base[2], math.tau))
        return (
            ping.segment != last.segment
            or self._map_for(ping.image) is not self._map_for(last.image)
            or not 0 <= step_s <= MAX_PAUSE_S
            or (ping.t_ns - first.t_ns) / 1e9 > MAX_SUBMAP_S
            or self._path_m > MAX_SUBMAP_M
            or turn > MAX_SUBMAP_TURN_RAD
        )

    def finish(self) -> None:
        """Make a submap of the held pings, and fragments of its parts."""
        held, path_m = self._held, self._path_m
        self._held, self._path_m = [], 0.0
        if len(held) < MIN_PINGS:
            return
        times = np.array([ping.t_ns for ping in held], dtype=np.int64)
        corrections = (
            np.zeros((len(held), 3)) if self._correction is None else self._correction(times)
        )
        self.submaps.append(self._mapped(held, corrections))
        grown_m = np.array(held[-1].deviation_m - held[0].deviation_m)
        count = FRAGMENTS
        if is_outage(grown_m, np.array(path_m), (held[-1].t_ns - held[0].t_ns) / 1e9):
            count = min(OUTAGE_FRAGMENTS, len(held) // MIN_PINGS)
        ends = np.linspace(0, len(held), count + 1).round().astype(int).tolist()
        for begin, end in itertools.pairwise(ends):
            if end - begin >= MIN_PINGS:
                self.fragments.append(self._mapped(held[begin:end], corrections[begin:end]))

    def _mapped(self, held: Sequence[_HeldPing], corrections: Floats) -> SonarSubmap:
        sonar_map = self._map_for(held[0].image)
        resolution_m = sonar_map.resolution_m
        anchor = held[len(held) // 2]
        corrected_T_anchor = compose(corrections[len(held) // 2], anchor.base)  # noqa: N806 frames
        for ping, correction in zip(held, corrections, strict=True):
            anchor_T_map = matrix_of(compose(inverse(corrected_T_anchor), correction))  # noqa: N806
            motion = ping.motion
            if motion is not None:
                turned_mps = anchor_T_map[:3, :3] @ motion.linear_mps
                motion = replace(motion, linear_mps=turned_mps)
            try:
                sonar_map.integrate(ping.image, anchor_T_map @ ping.map_T_sonar, motion)
            except MapError:  # it was checked at a pose nearby
                continue
        solid, empty = (sonar_map.voxels(kind) for kind in ("occupied", "free"))
        occupied, free = (
            np.floor(voxels.centres_m / resolution_m).astype(np.int32) for voxels in (solid, empty)
        )
        weights = np.ones(len(occupied))
        if sonar_map is self._long_map:
            probability = np.clip(solid.probability.astype(np.float64), *WEIGHT_PROBABILITY_LIMITS)
            weights = np.log(probability / (1 - probability))
        sonar_map.clear()
        return SonarSubmap(
            held[0].t_ns,
            anchor.t_ns,
            held[-1].t_ns,
            anchor.base,
            anchor.segment,
            len(held),
            occupied,
            free,
            weights,
            resolution_m,
        )


Correction = Callable[[NDArray[np.int64]], Floats]
"""Returns planar transforms (M, 3) that take odometry to better poses at some times."""


def read_submaps(
    session: RecordedSession,
    config: Config,
    correction: Correction | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> DiveSubmaps:
    """Map a recorded session in submaps.

    Args:
        session: with sonar data and odometry.
        config: the settings to map with. Voxels are at least 0.2 m, and at least 0.1 m in submaps
            of short range.
        correction: of the odometry within each submap; None trusts it. Anchors and boundaries stay
            those of the odometry.
        progress: called with the share of the recording that is read.

    Raises:
        ReplayError: no pose of the vehicle is known.
        RecordingError: the recording cannot be read.
    """
    mapper = _SubmapMapper(config, correction)
    run = as_asked(session, None, mapper.config)
    replay = run.replay(mapper, Window())
    poses = run.poses
    assert isinstance(poses, OdometryPoses)  # noqa: S101 no fixed pose was given
    path = PoseSampler(poses.odometry.fusion, POSE_STEP_NS)

    def note(posed: PosedPing) -> None:
        mapper.posed = posed

    replay.on_posed = note
    for _ in replay.run(_read_along(session, path, progress)):
        pass
    mapper.finish()
    path.finish()
    track = OdometryTrack(
        np.array(path.t_ns, dtype=np.int64),
        np.array([fused.pose.position_m for fused in path.poses]).reshape(-1, 3),
        np.array([fused.pose.map_q_base for fused in path.poses]).reshape(-1, 4),
        np.array([fused.segment for fused in path.poses], dtype=np.int64),
        np.sqrt([max(fused.covariance[0, 0] + fused.covariance[1, 1], 0) for fused in path.poses]),
    )
    return DiveSubmaps(track, mapper.submaps, mapper.fragments)


def _submap_settings(config: Config, min_resolution_m: float) -> Config:
    return with_values(
        config,
        {
            "octree.voxel_resolution": max(min_resolution_m, config.octree.voxel_resolution),
            "localization.mode": "off",
            "mapping.rule": "iwlo",
        },
    )


def _read_along(
    session: RecordedSession, path: PoseSampler, progress: Callable[[float], None]
) -> Iterator[Chunk]:
    """Yield the chunks of a session, and read the path of what was decoded before each."""
    for chunk in session:
        path.advance(chunk.arrival_ns)
        yield chunk
        progress(session.bytes_read / max(session.size_bytes, 1))


class DiveReader:
    """Reads a dive for `DiveInput`, and keeps the submaps for the report's maps.

    Args:
        session: the recording.
        config: the settings to map with.
        lift_m: added to heights, so that dives share the zero of z.
        progress: receives the share that is read.

    Attributes:
        uncorrected: submaps that follow the odometry, without free voxels; empty before reading.
        submaps: those of the last reading, likewise.
    """

    def __init__(
        self,
        session: RecordedSession,
        config: Config,
        lift_m: float = 0.0,
        progress: Callable[[float], None] = lambda _: None,
    ) -> None:
        self._session = session
        self._config = config
        self._lift_m = lift_m
        self._progress = progress
        self.uncorrected: list[SonarSubmap] = []
        self.submaps: list[SonarSubmap] = []

    def __call__(self, correction: Correction | None) -> DiveSubmaps:
        """Read it along a correction of its odometry; None trusts it.

        Raises:
            ReplayError: no pose of the vehicle is known.
            RecordingError: the recording cannot be read.
        """
        dive = read_submaps(self._session, self._config, correction, self._progress)
        if self._lift_m:
            dive = _lifted(dive, self._lift_m)
        none = np.zeros((0, 3), dtype=np.int32)
        self.submaps = [replace(submap, free=none) for submap in dive.submaps]
        if correction is None:
            self.uncorrected = self.submaps
        return dive


def _lifted(dive: DiveSubmaps, lift_m: float) -> DiveSubmaps:
    """Return a dive with other heights; voxels move by whole edges of the larger ones."""
    track = replace(dive.track, position_m=dive.track.position_m + np.array([0.0, 0.0, lift_m]))
    submaps, fragments = (
        [_lifted_submap(one, lift_m) for one in some] for some in (dive.submaps, dive.fragments)
    )
    return replace(dive, track=track, submaps=submaps, fragments=fragments)


def _lifted_submap(submap: SonarSubmap, lift_m: float) -> SonarSubmap:
    step_m = max(submap.resolution_m, MIN_RESOLUTION_M)  # alike for voxels of both sizes
    voxels = round(round(lift_m / step_m) * step_m / submap.resolution_m)
    up = np.array([0, 0, voxels], dtype=np.int32)
    return replace(submap, occupied=submap.occupied + up, free=submap.free + up)
