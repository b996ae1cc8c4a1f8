"""The products as arrays, under the names that their NPZ files give them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonar_sim.products.cells import looked_up
from sonar_sim.products.labels import labels_of
from sonar_sim.products.sounding import Sounding

Arrays = dict[str, NDArray[Any]]


def polar_arrays(sounding: Sounding) -> Arrays:
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


def snr_arrays(sounding: Sounding) -> Arrays:
    """Expected echo over noise, of the ping's cells and of the cells that the camera sees."""
    camera = looked_up(sounding.snr_db, sounding.view, sounding.sonar)
    return {"polar_db": sounding.snr_db, "camera_db": camera}


def truth_arrays(sounding: Sounding) -> Arrays:
    """What each pixel of the ping shows: the strongest echo in the cell. NaN and -1 are nothing."""
    truth, labels = sounding.truth, labels_of(sounding.scene)
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


def camera_arrays(sounding: Sounding) -> Arrays:
    """What each pixel of the camera sees; normals in its optical frame."""
    view, labels = sounding.view, labels_of(sounding.scene)
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


def _matrix(sounding: Sounding) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3] = sounding.map_T_sonar.rotation
    matrix[:3, 3] = sounding.map_T_sonar.position_m
    return matrix
