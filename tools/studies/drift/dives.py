"""The dives of the study: simulated once for each seed of pings, with odometry of many kinds.

A folder `DIVE` holds:

- `pings.mcap`, `pings-2.mcap`: recordings of one path, with speckle and noise of seeds 1 and 2;
  their odometry is the truth, so that `mapperd --replay` maps them at true poses;
- `pings-gap.mcap`, `pings-2-gap.mcap`: the same without the pings of the dive's gap;
- `truth.tum`: the base in the map, at the pings and ten times a second;
- `surface.npy`: (N, 3) points of the surfaces that the sonar had in sight, map frame, metres;
- `odometry-KIND-SEED.mcap`: what the vehicle believes, for `mapperd --odometry`;
- `config.yaml`: settings to map with: where the sonar sits, and which samples are returns;
- `ready`: written last.

The vehicle reckons from a Doppler log and a gyro, and has sensors of depth, roll and pitch. Its
odometry begins at the truth (or, where the dive says so, off by a turn and a shift) and drifts in
x, y and yaw: the log overrates distances by a scale and is turned about the vertical (crab), and
the gyro drifts. Times count from `EPOCH_NS`.
"""

import itertools
import math
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
import yaml
from numpy.typing import NDArray
from sonar_sim import FramePose, Mounting, Scenario, load_scenario, sonar_preset
from sonar_sim.capture import EPOCH_NS, CaptureSettings, ping_times_s, write_capture
from sonar_sim.geometry.pose import quaternion_of, rotation_of
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.scene.vehicle import OdometrySample
from tqdm import tqdm

from mapperd.config.tree import MountingConfig, OrientationConfig, PositionConfig
from mapperd.odometry.native import NativeRecord, encode_native
from oculus_driver.recording import ODOMETRY_NATIVE, RecordingWriter, open_recording

__all__ = [
    "DIVES",
    "FOLDER",
    "KINDS",
    "PING_SEEDS",
    "SEEDS",
    "SITE_DIVES",
    "DriftKind",
    "DriftingDive",
    "navigation",
    "odometry_path",
    "pings_path",
    "simulate",
    "write_odometry",
]

Floats = NDArray[np.float64]
Corner = tuple[float, float]

FOLDER = Path("out/drift")
SEEDS = (1, 2, 3, 4, 5)
PING_SEEDS = (1, 2)
PING_RATE_HZ = 3.0
BEAMS = 256
RECORD_HZ = 10.0
VOXEL_M = 0.1
LATENCY_S = 0.002
CORNER_M = 1.5
"""Of the way that a turn takes before a corner, and after it."""
TURN_RATE_DPS = 20.0


@dataclass(frozen=True, slots=True)
class DriftingDive:
    """One path through a scene.

    Attributes:
        name: in files.
        scene: of the simulator.
        range_m, gain_percent, pitch_deg: settings of the sonar, and how far it looks down.
        threshold: pixels above it are returns, of 255: above the speckle of the far floor.
        rounds: corners (x, y) in metres that are passed one after another, a closed way each.
        z_m: of the vehicle.
        speed_mps: of the vehicle.
        gap_s: when pings are missing in the recordings with a gap, on the path.
        frame_m, frame_deg: shift (x, y) and turn about the start of the odometry's frame.
    """

    name: str
    scene: str
    range_m: float
    gain_percent: float
    pitch_deg: float
    threshold: float
    rounds: tuple[tuple[Corner, ...], ...]
    z_m: float
    speed_mps: float
    gap_s: tuple[float, float]
    frame_m: Corner = (0.0, 0.0)
    frame_deg: float = 0.0

    def scenario(self) -> Scenario:
        """The scene with this path, and the sonar at the bow."""
        shipped = load_scenario(self.scene)
        sonar = sonar_preset(
            "M750d",
            1,
            demanded_range_m=self.range_m,
            gain_percent=self.gain_percent,
            beams=BEAMS,
        )
        return replace(
            shipped,
            sonar=sonar,
            mounting=Mounting((0.3, 0.0, -0.1), pitch_deg=self.pitch_deg),
            trajectory=self.path(),
            ping_rate_hz=PING_RATE_HZ,
        )

    def ping_times_s(self, *, gap: bool) -> Floats:
        """(N,) Unix time at which pings leave, with or without those of the gap."""
        times_s = np.array(ping_times_s(self.scenario(), CaptureSettings()))
        if gap:
            times_s = times_s[(times_s < self.gap_s[0]) | (times_s >= self.gap_s[1])]
        return EPOCH_NS / 1e9 + times_s

    def path(self) -> Trajectory:
        """Of the base: bow ahead along each leg, corners cut."""
        corners = np.array([corner for way in self.rounds for corner in way])
        legs = np.diff(corners, axis=0)
        lengths_m = np.linalg.norm(legs, axis=1)
        headings_deg = np.degrees(np.unwrap(np.arctan2(legs[:, 1], legs[:, 0])))
        points = []
        for k, (leg, length_m, yaw_deg) in enumerate(
            zip(legs, lengths_m, headings_deg, strict=True)
        ):
            cut = min(CORNER_M, 0.3 * length_m) / length_m
            for share in (0.0 if k == 0 else cut, 1.0 if k == len(legs) - 1 else 1.0 - cut):
                x, y = corners[k] + share * leg
                points.append(Waypoint(float(x), float(y), self.z_m, float(yaw_deg)))
        return Trajectory(points, Motion(self.speed_mps, TURN_RATE_DPS))


def _ring(west: float, south: float, east: float, north: float) -> tuple[Corner, ...]:
    """Anticlockwise from the south-western corner, without coming back to it."""
    return ((west, south), (east, south), (east, north), (west, north))


DIVES: dict[str, DriftingDive] = {
    dive.name: dive
    for dive in (
        DriftingDive(
            "harbour20",
            "harbour",
            20.0,
            52.0,
            15.0,
            110.0,
            (_ring(-13, -6.5, 13, -0.5), (*_ring(-13.5, -6, 12.5, 0), (-13, -6.5))),
            z_m=-3.0,
            speed_mps=0.6,
            gap_s=(60.0, 130.0),
        ),
        DriftingDive(
            "pile12",
            "pile_field",
            12.0,
            52.0,
            15.0,
            90.0,
            (_ring(-12, -5.5, 12, 0), (*_ring(-12.3, -5, 12.4, 0.4), (-12, -5.5))),
            z_m=-1.8,
            speed_mps=0.55,
            gap_s=(70.0, 130.0),
        ),
        DriftingDive(
            "harbour8",
            "harbour",
            8.0,
            60.0,
            20.0,
            100.0,
            (
                _ring(-10, -4.5, 10, 0.5),
                _ring(-10.4, -4.2, 9.6, 0.3),
                (*_ring(-9.7, -4.7, 10.3, 0.8), (-10, -4.5)),
            ),
            z_m=-3.5,
            speed_mps=0.7,
            gap_s=(60.0, 140.0),
        ),
        DriftingDive(
            "wreck15",
            "wreck",
            15.0,
            56.0,
            20.0,
            120.0,
            (_ring(-16, -9, 16, 9), (*_ring(-15.5, -9.5, 16.4, 8.7), (-16, -9))),
            z_m=-14.5,
            speed_mps=0.9,
            gap_s=(50.0, 115.0),
        ),
        DriftingDive(
            "open_water",
            "open_water",
            15.0,
            50.0,
            0.0,
            40.0,
            (
                _ring(-7, -5, 3, 5),
                _ring(-7.3, -4.6, 2.7, 5.2),
                (*_ring(-6.8, -5.2, 3.2, 4.8), (-7, -5)),
            ),
            z_m=-8.0,
            speed_mps=0.55,
            gap_s=(60.0, 130.0),
        ),
        DriftingDive(
            "flat_floor",
            "flat_floor",
            10.0,
            60.0,
            20.0,
            60.0,
            (_ring(-9, -5, 9, 5), (*_ring(-9.4, -4.6, 8.7, 5.3), (-9, -5))),
            z_m=-2.5,
            speed_mps=0.5,
            gap_s=(70.0, 140.0),
        ),
        DriftingDive(
            "harbour20b",
            "harbour",
            20.0,
            52.0,
            15.0,
            110.0,
            (
                ((-9, -1.5), (9, -1.5), (9, -4.5), (-9, -4.5), (-9, -7.5), (9, -7.5), (9, -3)),
                ((-9, -3), (-9, -6), (9, -6), (9, -1), (-9, -1)),
            ),
            z_m=-3.2,
            speed_mps=0.6,
            gap_s=(60.0, 130.0),
            frame_m=(4.0, -3.0),
            frame_deg=20.0,
        ),
    )
}
"""All dives by name."""

SITE_DIVES = ("harbour20b",)
"""Second dives over the site of another, for the alignment of two."""


@dataclass(frozen=True, slots=True)
class DriftKind:
    """How odometry drifts; a seed draws signs, phases and noise.

    Attributes:
        scale: part by which distances are overrated or underrated.
        crab: sine of the log's turn about the vertical, likewise.
        yaw_deg_per_min: of the gyro.
        varies: the three are sines of time of these amplitudes, with periods of `PERIOD_S`.
        outages: stretches of `OUTAGE_S` in which the velocity is off by `OUTAGE_MPS`.
        gap: goes with the recordings that have a gap.
    """

    scale: float = 0.03
    crab: float = 0.03
    yaw_deg_per_min: float = 3.0
    varies: bool = False
    outages: int = 0
    gap: bool = False


KINDS: dict[str, DriftKind] = {
    "constant": DriftKind(),
    "varying": DriftKind(varies=True),
    "mild": DriftKind(0.01, 0.01, 1.0),
    "outage": DriftKind(varies=True, outages=2),
    "gap": DriftKind(gap=True),
}

PERIOD_S = (100.0, 200.0)
OUTAGE_S, OUTAGE_MPS = (10.0, 20.0), (0.1, 0.2)
DEPTH_NOISE_M, TILT_NOISE_DEG, HEADING_NOISE_DEG = 0.015, 0.2, 0.05
VELOCITY_NOISE_MPS, TURN_RATE_NOISE_DPS = 0.01, 0.05
HEADING_WALK_DEG = 0.01
"""Standard deviation of the gyro's random walk after one second."""

CLAIMED_WAY, CLAIMED_START_M = 0.005, 0.02
CLAIMED_HEADING_DEG, CLAIMED_HEADING_DEG_PER_MIN = 0.3, 0.3
CLAIMED_VELOCITY_MPS, CLAIMED_OUTAGE_MPS = 0.02, 0.2
"""Standard deviations that the vehicle states, whatever its drift: those of a data sheet, several
times too small for the kinds that drift most. It knows when its log has lost the floor."""


@dataclass(frozen=True, slots=True, eq=False)
class DriftedTrack:
    """What a vehicle believes, at N times.

    Attributes:
        time_s: (N,) on the path.
        position_m: (N, 3) of the base in the odometry's frame.
        rotation: (N, 3, 3) frame from base.
        velocity_mps, turn_rates_rps: (N, 3) in the base's axes.
        way_m: (N,) travelled, by its own reckoning.
        in_outage: (N,) whether the log has lost the floor.
    """

    time_s: Floats
    position_m: Floats
    rotation: Floats
    velocity_mps: Floats
    turn_rates_rps: Floats
    way_m: Floats
    in_outage: NDArray[np.bool_]


def navigation(dive: DriftingDive, kind: str, seed: int) -> DriftedTrack:
    """Reckon along a dive's path with a kind's drift.

    Args:
        dive: whose path.
        kind: of `KINDS`.
        seed: of signs, phases and noise.
    """
    drift, path = KINDS[kind], dive.path()
    rng = np.random.default_rng([seed, zlib.crc32(dive.name.encode()), zlib.crc32(kind.encode())])
    time_s = np.arange(int(path.duration_s * RECORD_HZ) + 1) / RECORD_HZ
    poses = [path.pose(t) for t in time_s.tolist()]
    true_m = np.stack([pose.position_m for pose in poses])
    roll, pitch, yaw = np.array([_angles(pose.rotation) for pose in poses]).T
    scale, crab, yaw_rate = (
        _course(size, drift, time_s, rng)
        for size in (drift.scale, drift.crab, math.radians(drift.yaw_deg_per_min) / 60.0)
    )
    step_s = 1.0 / RECORD_HZ
    walk = math.radians(HEADING_WALK_DEG) * math.sqrt(step_s) * rng.standard_normal(len(time_s))
    yaw = np.unwrap(yaw) + _integral(yaw_rate, step_s) + np.cumsum(walk) - walk[0]
    yaw += math.radians(dive.frame_deg)
    noise = rng.standard_normal((6, len(time_s)))
    tilt = math.radians(TILT_NOISE_DEG)
    angles = np.stack(
        [
            roll + tilt * noise[0],
            pitch + tilt * noise[1],
            yaw + math.radians(HEADING_NOISE_DEG) * noise[2],
        ],
        axis=1,
    )
    rotation = np.stack([rotation_of(*three) for three in angles])
    true_mps = np.stack([path.velocity_mps(t) for t in time_s.tolist()])
    ahead = (1.0 + scale) * np.sqrt(1.0 - crab**2)
    aside = (1.0 + scale) * crab
    velocity_mps = np.stack(
        [
            ahead * true_mps[:, 0] - aside * true_mps[:, 1],
            aside * true_mps[:, 0] + ahead * true_mps[:, 1],
            true_mps[:, 2],
        ],
        axis=1,
    )
    lost_mps = _outages(drift.outages, time_s, rng)
    velocity_mps[:, :2] += lost_mps
    velocity_mps += VELOCITY_NOISE_MPS * noise[3:6].T
    world_mps = np.einsum("nij,nj->ni", rotation, velocity_mps)
    position_m = np.stack([_integral(world_mps[:, k], step_s) for k in range(2)], axis=1)
    position_m += true_m[0, :2] + np.array(dive.frame_m)
    depth_m = true_m[:, 2] + DEPTH_NOISE_M * rng.standard_normal(len(time_s))
    rates = np.stack([path.turn_rates_rps(t) for t in time_s.tolist()])
    rates[:, 2] += yaw_rate
    rates += math.radians(TURN_RATE_NOISE_DPS) * rng.standard_normal(rates.shape)
    return DriftedTrack(
        time_s,
        np.column_stack([position_m, depth_m]),
        rotation,
        velocity_mps,
        rates,
        _integral(np.linalg.norm(velocity_mps[:, :2], axis=1), step_s),
        np.any(lost_mps != 0.0, axis=1),
    )


def _course(size: float, drift: DriftKind, time_s: Floats, rng: np.random.Generator) -> Floats:
    """(N,) one error over time: of either sign and constant, or a sine."""
    sign, phase, period_s = rng.choice([-1.0, 1.0]), rng.uniform(0.0, 2.0), rng.uniform(*PERIOD_S)
    if not drift.varies:
        return np.full(len(time_s), sign * size)
    course: Floats = size * np.sin(2.0 * math.pi * time_s / period_s + math.pi * phase)
    return course


def _outages(count: int, time_s: Floats, rng: np.random.Generator) -> Floats:
    """(N, 2) error of the velocity, base axes; one outage in each equal part of the dive."""
    lost = np.zeros((len(time_s), 2))
    part_s = 0.8 * time_s[-1] / max(count, 1)
    for k in range(count):
        length_s, size_mps = rng.uniform(*OUTAGE_S), rng.uniform(*OUTAGE_MPS)
        start_s = 0.1 * time_s[-1] + k * part_s + rng.uniform(0.0, max(part_s - length_s, 0.0))
        way = rng.uniform(0.0, 2.0 * math.pi)
        within = (time_s >= start_s) & (time_s < start_s + length_s)
        lost[within] = size_mps * np.array([math.cos(way), math.sin(way)])
    return lost


def _integral(rate: Floats, step_s: float) -> Floats:
    """(N,) by trapezia, from 0."""
    return np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) * step_s / 2.0)])


def _angles(rotation: Floats) -> tuple[float, float, float]:
    """Roll, pitch, yaw of Rz Ry Rx."""
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        -math.asin(rotation[2, 0]),
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )


def write_odometry(path: Path, track: DriftedTrack) -> None:
    """Record what a vehicle believes, as native records with covariances."""
    with RecordingWriter(path, overwrite=True) as recording:
        link = recording.add_link("odometry", ODOMETRY_NATIVE)
        lost_s = _integral(track.in_outage.astype(np.float64), track.time_s[1] - track.time_s[0])
        for k, time_s in enumerate(track.time_s.tolist()):
            stamp_ns = _unix_ns(time_s)
            claimed = _claimed_pose(time_s, float(track.way_m[k]), float(lost_s[k]))
            record = NativeRecord(
                v=1,
                clk="unix",
                w="enu",
                b="flu",
                t=stamp_ns,
                p=tuple(track.position_m[k].tolist()),
                q=tuple(quaternion_of(track.rotation[k]).tolist()),
                u=tuple(track.velocity_mps[k].tolist()),
                r=tuple(track.turn_rates_rps[k].tolist()),
                pc=_triangle(claimed),
                uc=_triangle(_claimed_motion(lost=bool(track.in_outage[k]))),
                src="drift_study",
            )
            recording.write(link, encode_native(record), stamp_ns + round(LATENCY_S * 1e9))


def _claimed_pose(time_s: float, way_m: float, lost_s: float) -> tuple[float, ...]:
    """Standard deviations of x, y, z (m) and of rotations about them (rad).

    The position's grows while the log has lost the floor, as in every reckoning that knows it.
    """
    place_m = math.hypot(CLAIMED_START_M, CLAIMED_WAY * way_m, CLAIMED_OUTAGE_MPS * lost_s)
    tilt = math.radians(TILT_NOISE_DEG)
    turn_deg = math.hypot(CLAIMED_HEADING_DEG, CLAIMED_HEADING_DEG_PER_MIN * time_s / 60.0)
    return (place_m, place_m, DEPTH_NOISE_M, tilt, tilt, math.radians(turn_deg))


def _claimed_motion(*, lost: bool) -> tuple[float, ...]:
    """Standard deviations of velocity (m/s) and turn rates (rad/s), base axes."""
    speed_mps = CLAIMED_OUTAGE_MPS if lost else CLAIMED_VELOCITY_MPS
    return (*(speed_mps,) * 3, *(math.radians(TURN_RATE_NOISE_DPS),) * 3)


def _triangle(deviations: Sequence[float]) -> tuple[float, ...]:
    """Upper triangle, row by row, of a diagonal covariance."""
    matrix = np.diag(np.square(deviations))
    return tuple(matrix[np.triu_indices(len(deviations))].tolist())


def pings_path(folder: Path, dive: str, seed: int = 1, *, gap: bool = False) -> Path:
    """The recording of a dive's pings."""
    number = "" if seed == 1 else f"-{seed}"
    return folder / dive / f"pings{number}{'-gap' if gap else ''}.mcap"


def odometry_path(folder: Path, dive: str, kind: str, seed: int) -> Path:
    """The recording of a dive's odometry."""
    return folder / dive / f"odometry-{kind}-{seed}.mcap"


def simulate(dive: DriftingDive, folder: Path, ping_seeds: Iterable[int] = PING_SEEDS) -> None:
    """Write the folder of a dive; recordings of pings that are there stay.

    Args:
        dive: which.
        folder: of all dives.
        ping_seeds: of speckle and noise.
    """
    home = folder / dive.name
    home.mkdir(parents=True, exist_ok=True)
    scenario = dive.scenario()
    _write_settings(home / "config.yaml", dive)
    _write_truth(home / "truth.tum", scenario)
    for kind, seed in itertools.product(KINDS, SEEDS):
        path = odometry_path(folder, dive.name, kind, seed)
        if not path.exists():
            write_odometry(path, navigation(dive, kind, seed))
    for seed in ping_seeds:
        path = pings_path(folder, dive.name, seed)
        if path.exists():
            continue
        part = path.with_suffix(".part")
        settings = CaptureSettings(_capture_seed(dive, seed), processes=1)
        with tqdm(desc=f"{dive.name} {seed}", unit="ping", disable=None) as bar:

            def progress(done: int, of: int, bar: "tqdm[object]" = bar) -> None:
                bar.total = of
                bar.update(done - bar.n)

            seen = write_capture(part, scenario, settings, progress, _true_navigation(scenario))
        np.save(home / "surface.npy", seen.points_m)
        _without_gap(part, pings_path(folder, dive.name, seed, gap=True), scenario, dive.gap_s)
        part.rename(path)
    (home / "ready").touch()


def _capture_seed(dive: DriftingDive, seed: int) -> int:
    """Different dives over one site have different speckle of their own."""
    return 1000 * (zlib.crc32(dive.name.encode()) % 1000) + seed


def _true_navigation(scenario: Scenario) -> Iterator[OdometrySample]:
    """The truth as records without errors."""
    path = scenario.trajectory
    for k in range(int(path.duration_s * RECORD_HZ) + 1):
        t = k / RECORD_HZ
        yield OdometrySample(
            t, t + LATENCY_S, path.pose(t), path.velocity_mps(t), path.turn_rates_rps(t)
        )


def _without_gap(
    source: Path, target: Path, scenario: Scenario, gap_s: tuple[float, float]
) -> None:
    """Copy a recording without the pings that leave in a stretch of the path.

    A ping's bytes arrive before the next one leaves.
    """
    times_s = [t for t in ping_times_s(scenario, CaptureSettings()) if gap_s[0] <= t < gap_s[1]]
    first_ns = _unix_ns(times_s[0])
    end_ns = _unix_ns(times_s[-1] + 1.0 / scenario.true_ping_rate_hz)
    with open_recording(source) as recording, RecordingWriter(target, overwrite=True) as copy:
        links: dict[str, int] = {}
        for chunk in recording:
            if chunk.link not in links:
                links[chunk.link] = copy.add_link(chunk.link, chunk.encoding)
            stamp_ns = chunk.arrival_ns or 0
            if chunk.encoding == ODOMETRY_NATIVE or not first_ns <= stamp_ns < end_ns:
                copy.write(links[chunk.link], chunk.data, stamp_ns)


def _write_truth(path: Path, scenario: Scenario) -> None:
    """The base in the map as TUM: time, x y z, quaternion x y z w."""
    track = scenario.trajectory
    every = np.arange(int(track.duration_s * RECORD_HZ) + 1) / RECORD_HZ
    stamps = {_unix_ns(t): t for t in (*every.tolist(), *ping_times_s(scenario, CaptureSettings()))}
    lines = [_tum_line(stamp_ns, track.pose(stamps[stamp_ns])) for stamp_ns in sorted(stamps)]
    path.write_text("".join(lines))


def _tum_line(stamp_ns: int, pose: FramePose) -> str:
    w, x, y, z = pose.quaternion
    numbers = " ".join(f"{part:.9f}" for part in (*pose.position_m, x, y, z, w))
    seconds, rest_ns = divmod(stamp_ns, 10**9)
    return f"{seconds}.{rest_ns:09d} {numbers}\n"


def _write_settings(path: Path, dive: DriftingDive) -> None:
    mounting = dive.scenario().mounting
    settings: dict[str, object] = {
        "mounting": msgspec.to_builtins(
            MountingConfig(
                PositionConfig(*mounting.position_m),
                OrientationConfig(mounting.roll_deg, mounting.pitch_deg, mounting.yaw_deg),
            )
        ),
        "octree": {"voxel_resolution": VOXEL_M},
        "filtering": {"intensity_threshold": dive.threshold},
    }
    path.write_text(yaml.safe_dump(settings))


def _unix_ns(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)
