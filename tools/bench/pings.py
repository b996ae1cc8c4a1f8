"""The benchmark's pings: kept in a file, given alike to every contender, as images or as rays."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.imaging.ping_image import PingImage

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

    The range is that of the row's middle. Beams without a return have no rays, as they say nothing
    to our map by default.
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
