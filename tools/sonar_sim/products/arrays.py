"""A ping's products as arrays: samples, cells, labels, raw scan."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oculus_driver.render import fit_fan, warp_to_fan
from sonar_sim.products.sounding import PingProducts
from sonar_sim.raycast.depth_camera import DepthImage
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings


def pixel_cells(
    view: DepthImage, sonar: SonarSettings
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Row and beam of each pixel, and whether it lies in the ping; (height, width) each.

    A line array hears cones: the beam follows from the direction's component along the array, not
    from its bearing.
    """
    rays = view.camera.rays()
    sine = -rays[..., 1] / np.linalg.norm(rays, axis=-1)
    row = np.floor(view.range_m / sonar.range_resolution_m).astype(np.int64)
    beam = np.rint(sine / sonar.sine_pitch + (sonar.beams - 1) / 2.0).astype(np.int64)
    inside = view.hit & (row < sonar.rows) & (beam >= 0) & (beam < sonar.beams)
    return np.where(inside, row, 0), np.where(inside, beam, 0), inside


def lookup_pixels(
    values: NDArray[np.float32], view: DepthImage, sonar: SonarSettings
) -> NDArray[np.float32]:
    """Value of each pixel's cell, (height, width); NaN where it has none.

    Args:
        values: (rows, beams).
        view: what the camera sees.
        sonar: whose cells they are.
    """
    row, beam, inside = pixel_cells(view, sonar)
    found: NDArray[np.float32] = np.where(inside, values[row, beam], np.float32(np.nan))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """What the numbers mean.

    Attributes:
        surfaces: names, by place in the scene.
        materials: names of those in the scene, sorted.
        material_of: place in `materials` of each surface, int32 (surfaces,).
    """

    surfaces: tuple[str, ...]
    materials: tuple[str, ...]
    material_of: NDArray[np.int32]

    def material(self, surface: NDArray[np.int32]) -> NDArray[np.int32]:
        """Material of each surface number; what is below 0, nothing or the sea, stays as it is."""
        padded = np.append(self.material_of, np.int32(-1))
        return np.where(surface >= 0, padded[np.maximum(surface, -1)], surface).astype(np.int32)


def surface_labels(scene: Scene) -> Labels:
    """Number a scene's surfaces and materials."""
    used = [surface.material.name for surface in scene.surfaces]
    materials = tuple(sorted(set(used)))
    places = [materials.index(name) for name in used]
    return Labels(
        tuple(surface.name for surface in scene.surfaces),
        materials,
        np.array(places, dtype=np.int32),
    )


Arrays = dict[str, NDArray[Any]]


def polar_arrays(sounding: PingProducts) -> Arrays:
    """The ping: samples, and all that is needed to place them."""
    sonar = sounding.sonar
    sines = (np.arange(sonar.beams) - (sonar.beams - 1) / 2.0) * sonar.sine_pitch
    return {
        "image": sounding.image,
        "bearings_rad": np.arcsin(sines),
        "ranges_m": sonar.row_centres_m,
        "range_resolution_m": np.array(sonar.range_resolution_m),
        "frequency_hz": np.array(sonar.frequency_hz),
        "gain_percent": np.array(sonar.gain_percent),
        "gamma_byte": np.array(sonar.gamma_byte),
        "ping_id": np.array(sounding.ping_id),
        "time_s": np.array(sounding.time_s),
        "map_T_sonar": _matrix(sounding),
    }


def snr_arrays(sounding: PingProducts) -> Arrays:
    """Expected echo over noise, of the ping's cells and of the cells that the camera sees."""
    camera = lookup_pixels(sounding.snr_db, sounding.view, sounding.sonar)
    return {"polar_db": sounding.snr_db, "camera_db": camera}


def truth_arrays(sounding: PingProducts) -> Arrays:
    """What each pixel of the ping shows: the strongest echo in the cell. NaN and -1 are nothing."""
    truth, labels = sounding.truth, surface_labels(sounding.scene)
    return {
        "range_m": truth.range_m,
        "surface": truth.surface,
        "material": labels.material(truth.surface),
        "normal": truth.normal,
        "elevation_rad": truth.elevation_rad,
        "incidence_rad": truth.incidence_rad,
        "surface_names": np.array(labels.surfaces),
        "material_names": np.array(labels.materials),
    }


def camera_arrays(sounding: PingProducts) -> Arrays:
    """What each pixel of the camera sees; normals in its optical frame."""
    view, labels = sounding.view, surface_labels(sounding.scene)
    rays = view.camera.rays()
    elevation = np.arcsin(rays[..., 2] / np.linalg.norm(rays, axis=-1))
    hit = view.hit
    incidence = np.arccos(np.clip(view.cos_incidence, 0.0, 1.0))
    return {
        "depth_m": view.depth_m,
        "range_m": view.range_m,
        "surface": view.surface,
        "material": labels.material(view.surface),
        "normal": view.normals,
        "elevation_rad": np.where(hit, elevation, np.nan).astype(np.float32),
        "incidence_rad": np.where(hit, incidence, np.nan).astype(np.float32),
        "surface_names": np.array(labels.surfaces),
        "material_names": np.array(labels.materials),
    }


def _matrix(sounding: PingProducts) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3] = sounding.map_T_sonar.rotation
    matrix[:3, 3] = sounding.map_T_sonar.position_m
    return matrix


def raw_scan(
    level: NDArray[np.float32], sonar: SonarSettings, rows: int = 400
) -> NDArray[np.float32]:
    """Lay a ping into a plan view, forward up, starboard right.

    Args:
        level: (rows, beams), of full scale.
        sonar: settings.
        rows: height of the plan view; the range fills it.

    Returns:
        float32 (rows, columns); 0 outside the fan.
    """
    sines = (np.arange(sonar.beams) - (sonar.beams - 1) / 2.0) * sonar.sine_pitch
    columns = 2 * int(np.ceil(rows * np.sin(sonar.half_aperture_rad))) + 2
    fan = fit_fan(np.arcsin(sines), sonar.range_m, (columns, rows), (0, 0, 0, 0))
    scan = warp_to_fan(level.astype(np.float32), fan)
    scan[fan.outside] = 0.0
    return scan
