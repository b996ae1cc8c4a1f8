"""The published pipeline's products as files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from oculus_driver.render.files import write_png
from sonar_sim.classic.pipeline import CLOUD_FROM_M, classic_images
from sonar_sim.classic.scan import RANGE_M, ROWS
from sonar_sim.errors import SonarSimError
from sonar_sim.products.images import camera_info, depth_picture
from sonar_sim.products.point_cloud import hit_points, write_cloud
from sonar_sim.raycast.depth_camera import DepthImage

CLASSIC_PRODUCTS = ("depth", "normals", "snr", "raw_scan", "fan", "points", "camera_info")
ARRAYS = {"depth": "depth_m", "normals": "normals", "snr": "snr", "raw_scan": "raw_scan"}
"""Array in `classic.npz` of a product."""


def write_classic(
    folder: Path,
    view: DepthImage,
    seed: int = 1,
    only: Sequence[str] = (),
    *,
    rows: int = ROWS,
    range_m: float = RANGE_M,
) -> list[Path]:
    """Run the pipeline on what a camera sees, and write what it publishes.

    Args:
        folder: made if it is not there.
        view: of the camera.
        seed: of its speckle.
        only: products to write; none writes all.
        rows: of the plan view.
        range_m: that they cover.

    Raises:
        SonarSimError: a product that the plugin does not have.
    """
    for name in only:
        if name not in CLASSIC_PRODUCTS:
            known = ", ".join(CLASSIC_PRODUCTS)
            raise SonarSimError(f"classic mode has no product {name}; it has {known}")
    wanted = only or CLASSIC_PRODUCTS
    folder.mkdir(parents=True, exist_ok=True)
    with np.errstate(invalid="ignore"):
        images = classic_images(
            view.depth_m,
            view.camera.horizontal_rad,
            np.random.default_rng(seed),
            rows=rows,
            range_m=range_m,
        )
        pictures: dict[str, Any] = {
            "depth": depth_picture(view.depth_m),
            "normals": (255.0 * images.normals).clip(0.0, 255.0).astype(np.uint8)[..., ::-1],
            "snr": (255.0 * images.snr).clip(0.0, 255.0).astype(np.uint8),
            "raw_scan": (255.0 * images.raw_scan).clip(0.0, 255.0).astype(np.uint8),
            "fan": images.fan[..., ::-1],
        }
    written = [folder / f"{name}.png" for name in pictures if name in wanted]
    for path in written:
        write_png(path, np.ascontiguousarray(pictures[path.stem]))
    arrays = {field: getattr(images, field) for name, field in ARRAYS.items() if name in wanted}
    if arrays:
        written.append(folder / "classic.npz")
        np.savez_compressed(written[-1], allow_pickle=False, **arrays)
    if "points" in wanted:
        written.append(folder / "points.ply")
        _write_points(written[-1], view)
    if "camera_info" in wanted:
        written.append(folder / "camera_info.yaml")
        written[-1].write_text(yaml.safe_dump(camera_info(view.camera), sort_keys=False))
    return sorted(written)


def _write_points(path: Path, view: DepthImage) -> None:
    kept = view.depth_m[view.hit] > CLOUD_FROM_M
    points_m = view.points_m()[kept]
    count = len(points_m)
    black = np.zeros((count, 3), dtype=np.uint8)
    nothing = np.full(count, np.nan, dtype=np.float32)
    write_cloud(path, hit_points(points_m, black, nothing, view.surface[view.hit][kept]), "sonar")
