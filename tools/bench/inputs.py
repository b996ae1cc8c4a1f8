"""The benchmark's input: pings of the simulator, made once for each setting and seed."""

import hashlib
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sonar_sim import FramePose, Scene, SonarSettings
from sonar_sim.simulator import PingRequest, SimulatorSpec, simulate_pings

from bench import scene, seabed
from mapperd.config.tree import Config
from mapperd.imaging.ping_image import PingImage
from oculus_driver.encode import bearing_table_cdeg

ELEVATIONS = 11
MAGIC = b"mprays1\0"
"""Then little-endian: uint32 pings; per ping three float64, the sonar's origin in the map, uint32
rays, and three float32 a ray, its end in the map."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Pings:
    """Some pings of one setting.

    Attributes:
        images: (pings, rows, beams) uint8.
        bearings_rad: (beams,) float64, positive to starboard.
        range_resolution_m: thickness of a row.
        map_T_sonar: (pings, 4, 4) float64.
    """

    images: NDArray[np.uint8]
    bearings_rad: Floats
    range_resolution_m: float
    map_T_sonar: Floats  # noqa: N815 frames are named

    def __len__(self) -> int:
        return len(self.images)

    def echo(self, i: int, *, first_returns_only: bool) -> PingImage:
        """One ping as the map wants it; at wish with nothing in it but first returns."""
        image = self.images[i]
        if first_returns_only:
            image = only_first_returns(image, self.range_resolution_m)
        return PingImage(image.astype(np.float32), self.bearings_rad, self.range_resolution_m)

    def save(self, path: Path) -> None:
        """Write all of it; the file is there only when it is whole."""
        part = path.with_suffix(".part.npz")
        np.savez(
            part,
            images=self.images,
            bearings_rad=self.bearings_rad,
            range_resolution_m=self.range_resolution_m,
            map_T_sonar=self.map_T_sonar,
        )
        part.rename(path)


def load(path: Path) -> Pings:
    """Read what `Pings.save` wrote."""
    with np.load(path) as arrays:
        return Pings(
            arrays["images"],
            arrays["bearings_rad"],
            float(arrays["range_resolution_m"]),
            arrays["map_T_sonar"],
        )


def loud_share(pings: Pings) -> float:
    """Share of all pixels that lie above the map's intensity threshold."""
    return float((pings.images > Config().filtering.intensity_threshold).mean())


def first_rows(image: NDArray[np.uint8], range_resolution_m: float) -> NDArray[np.int64]:
    """Row of each beam's first return, (beams,); -1 in beams without one."""
    filtering = Config().filtering
    near_m = np.arange(len(image)) * range_resolution_m
    heard = (image > filtering.intensity_threshold) & (near_m >= filtering.min_range)[:, None]
    return np.where(heard.any(axis=0), heard.argmax(axis=0), -1)


def only_first_returns(image: NDArray[np.uint8], range_resolution_m: float) -> NDArray[np.uint8]:
    """The image with zeros everywhere but at first returns."""
    rows = first_rows(image, range_resolution_m)
    beams = np.flatnonzero(rows >= 0)
    kept = np.zeros_like(image)
    kept[rows[beams], beams] = image[rows[beams], beams]
    return kept


def ray_ends_m(pings: Pings, i: int, vertical_aperture_rad: float) -> Floats:
    """Ends of a ping's rays in the map frame, (N, 3): each first return at 11 elevations.

    The range is that of the row's middle. Beams without a return have no rays: our map ignores them
    by default.
    """
    rows = first_rows(pings.images[i], pings.range_resolution_m)
    beams = np.flatnonzero(rows >= 0)
    range_m = ((rows[beams] + 0.5) * pings.range_resolution_m)[:, None]
    bearing_rad = pings.bearings_rad[beams][:, None]
    half_rad = vertical_aperture_rad / 2.0
    elevation_rad = np.linspace(-half_rad, half_rad, ELEVATIONS)[None, :]
    horizontal_m = range_m * np.cos(elevation_rad)
    points = np.stack(
        [
            horizontal_m * np.cos(bearing_rad),
            -horizontal_m * np.sin(bearing_rad),
            range_m * np.sin(elevation_rad),
        ],
        axis=-1,
    ).reshape(-1, 3)
    map_T_sonar = pings.map_T_sonar[i]  # noqa: N806 frames are named
    ends_m: Floats = points @ map_T_sonar[:3, :3].T + map_T_sonar[:3, 3]
    return ends_m


def write_rays(path: Path, pings: Pings, vertical_aperture_rad: float) -> None:
    """Write the pings as rays, for the rivals; the layout is that of `MAGIC`."""
    with path.open("wb") as file:
        file.write(MAGIC + struct.pack("<I", len(pings)))
        for i in range(len(pings)):
            ends_m = ray_ends_m(pings, i, vertical_aperture_rad)
            file.write(struct.pack("<3dI", *pings.map_T_sonar[i, :3, 3], len(ends_m)))
            file.write(ends_m.astype("<f4").tobytes())


BENCH = Path(__file__).resolve().parent
ROWS = 500


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Where the sonar looks: a scene, and poses by range and number of pings."""

    scene: Callable[[], Scene]
    poses: Callable[[float, int], list[FramePose]]


DOWN, AHEAD = "down", "ahead"
LOOKS = {
    DOWN: Viewpoint(seabed.seabed, seabed.poses),
    AHEAD: Viewpoint(scene.basin, scene.poses),
}


@dataclass(frozen=True, slots=True)
class ViewSetting:
    """Where the sonar looks, how far, and its gain as an operator would choose it."""

    look: str
    range_m: float
    gain_percent: float

    @property
    def sonar(self) -> SonarSettings:
        """512 beams over 130 degrees, 20 degrees of aperture, `ROWS` rows."""
        return SonarSettings(
            demanded_range_m=self.range_m,
            base_row_m=self.range_m / ROWS,
            gain_percent=self.gain_percent,
        )


SETTINGS = (
    ViewSetting(DOWN, 10.0, 46.0),
    ViewSetting(DOWN, 30.0, 42.0),
    ViewSetting(AHEAD, 10.0, 60.0),
    ViewSetting(AHEAD, 30.0, 46.0),
)


def simulate(setting: ViewSetting, pings: int, seed: int) -> Pings:
    """Simulate pings along the look's path."""
    sonar, look = setting.sonar, LOOKS[setting.look]
    poses = look.poses(setting.range_m, pings)
    recipe = SimulatorSpec(look.scene(), sonar, seed)
    shots = [PingRequest(pose) for pose in poses]
    made = simulate_pings(recipe, shots, processes=1)
    images = np.stack([ping.image for ping in made]).astype(np.uint8)
    map_T_sonar = np.tile(np.eye(4), (pings, 1, 1))  # noqa: N806 frames are named
    map_T_sonar[:, :3, :3] = [pose.rotation for pose in poses]
    map_T_sonar[:, :3, 3] = [pose.position_m for pose in poses]
    bearings_cdeg = bearing_table_cdeg(sonar.beams, sonar.half_aperture_rad)
    return Pings(images, np.radians(bearings_cdeg / 100.0), sonar.range_resolution_m, map_T_sonar)


def cached(folder: Path, setting: ViewSetting, pings: int, seed: int) -> Path:
    """File of the simulated pings, simulated again only if what makes them has changed."""
    scenes = [BENCH / f"{part}.py" for part in ("scene", "seabed", "shapes")]
    sources = [*sorted((BENCH.parent / "sonar_sim").rglob("*.py")), *scenes, Path(__file__)]
    stamp = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:8]
    file = folder / f"pings-{setting.look}-{setting.range_m:g}m-{pings}-{seed}-{stamp}.npz"
    if not file.exists():
        simulate(setting, pings, seed).save(file)
    return file
