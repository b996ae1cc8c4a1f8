"""Products as files: PNG to look at, NPZ to reckon with, PLY and YAML."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from oculus_driver.render import Style
from oculus_driver.render.files import write_png
from sonar_sim.errors import SonarSimError
from sonar_sim.products import arrays
from sonar_sim.products.arrays import lookup_pixels, raw_scan
from sonar_sim.products.images import (
    camera_info,
    colour_map,
    depth_picture,
    fan_picture,
    label_picture,
    level_picture,
    normal_picture,
)
from sonar_sim.products.point_cloud import hit_points, write_cloud
from sonar_sim.products.sounding import PingProducts


@dataclass(frozen=True, slots=True)
class ProductSettings:
    """How pictures look.

    Attributes:
        style: of the fan picture; its colours serve the others too.
        scan_rows: height of the raw scan.
    """

    style: Style = field(default_factory=Style)
    scan_rows: int = 400


def write_products(
    folder: Path,
    sounding: PingProducts,
    only: Sequence[str] = (),
    look: ProductSettings | None = None,
) -> list[Path]:
    """Write a ping's products; nothing is worked out for those that are not asked for.

    Args:
        folder: made if it is not there.
        sounding: the ping.
        only: names of `PRODUCTS`; none means all.
        look: of the pictures.

    Returns:
        The files.

    Raises:
        SonarSimError: there is no such product.
    """
    unknown = [name for name in only if name not in PRODUCTS]
    if unknown:
        raise SonarSimError(f"no product is called {unknown[0]}; there are {', '.join(PRODUCTS)}")
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    for name in only or PRODUCTS:
        files += PRODUCTS[name](folder, sounding, look or ProductSettings())
    return files


def _polar(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    del look
    grey = np.rint(sounding.level * 255.0).astype(np.uint8)
    return [
        _npz(folder / "polar.npz", arrays.polar_arrays(sounding)),
        _png(folder / "polar.png", grey),
    ]


def _depth(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    del look
    return [
        _npz(folder / "camera.npz", arrays.camera_arrays(sounding)),
        _png(folder / "depth.png", depth_picture(sounding.view.depth_m)),
    ]


def _normals(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    del look
    return [_png(folder / "normals.png", normal_picture(sounding.view.normals))]


def _snr(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    found, colours = arrays.snr_arrays(sounding), look.style.colours
    return [
        _npz(folder / "snr.npz", found),
        _png(folder / "snr.png", level_picture(found["camera_db"], colours)),
        _png(folder / "snr_polar.png", level_picture(found["polar_db"], colours)),
    ]


def _raw_scan(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    scan = raw_scan(sounding.level, sounding.sonar, look.scan_rows)
    per_px = np.array(sounding.sonar.range_m / look.scan_rows)
    return [
        _npz(folder / "raw_scan.npz", {"scan": scan, "metres_per_px": per_px}),
        _png(folder / "raw_scan.png", np.rint(scan * 255.0).astype(np.uint8)),
    ]


def _fan(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    return [_png(folder / "fan.png", fan_picture(sounding, look.style))]


def _points(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    view, pose = sounding.view, sounding.map_T_sonar
    level = lookup_pixels(sounding.level, view, sounding.sonar)[view.hit]
    shade = np.rint(255.0 * np.nan_to_num(level)).astype(np.uint8)
    colours = colour_map(shade[:, None], look.style.colours)[:, 0, ::-1]
    points_m = view.points_m() @ pose.rotation.T + pose.position_m
    path = folder / "points.ply"
    write_cloud(path, hit_points(points_m, colours, level, view.surface[view.hit]), "map frame")
    return [path]


def _camera_info(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    del look
    path = folder / "camera_info.yaml"
    path.write_text(yaml.safe_dump(camera_info(sounding.view.camera), sort_keys=False))
    return [path]


def _truth(folder: Path, sounding: PingProducts, look: ProductSettings) -> list[Path]:
    del look
    return [
        _npz(folder / "truth.npz", arrays.truth_arrays(sounding)),
        _png(folder / "truth.png", label_picture(sounding.truth.surface)),
    ]


PRODUCTS: MappingProxyType[str, Callable[[Path, PingProducts, ProductSettings], list[Path]]] = (
    MappingProxyType(
        {
            "polar": _polar,
            "depth": _depth,
            "normals": _normals,
            "snr": _snr,
            "raw_scan": _raw_scan,
            "fan": _fan,
            "points": _points,
            "camera_info": _camera_info,
            "truth": _truth,
        }
    )
)
"""What can be written, by name."""


def _npz(path: Path, content: dict[str, NDArray[Any]]) -> Path:
    np.savez_compressed(path, **content)  # type: ignore[arg-type]
    return path


def _png(path: Path, picture: NDArray[Any]) -> Path:
    write_png(path, picture)
    return path
