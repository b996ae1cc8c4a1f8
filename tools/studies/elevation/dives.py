"""The dives of the study, simulated once for each seed and kept as one file each.

A seed sets speckle and noise, and moves the path a little. Poses are the true ones; the sonar is
at rest during a ping. All sonars are an M750d in mode 1 with 512 beams.

A file, `DIVE-SEED.npz`, holds:

- `images`: (N, rows, beams) uint8, row 0 nearest, column 0 the most negative bearing;
- `bearings_rad`: (beams,) float64, positive to starboard, as the wire rounds them;
- `range_resolution_m`: thickness of a row;
- `map_T_sonar`: (N, 4, 4) float64, sonar x forward, y port, z up;
- `seen_m`: (M, 3) float32, points of surfaces that the sonar had in sight (first hits within ±10°
  of elevation, whether or not the echo can be heard), one for each cell of 2.5 cm;
- `seen_ping`: (M,) uint16, the first ping that saw the cell;
- `gain_percent`, `gamma_byte`, `tvg_spreading_log`: of the receiver; gamma 255 is linear.
"""

import math
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sonar_sim import (
    MATERIALS,
    FramePose,
    Mounting,
    Scenario,
    Scene,
    Simulator,
    Surface,
    load_scenario,
    sonar_preset,
)
from sonar_sim.geometry.pose import rotation_of
from sonar_sim.scene.scenario import sonar_pose

from mapperd.imaging.ping_image import PingImage
from oculus_driver.encode import bearing_table_cdeg
from studies.accuracy_cost.mapping.dives import made_by, once
from studies.accuracy_cost.mapping.metrics import Pile, Solid, SolidBox
from studies.accuracy_cost.study import StudyDive

__all__ = [
    "DIVES",
    "Change",
    "Dive",
    "DiveData",
    "SeenPoints",
    "cache_of",
    "cell_keys",
    "load",
    "simulate",
]

Floats = NDArray[np.float64]
Poses = list[FramePose]
PathMaker = Callable[[np.random.Generator], Poses]

SEEN_CELL_M = 0.025
KEY_OFFSET = 1 << 20
LEAD_S = 0.5
JITTER_M, JITTER_DEG = 0.05, 1.0
"""Standard deviations by which a seed shifts the whole path and turns it about its middle."""


@dataclass(frozen=True, slots=True)
class Change:
    """What is taken away and what is put there before a ping.

    Attributes:
        ping: the first that meets the changed scene.
        removed, added: the objects.
        scene: makes the scene afterwards.
    """

    ping: int
    removed: Solid
    added: Solid
    scene: Callable[[], Scene]


@dataclass(frozen=True)
class Dive:
    """One dive.

    Attributes:
        name: in files.
        title: for people.
        scene: makes the scene; its first surface is the floor, or the wall around the water.
        path: makes the poses of the sonar, one a ping, from the seed's generator.
        range_m, gain_percent: settings of the sonar.
        varied: depth, pitch or roll vary so much that elevation is well observable.
        change: of the scene during the dive.
    """

    name: str
    title: str
    scene: Callable[[], Scene]
    path: PathMaker
    range_m: float
    gain_percent: float
    varied: bool = False
    change: Change | None = None

    def poses(self, seed: int) -> Floats:
        """map_T_sonar of all pings, (N, 4, 4), shifted and turned by the seed's jitter."""
        rng = np.random.default_rng([seed, zlib.crc32(self.name.encode())])
        shift_m = JITTER_M * rng.standard_normal(3)
        turn = rotation_of(0.0, 0.0, math.radians(JITTER_DEG) * rng.standard_normal())
        path = self.path(rng)
        positions_m = np.stack([pose.position_m for pose in path])
        middle_m = positions_m.mean(axis=0)
        poses = np.tile(np.eye(4), (len(path), 1, 1))
        poses[:, :3, :3] = [turn @ pose.rotation for pose in path]
        poses[:, :3, 3] = (positions_m - middle_m) @ turn.T + middle_m + shift_m
        return poses


@dataclass(frozen=True, eq=False)
class DiveData:
    """A simulated dive; see the module for the fields."""

    images: NDArray[np.uint8]
    bearings_rad: Floats
    range_resolution_m: float
    map_T_sonar: Floats  # noqa: N815 frames are named
    seen_m: Floats
    seen_ping: NDArray[np.uint16]
    gain_percent: float
    gamma_byte: int

    def __len__(self) -> int:
        return len(self.images)

    def ping(self, i: int) -> PingImage:
        """Image i as the map takes it."""
        intensity = self.images[i].astype(np.float32)
        intensity.setflags(write=False)
        return PingImage(intensity, self.bearings_rad, self.range_resolution_m)

    @cached_property
    def max_range_m(self) -> float:
        """Far edge of the last row."""
        return float(self.images.shape[1] * self.range_resolution_m)


def _study_scene(name: str) -> Scene:
    """A world of the accuracy study, without other sonars."""
    return replace(made_by(StudyDive(name, 0)).scenario(name).scene, emitters=())


def _shipped_scene(name: str) -> Scene:
    return load_scenario(name).scene


def _along(scenario: Scenario, pings: int, share: tuple[float, float]) -> Poses:
    """Poses of the sonar, evenly spread over a part of the scenario's time."""
    span_s = scenario.trajectory.duration_s - 2 * LEAD_S
    times_s = LEAD_S + span_s * np.linspace(*share, pings)
    return [sonar_pose(scenario, float(t)) for t in times_s]


def _study_path(name: str, pings: int, _: np.random.Generator) -> Poses:
    return _along(made_by(StudyDive(name, 0)).scenario(name), pings, (0.0, 1.0))


def _shipped_path(
    name: str,
    pings: int,
    share: tuple[float, float],
    mounting: Mounting | None,
    _: np.random.Generator,
) -> Poses:
    scenario = load_scenario(name)
    return _along(replace(scenario, mounting=mounting or scenario.mounting), pings, share)


def _round_the_harbour(pings: int) -> Iterator[tuple[int, float, float, float]]:
    """Number, x, y and yaw (rad) of each ping on the path of the harbour."""
    for k, pose in enumerate(_study_path("harbour", pings, np.random.default_rng(0))):
        x, y, _ = pose.position_m
        yield k, float(x), float(y), math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])


def _looking(
    position_m: tuple[float, float, float], yaw: float, *, pitch_deg: float, roll_deg: float = 0.0
) -> FramePose:
    rotation = rotation_of(math.radians(roll_deg), math.radians(pitch_deg), yaw)
    return FramePose(np.array(position_m), rotation)


def _waves(rng: np.random.Generator, *periods: float) -> Callable[[int], list[float]]:
    """Sines over the number of the ping, with random phases."""
    phases = rng.uniform(0.0, 2.0 * math.pi, len(periods))

    def at(k: int) -> list[float]:
        return [math.sin(2.0 * math.pi * k / p + f) for p, f in zip(periods, phases, strict=True)]

    return at


def _depth_and_pitch(pings: int, rng: np.random.Generator) -> Poses:
    """Depth 1.1 to 3.1 m over a floor at 4.6 m, pitch 0 to 40 degrees down."""
    waves, poses = _waves(rng, 27.0, 17.0), []
    for k, x, y, yaw in _round_the_harbour(pings):
        up, down = waves(k)
        poses.append(_looking((x, y, -2.1 + up), yaw, pitch_deg=20.0 + 20.0 * down))
    return poses


def _rolling(pings: int, rng: np.random.Generator) -> Poses:
    """Roll of ±60 degrees at constant depth, pitch 25 degrees down."""
    waves, poses = _waves(rng, 20.0), []
    for k, x, y, yaw in _round_the_harbour(pings):
        (roll,) = waves(k)
        poses.append(_looking((x, y, -1.9), yaw, pitch_deg=25.0, roll_deg=60.0 * roll))
    return poses


def _then_low(pings: int, _: np.random.Generator) -> Poses:
    """The path of the harbour at its usual height, then again 0.6 m over the floor, level."""
    first = _study_path("harbour", pings // 2, np.random.default_rng(0))
    low = (
        _looking((x, y, -4.0), yaw, pitch_deg=2.0)
        for _, x, y, yaw in _round_the_harbour(pings // 2)
    )
    return [*first, *low]


def _hovering(pings: int, rng: np.random.Generator) -> Poses:
    """To and fro before one place that nearly every ping sees, with varied depth and pitch."""
    ahead, poses = _waves(rng, 60.0, 37.0, 27.0, 17.0, 23.0), []
    for k in range(pings):
        x, y, up, down, yaw = ahead(k)
        place_m, pitch_deg = (0.7 + 0.7 * x, 0.5 * y, -2.2 + 0.7 * up), 20.0 + 12.0 * down
        poses.append(_looking(place_m, math.radians(15.0 * yaw), pitch_deg=pitch_deg))
    return poses


_MUDDY = {"solid 0": "mud", "solid 1": "sheet_piling", "solid 8": "rock", "solid 9": "rock"}
"""Materials of the harbour's floor, quay and caissons; its piles are of wood."""


def _muddy_harbour() -> Scene:
    scene = _study_scene("harbour")
    surfaces = (replace(s, material=MATERIALS[_MUDDY.get(s.name, "wood")]) for s in scene.surfaces)
    return replace(scene, surfaces=tuple(surfaces))


_REMOVED = "solid 8"
_REMOVED_BOX = SolidBox((4.7, 1.3, -4.4), (1.2, 1.0, 1.4))
"""The harbour's caisson of that name."""
_NEW_PILE = Pile((3.9, -0.5, -3.0), 0.2, 6.0)


def _harbour_before() -> Scene:
    """The one to be removed is last, so that what stays keeps its speckle."""
    scene = _study_scene("harbour")
    surfaces = sorted(scene.surfaces, key=lambda surface: surface.name == _REMOVED)
    return replace(scene, surfaces=tuple(surfaces))


def _harbour_after() -> Scene:
    scene = _study_scene("harbour")
    stays = [surface for surface in scene.surfaces if surface.name != _REMOVED]
    new = Surface("new pile", *_NEW_PILE.mesh(), MATERIALS["overgrown_concrete"])
    return replace(scene, surfaces=(*stays, new))


def _shipped(
    name: str,
    title: str,
    scene: str,
    *,
    pings: int,
    share: float,
    settings: tuple[float, float],
    mounting: Mounting | None = None,
) -> Dive:
    """The first part of the path of a shipped scene."""
    path = partial(_shipped_path, scene, pings, (0.0, share), mounting)
    return Dive(name, title, partial(_shipped_scene, scene), path, *settings)


def _study(name: str, title: str, world: str, pings: int, settings: tuple[float, float]) -> Dive:
    return Dive(
        name, title, partial(_study_scene, world), partial(_study_path, world, pings), *settings
    )


def _in_harbour(
    name: str, title: str, path: PathMaker, scene: Callable[[], Scene] | None = None
) -> Dive:
    scene = scene or partial(_study_scene, "harbour")
    return Dive(name, title, scene, path, 6.0, 56.0, varied=True)


DIVES: dict[str, Dive] = {
    dive.name: dive
    for dive in (
        _study("harbour", "harbour", "harbour", 40, (6.0, 56.0)),
        _study("seabed", "seabed, looking down", "seabed", 30, (10.0, 50.0)),
        _study("bay", "bay", "hard", 48, (10.0, 56.0)),
        _shipped(
            "pile_forward",
            "pile field, looking ahead",
            "pile_field",
            pings=90,
            share=0.6,
            settings=(7.0, 52.0),
            mounting=Mounting((0.2, 0.0, -0.1), pitch_deg=15.0),
        ),
        _shipped(
            "pile_upright",
            "pile field, upright fan",
            "pile_field",
            pings=90,
            share=0.6,
            settings=(7.0, 52.0),
        ),
        _shipped(
            "ship_hull",
            "ship hull, upright fan",
            "ship_hull",
            pings=90,
            share=0.3,
            settings=(6.0, 56.0),
        ),
        _shipped(
            "wreck", "wreck, looking down", "wreck", pings=90, share=0.4, settings=(10.0, 50.0)
        ),
        _shipped("tank", "tank", "tank", pings=60, share=1.0, settings=(4.0, 56.0)),
        _in_harbour("depth_pitch", "depth and pitch vary", partial(_depth_and_pitch, 80)),
        _in_harbour("roll", "roll ±60°", partial(_rolling, 80)),
        replace(
            _in_harbour("grazing", "second pass low, grazing", partial(_then_low, 80)), varied=False
        ),
        _in_harbour("mud", "mud and rock", partial(_depth_and_pitch, 80), _muddy_harbour),
        replace(
            _in_harbour("changing", "changing scene", partial(_hovering, 120), _harbour_before),
            change=Change(60, _REMOVED_BOX, _NEW_PILE, _harbour_after),
        ),
    )
}
"""All dives by name; voxels of 10 cm suit them."""


def cache_of(dive: Dive, seed: int, folder: Path) -> Path:
    """File of a simulated dive."""
    return folder / f"{dive.name}-{seed}.npz"


def load(dive: Dive, seed: int, folder: Path) -> DiveData:
    """Read a simulated dive.

    Raises:
        FileNotFoundError: `simulate` was not run.
    """
    with np.load(cache_of(dive, seed, folder)) as archive:
        return DiveData(
            archive["images"],
            archive["bearings_rad"],
            float(archive["range_resolution_m"]),
            archive["map_T_sonar"],
            archive["seen_m"].astype(np.float64),
            archive["seen_ping"],
            float(archive["gain_percent"]),
            int(archive["gamma_byte"]),
        )


def simulate(
    dive: Dive,
    seed: int,
    folder: Path,
    progress: Callable[[int, int], None] | None = None,
    threads: int = 1,
) -> None:
    """Simulate a dive, unless its file is there.

    Args:
        dive: which.
        seed: of speckle, noise and the path's jitter.
        folder: of the files.
        progress: called with the pings done and the pings in all.
        threads: of the simulator; the file does not depend on it.
    """
    path = cache_of(dive, seed, folder)
    if path.exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    sonar = sonar_preset("M750d", 1, demanded_range_m=dive.range_m, gain_percent=dive.gain_percent)
    poses = dive.poses(seed)
    images, seen = [], SeenPoints()
    simulator = Simulator(dive.scene(), sonar, seed, threads=threads)
    for i, pose in enumerate(poses):
        if dive.change is not None and i == dive.change.ping:
            simulator = Simulator(dive.change.scene(), sonar, seed, threads=threads)
        ping = simulator.ping(FramePose(pose[:3, 3], pose[:3, :3]), i)
        images.append(np.asarray(ping.image, dtype=np.uint8))
        seen.add(i, ping.seen_m)
        if progress is not None:
            progress(i + 1, len(poses))
    bearings_cdeg = bearing_table_cdeg(sonar.beams, sonar.half_aperture_rad)
    part = once(path)
    with part.open("wb") as file:
        np.savez_compressed(
            file,
            images=np.stack(images),
            bearings_rad=np.radians(bearings_cdeg / 100.0),
            range_resolution_m=sonar.range_resolution_m,
            map_T_sonar=poses,
            seen_m=seen.points_m.astype(np.float32),
            seen_ping=seen.pings,
            gain_percent=sonar.gain_percent,
            gamma_byte=sonar.gamma_byte,
            tvg_spreading_log=sonar.tvg_spreading_log,
        )
    part.rename(path)


class SeenPoints:
    """Points in sight, one for each cell of `SEEN_CELL_M`: the first that came, and its ping."""

    def __init__(self) -> None:
        self._keys = np.empty(0, dtype=np.int64)
        self.points_m = np.empty((0, 3))
        self.pings = np.empty(0, dtype=np.uint16)

    def add(self, ping: int, points_m: Floats) -> None:
        """Take in the points (N, 3) that a ping saw."""
        keys, first = np.unique(cell_keys(points_m, SEEN_CELL_M), return_index=True)
        new = ~np.isin(keys, self._keys, assume_unique=True)
        self._keys = np.concatenate([self._keys, keys[new]])
        self.points_m = np.concatenate([self.points_m, points_m[first[new]]])
        added = np.full(int(new.sum()), ping, dtype=np.uint16)
        self.pings = np.concatenate([self.pings, added])


def cell_keys(points_m: Floats, cell_m: float) -> NDArray[np.int64]:
    """One number (N,) for the cell of each point (N, 3)."""
    cells = np.floor(points_m / cell_m).astype(np.int64) + KEY_OFFSET
    keys: NDArray[np.int64] = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return keys
