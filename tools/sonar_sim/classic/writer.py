"""The published pipeline's products as files."""

from pathlib import Path

import numpy as np
import yaml

from oculus_driver.render.files import write_png
from sonar_sim.classic.pipeline import CLOUD_FROM_M, classic_images
from sonar_sim.products.images import camera_info, depth_picture
from sonar_sim.products.point_cloud import hit_points, write_cloud
from sonar_sim.raycast.depth_camera import DepthImage


def write_classic(folder: Path, view: DepthImage, seed: int = 1) -> list[Path]:
    """Run the pipeline on what a camera sees, and write all it publishes.

    Args:
        folder: made if it is not there.
        view: of the camera.
        seed: of its speckle.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with np.errstate(invalid="ignore"):
        images = classic_images(
            view.depth_m, view.camera.horizontal_rad, np.random.default_rng(seed)
        )
        bytes_of = {
            "normals": (255.0 * images.normals).clip(0.0, 255.0).astype(np.uint8)[..., ::-1],
            "snr": (255.0 * images.snr).clip(0.0, 255.0).astype(np.uint8),
            "raw_scan": (255.0 * images.raw_scan).clip(0.0, 255.0).astype(np.uint8),
            "fan": images.fan[..., ::-1],
        }
    write_png(folder / "depth.png", depth_picture(view.depth_m))  # type: ignore[arg-type]
    for name, picture in bytes_of.items():
        write_png(folder / f"{name}.png", np.ascontiguousarray(picture))
    np.savez_compressed(
        folder / "classic.npz",
        depth_m=images.depth_m,
        normals=images.normals,
        snr=images.snr,
        raw_scan=images.raw_scan,
    )
    _write_points(folder / "points.ply", view)
    info = yaml.safe_dump(camera_info(view.camera), sort_keys=False)
    (folder / "camera_info.yaml").write_text(info)
    return sorted(folder.iterdir())


def _write_points(path: Path, view: DepthImage) -> None:
    kept = view.depth_m[view.hit] > CLOUD_FROM_M
    points_m = view.points_m()[kept]
    count = len(points_m)
    black = np.zeros((count, 3), dtype=np.uint8)
    nothing = np.full(count, np.nan, dtype=np.float32)
    write_cloud(path, hit_points(points_m, black, nothing, view.surface[view.hit][kept]), "sonar")
