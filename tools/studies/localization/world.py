"""Where simulated dives are localized: a scene, the box that is driven in, and its known map."""

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from sonar_sim import Scenario, load_scenario
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint
from sonar_sim.raycast.meshes import SEA, Meshes

from mapperd.config.tree import Config, OctreeConfig
from mapperd.localization.maps import VolumeMap, volume_map
from mapperd.mapping.queries import MapQueries
from mapperd.mapping.sonar_map import SonarMap

__all__ = [
    "WORLDS",
    "DiveArea",
    "DiveTrack",
    "DiveWorld",
    "OdometryDrift",
    "angles",
    "drifted",
    "track_of",
]


Floats = NDArray[np.float64]
SURE = 3.0
"""Log-odds of the map's voxels."""


@dataclass(frozen=True, slots=True)
class DiveArea:
    """How a scene is driven through.

    Attributes:
        scene: its name.
        low_m, high_m: (x, y) corners of where the vehicle drives.
        z_m: at which height.
        range_m: of the sonar.
        speed_mps: of the vehicle.
        map_low_m, map_high_m: corners of the map.
        floor_m: height of the floor, where it is level.
        beam_width_deg: of the sonar, -3 dB.
        voxel_m: of the map.
        step_m: of way between updates.
        water_radius_m, water_north_m: where its water ends.
        right_m: an estimate nearer than this to the truth has the right mode.
    """

    scene: str
    low_m: tuple[float, float]
    high_m: tuple[float, float]
    z_m: float
    range_m: float
    speed_mps: float
    map_low_m: tuple[float, float, float]
    map_high_m: tuple[float, float, float]
    floor_m: float
    beam_width_deg: float = 1.0
    voxel_m: float = 0.1
    step_m: float = 0.15
    water_radius_m: float = math.inf
    water_north_m: float = math.inf
    right_m: float = 1.0


HARBOUR = DiveArea(
    "harbour",
    (-20, -10),
    (20, 1.5),
    -3.2,
    20.0,
    0.5,
    (-27, -30, -8),
    (27, 5.5, 0.3),
    -6.5,
    water_north_m=4.0,
)
PILES = DiveArea(
    "pile_field", (-10, -1.8), (10, 1.8), -4.4, 20.0, 0.5, (-14, -9, -8), (14, 9, 0.5), -6.5
)
TANK = DiveArea(
    "tank",
    (-0.9, -0.9),
    (0.9, 0.4),
    -1.2,
    4.0,
    0.1,
    (-3.2, -3.2, -2.6),
    (3.2, 3.2, 0.2),
    -2.4,
    0.6,
    0.05,
    0.03,
    3.0,
    right_m=0.3,
)
UNTUNED = (
    DiveArea(
        "wreck", (-17, -12), (17, 12), -14.2, 20.0, 0.5, (-22, -16, -19), (22, 16, -11), -18.0
    ),
    DiveArea(
        "ship_hull", (-17, -10), (17, 10), -3.8, 20.0, 0.5, (-22, -14, -10.5), (22, 14, 0.3), -10.0
    ),
    DiveArea("pipeline", (-20, -7), (20, 7), -28.4, 20.0, 0.5, (-24, -9, -31), (24, 9, -26), -30.0),
    DiveArea("basin", (-13, -8), (9, 5), -3.0, 20.0, 0.5, (-16, -11, -6.5), (16, 11, 0.3), -6.0),
    DiveArea("boulders", (-18, -13), (18, 13), -5.6, 20.0, 0.5, (-24, -18, -9), (24, 18, -4), -8.0),
    DiveArea("marina", (-10, -12), (10, 7), -2.4, 20.0, 0.5, (-22, -16, -5.5), (22, 10, 0.3), -5.0),
    DiveArea(
        "jacket", (-13, -13), (13, 13), -10.0, 20.0, 0.5, (-16, -16, -14), (16, 16, -6), -24.0
    ),
)
"""Scenes that the settings of the profile were not chosen on."""

WORLDS = {place.scene: place for place in (HARBOUR, PILES, TANK, *UNTUNED)}
SCENES = Path(__file__).parent / "scenes"
"""Of the study alone; the others are the simulator's."""


class DiveWorld:
    """A place, with what its rays meet and the map that is known of it.

    Args:
        place: which.
    """

    def __init__(self, place: DiveArea) -> None:
        self.place = place

    @cached_property
    def scenario(self) -> Scenario:
        """The place's scene and sonar."""
        file = SCENES / f"{self.place.scene}.yaml"
        scenario = load_scenario(file if file.exists() else self.place.scene)
        sonar = dataclasses.replace(scenario.sonar, demanded_range_m=self.place.range_m)
        return dataclasses.replace(scenario, sonar=sonar)

    @cached_property
    def meshes(self) -> Meshes:
        """What rays meet."""
        return Meshes(self.scenario.scene)

    @cached_property
    def soft(self) -> list[int]:
        """Surfaces that are floor or sea."""
        names = [surface.name for surface in self.scenario.scene.surfaces]
        return [SEA, *(k for k, name in enumerate(names) if name == "floor")]

    @cached_property
    def true_map(self) -> SonarMap:
        """The scene's surfaces in voxels, and free water where the vehicle drives.

        It has been in a file, as a known map has.
        """
        settings = Config(octree=OctreeConfig(voxel_resolution=self.place.voxel_m))
        made, read = SonarMap(settings), SonarMap(settings)
        water = self._water_m()
        made.core.set_log_odds(water, np.full(len(water), -SURE))
        surface = self._surface_m()
        made.core.set_log_odds(surface, np.full(len(surface), SURE))
        with TemporaryDirectory() as folder:
            made.save(Path(folder) / "known.map")
            read.load(Path(folder) / "known.map")
        return read

    def known(self, max_distance_m: float) -> VolumeMap:
        """The map to be localized on; a vehicle can be wherever there is water at its height."""
        place, half_m = self.place, self.place.voxel_m / 2
        config = self.true_map.config
        queries = MapQueries(
            self.true_map.core,
            occupied_threshold=config.occupied_threshold,
            free_threshold=config.free_threshold,
        )
        low, high = np.array(place.map_low_m, float), np.array(place.map_high_m, float)
        band_m = (self._layer_m - half_m, self._layer_m + half_m)
        return volume_map(queries, low, high, band_m, max_distance_m)

    def _surface_m(self) -> Floats:
        """A point in each voxel that a surface crosses, and a little more."""
        points = _points_on(self.scenario.scene.triangles_m, 0.7 * self.place.voxel_m)
        low, high = self.place.map_low_m, self.place.map_high_m
        inside = np.all((points >= low) & (points <= high), axis=1)
        cells = _distinct(np.floor(points[inside] / self.place.voxel_m).astype(np.int64))
        return np.asarray((cells + 0.5) * self.place.voxel_m)

    def _water_m(self) -> Floats:
        edge_m, place = self.place.voxel_m, self.place
        x, y = (
            np.arange(place.map_low_m[k] + edge_m / 2, place.map_high_m[k], edge_m)
            for k in range(2)
        )
        x, y = (part.ravel() for part in np.meshgrid(x, y))
        inside = (np.hypot(x, y) < place.water_radius_m) & (y < place.water_north_m)
        x, y = x[inside], y[inside]
        return np.stack([x, y, np.full(len(x), self._layer_m)], axis=1)

    @property
    def _layer_m(self) -> float:
        """Middle of the voxels that the vehicle drives through."""
        return (math.floor(self.place.z_m / self.place.voxel_m) + 0.5) * self.place.voxel_m


def _distinct(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """(M, 3) of (N, 3), each once. As single numbers: rows would take ten times as long to sort."""
    first = cells.min(axis=0)
    edges = tuple(cells.max(axis=0) - first + 1)
    numbers = np.unique(np.ravel_multi_index(tuple((cells - first).T), edges))
    return np.asarray(np.stack(np.unravel_index(numbers, edges), axis=-1) + first)


def _points_on(triangles_m: Floats, step_m: float) -> Floats:
    """(N, 3) points on triangles (F, 3, 3), not farther apart than a step along their edges."""
    a, b, c = (triangles_m[:, k] for k in range(3))
    longest = np.max(
        [
            np.linalg.norm(b - a, axis=1),
            np.linalg.norm(c - b, axis=1),
            np.linalg.norm(a - c, axis=1),
        ],
        axis=0,
    )
    steps = np.maximum(np.ceil(longest / step_m).astype(int), 1)
    parts = [np.empty((0, 3))]
    for count in np.unique(steps):
        u, v = np.meshgrid(np.arange(count + 1), np.arange(count + 1))
        inside = u + v <= count
        share = np.stack([u[inside], v[inside]], axis=1) / count
        share = np.column_stack([1.0 - share.sum(axis=1), share])
        parts.append((share @ triangles_m[steps == count]).reshape(-1, 3))
    return np.concatenate(parts)


@dataclass(frozen=True, slots=True)
class OdometryDrift:
    """How odometry errs.

    Attributes:
        scale: of the way, on top.
        yaw_rad_per_s: of the heading.
        through_water: it reckons through the water, and does not know of the current; else over
            ground, as a Doppler log does.
    """

    scale: float = 0.02
    yaw_rad_per_s: float = math.radians(1.0) / 60.0
    through_water: bool = False


CURRENT_MPS, CURRENT_TURN_S = 0.05, 600.0
"""Of the water, and in which time it goes once around the compass. Vehicles crab in it: bow and way
differ by up to 6 degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class DiveTrack:
    """The base at the times of the pings.

    Attributes:
        time_s: (N,).
        place: (N, 6) x, y, z in metres, roll, pitch, yaw in radians, map frame.
        carried_at: row that the vehicle was put to without driving there; None if never.
    """

    time_s: Floats
    place: Floats
    carried_at: int | None = None

    @property
    def way_m(self) -> Floats:
        """(N,) driven so far."""
        steps = np.hypot(*np.diff(self.place[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])


def track_of(place: DiveArea, duration_s: float, interval_s: float, seed: int) -> DiveTrack:
    """Random legs through the place's box, the bow as far off the way as the current asks for."""
    random = np.random.default_rng((seed, 1))
    low, high = np.array(place.low_m, float), np.array(place.high_m, float)
    here = random.uniform(low, high)
    yaw_deg = random.uniform(-180.0, 180.0)
    points = [_waypoint(here, place, yaw_deg)]
    passed_s, rate_dps = 0.0, 15.0
    while passed_s < duration_s:
        there = random.uniform(low, high)
        leg = there - here
        if np.hypot(*leg) < 0.2 * np.hypot(*(high - low)):
            continue
        through = leg / np.hypot(*leg) * place.speed_mps - _current_mps(passed_s, place)
        turn = math.degrees(math.atan2(through[1], through[0])) - yaw_deg
        turn = math.remainder(turn, 360.0)
        yaw_deg += turn
        points += [
            _waypoint(here, place, yaw_deg),
            _waypoint(there, place, yaw_deg),
        ]
        passed_s += abs(turn) / rate_dps + float(np.hypot(*leg)) / place.speed_mps
        here = there
    motion = Motion(place.speed_mps, rate_dps, heave_m=0.02)
    path = Trajectory(points, motion)
    time_s = np.arange(0.0, min(duration_s, path.duration_s), interval_s)
    poses = [path.pose(float(t)) for t in time_s]
    rows = [[*p.position_m, *angles(p.rotation)] for p in poses]
    return DiveTrack(time_s, np.array(rows))


def _waypoint(here: Floats, place: DiveArea, yaw_deg: float) -> Waypoint:
    return Waypoint(float(here[0]), float(here[1]), place.z_m, yaw_deg)


def drifted(track: DiveTrack, place: DiveArea, drift: OdometryDrift, seed: int) -> Floats:
    """(N, 3) x, y, yaw of the odometry, from an origin of its own."""
    random = np.random.default_rng((seed, 2))
    sign = random.choice([-1.0, 1.0], 2)
    true, time_s = track.place, track.time_s
    passed_s = np.diff(time_s, prepend=time_s[0])
    steps = np.diff(true[:, :2], axis=0, prepend=true[:1, :2])
    if drift.through_water:
        steps -= _current_mps(time_s, place) * passed_s[:, None]
    steps *= 1.0 + sign[0] * drift.scale
    heading = true[:, 5].copy()
    if track.carried_at is not None:
        k = track.carried_at
        steps[k] = 0.0
        heading[k:] += heading[k - 1] - heading[k]
    # Steps turn with the heading's error at their time.
    wrong = sign[1] * drift.yaw_rad_per_s * time_s + random.uniform(-math.pi, math.pi)
    turn = heading - true[:, 5] + wrong
    c, s = np.cos(turn), np.sin(turn)
    turned = np.stack(
        [c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]], axis=1
    )
    return np.column_stack([np.cumsum(turned, axis=0), heading + wrong])


def _current_mps(time_s: float | Floats, place: DiveArea) -> Floats:
    """(2,) or (N, 2), map frame; as much slower as the vehicle is."""
    toward = 2 * math.pi * np.asarray(time_s) / CURRENT_TURN_S
    size = CURRENT_MPS * place.speed_mps / 0.5
    return size * np.stack([np.cos(toward), np.sin(toward)], axis=-1)


def angles(rotation: Floats) -> tuple[float, float, float]:
    """Roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll)."""
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        -math.asin(float(np.clip(rotation[2, 0], -1.0, 1.0))),
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )
