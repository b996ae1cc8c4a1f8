"""The vehicle: its odometry with errors, and odometry records in the native format."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import msgpack
import numpy as np
from numpy.typing import NDArray

from sonar_sim.errors import SceneError
from sonar_sim.geometry.pose import FramePose, rotation_of
from sonar_sim.geometry.trajectory import Trajectory
from sonar_sim.scene.material import MATERIALS, Material

Triple = tuple[float, float, float]
NONE: Triple = (0.0, 0.0, 0.0)
WALK_STREAM, RECORD_STREAM = 31, 32
"""Keep these random numbers apart from all others of a seed."""
WALK_STEP_S = 1.0


@dataclass(frozen=True, slots=True)
class OdometryErrors:
    """How the odometry differs from the truth.

    Attributes:
        position_noise_m, attitude_noise_deg: standard deviations of the white error of a record.
        velocity_noise_mps, turn_rate_noise_dps: of its velocities.
        position_bias_m: constant, in the map.
        attitude_bias_deg: constant roll, pitch and yaw, in the body.
        scale: part by which distances from the start are overrated, and velocities alike.
        drift_mps: steady drift of the position, in the map.
        walk_m_per_sqrt_s: standard deviation of the position's random walk after one second.
        yaw_drift_deg_per_min: steady drift of the heading.
        latency_s: from a record's validity to its arrival.
        jitter_s: mean of what comes on top, exponentially distributed.
        dropout: share of the records that are lost.
        outages_s: stretches (start, end) on the path without any record.
    """

    position_noise_m: float = 0.005
    attitude_noise_deg: float = 0.1
    velocity_noise_mps: float = 0.0
    turn_rate_noise_dps: float = 0.0
    position_bias_m: Triple = NONE
    attitude_bias_deg: Triple = NONE
    scale: float = 0.0
    drift_mps: Triple = NONE
    walk_m_per_sqrt_s: float = 0.0
    yaw_drift_deg_per_min: float = 0.0
    latency_s: float = 0.002
    jitter_s: float = 0.0
    dropout: float = 0.0
    outages_s: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not 0.0 <= self.dropout < 1.0:
            raise SceneError(f"a dropout of {self.dropout:g} is no share of records")
        if self.latency_s < 0.0 or self.jitter_s < 0.0:
            raise SceneError("a record cannot arrive before it is valid")
        for start_s, end_s in self.outages_s:
            if not start_s < end_s:
                raise SceneError(
                    f"an outage from {start_s:g} s to {end_s:g} s ends before it began"
                )


@dataclass(frozen=True, slots=True)
class Vehicle:
    """What carries the sonar.

    Attributes:
        name: for people.
        odometry_rate_hz: of its records.
        errors: of them.
        latitude_deg, longitude_deg: of the map's origin, for formats that are global.
        size_m: length, width and height of the box that sonars of other vehicles see, about the
            base; None is invisible.
        material: of that box.
    """

    name: str = "vehicle"
    odometry_rate_hz: float = 25.0
    errors: OdometryErrors = field(default_factory=OdometryErrors)
    latitude_deg: float = 53.5
    longitude_deg: float = 8.1
    size_m: Triple | None = None
    material: Material = MATERIALS["pvc"]

    def __post_init__(self) -> None:
        if self.size_m is not None and not all(0.0 < edge < math.inf for edge in self.size_m):
            raise SceneError(f"vehicle {self.name!r}: size_m {self.size_m} is no box")


@dataclass(frozen=True, slots=True, eq=False)
class OdometrySample:
    """One record of the navigation, before it is put into some format.

    Attributes:
        time_s: of validity, on the path.
        arrival_s: at the host.
        pose: map_T_base as measured.
        velocity_mps: body frame, (3,).
        turn_rates_rps: body frame, (3,).
    """

    time_s: float
    arrival_s: float
    pose: FramePose
    velocity_mps: NDArray[np.float64]
    turn_rates_rps: NDArray[np.float64]


class SimulatedOdometry:
    """A vehicle's navigation on one path. Equal seeds give equal records."""

    def __init__(self, trajectory: Trajectory, vehicle: Vehicle, seed: int = 0) -> None:
        self._trajectory = trajectory
        self._vehicle = vehicle
        self._seed = seed
        self._start_m = trajectory.pose(0.0).position_m
        self._walk_m = self._random_walk()

    def samples(self) -> Iterator[OdometrySample]:
        """All records that arrive, in the order of their validity, from 0 to the path's end."""
        rate_hz, errors = self._vehicle.odometry_rate_hz, self._vehicle.errors
        generator = _generator(self._seed, RECORD_STREAM)
        for k in range(int(self._trajectory.duration_s * rate_hz) + 1):
            time_s = k / rate_hz
            sample = self._measure(time_s, generator)
            lost = generator.random() < errors.dropout
            if not lost and not any(start <= time_s < end for start, end in errors.outages_s):
                yield sample

    def _measure(self, time_s: float, generator: np.random.Generator) -> OdometrySample:
        errors, truth = self._vehicle.errors, self._trajectory.pose(time_s)
        white = generator.standard_normal((4, 3))
        position_m = truth.position_m + errors.position_noise_m * white[0]
        position_m += errors.scale * (truth.position_m - self._start_m)
        position_m += np.add(errors.position_bias_m, np.multiply(errors.drift_mps, time_s))
        position_m += self._walked_m(time_s)
        tilt_deg = np.add(errors.attitude_bias_deg, errors.attitude_noise_deg * white[1])
        tilt = rotation_of(*np.radians(tilt_deg))
        yaw = rotation_of(0.0, 0.0, math.radians(errors.yaw_drift_deg_per_min * time_s / 60.0))
        velocity = (1.0 + errors.scale) * self._trajectory.velocity_mps(time_s)
        turn_rates = self._trajectory.turn_rates_rps(time_s)
        return OdometrySample(
            time_s,
            time_s + errors.latency_s + errors.jitter_s * generator.standard_exponential(),
            FramePose(position_m, yaw @ truth.rotation @ tilt),
            velocity + errors.velocity_noise_mps * white[2],
            turn_rates + math.radians(errors.turn_rate_noise_dps) * white[3],
        )

    def _random_walk(self) -> NDArray[np.float64]:
        """Positions of the walk at multiples of `WALK_STEP_S`, (N, 3)."""
        steps = math.ceil(self._trajectory.duration_s / WALK_STEP_S) + 1
        step_m = self._vehicle.errors.walk_m_per_sqrt_s * math.sqrt(WALK_STEP_S)
        walked = step_m * _generator(self._seed, WALK_STREAM).standard_normal((steps, 3))
        return np.concatenate([np.zeros((1, 3)), np.cumsum(walked, axis=0)])

    def _walked_m(self, time_s: float) -> NDArray[np.float64]:
        place, share = divmod(time_s / WALK_STEP_S, 1.0)
        before, after = self._walk_m[int(place)], self._walk_m[int(place) + 1]
        between: NDArray[np.float64] = before + share * (after - before)
        return between


def in_order_of_arrival(samples: Iterable[OdometrySample]) -> list[OdometrySample]:
    """Samples as they reach the host; those that jitter overtook come later."""
    return sorted(samples, key=lambda sample: sample.arrival_s)


def _generator(seed: int, stream: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, stream])))


FORMAT_VERSION = 1


def odometry_record(sample: OdometrySample, unix_ns: int) -> bytes:
    """Encode one odometry sample.

    Args:
        sample: the odometry at one time.
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


EQUATOR_M = 6_378_137.0
"""Semi-major axis of WGS-84."""
ECCENTRICITY_SQUARED = 6.694_379_990_141e-3
"""Of WGS-84."""


def metres_per_degree(latitude_deg: float) -> tuple[float, float]:
    """Metres a degree of latitude and of longitude at a latitude of WGS-84.

    They follow from the radii of curvature there, and hold over some kilometres.
    """
    latitude_rad = math.radians(latitude_deg)
    flat = 1.0 - ECCENTRICITY_SQUARED * math.sin(latitude_rad) ** 2
    meridian_m = EQUATOR_M * (1.0 - ECCENTRICITY_SQUARED) / flat**1.5
    parallel_m = EQUATOR_M / math.sqrt(flat) * math.cos(latitude_rad)
    return math.radians(meridian_m), math.radians(parallel_m)
