"""What is wrong with where things are."""

import math
from dataclasses import replace

import numpy as np

from sonar_sim.classic import scan, shapes
from sonar_sim.classic.defect import Defect
from sonar_sim.classic.pipeline import classic_camera, classic_images, places


def fixed_range() -> Defect:
    """Row of an echo at 8.5 m, whatever the camera's far end; and one at 20 m."""
    rows = []
    for far_m in (9.0, 17.0, 34.0):
        camera = replace(classic_camera(), far_m=far_m)
        depth_m, _ = shapes.seen(camera, shapes.sphere(8.75, 0.25), shapes.floor(40.0))
        row, _, inside = scan.cells(depth_m, *places(depth_m.shape, camera.focal_px), 578)
        rows.append(int(row[inside & (depth_m > 0.0)].max()))
    beyond, _ = shapes.seen(replace(camera, far_m=34.0), shapes.sphere(20.0, 0.5))
    _, _, inside = scan.cells(beyond, *places(beyond.shape, camera.focal_px), 578)
    drawn = int(np.count_nonzero(inside & (beyond > 0.0)))
    return Defect(
        2,
        "17 m and 400 rows are fixed",
        f"rows {rows[0]}, {rows[1]}, {rows[2]} for an echo at 8.5 m with the range set to 9, 17 "
        f"and 34 m; {drawn} pixels of a ball at 20 m",
        "the range that was set fills the picture",
        (*map(float, rows), float(drawn)),
    )


def last_write() -> Defect:
    """A ball over a floor: its pixels, its cells, and those it keeps."""
    camera = classic_camera(768, 492)
    depth_m, shown = shapes.seen(camera, shapes.sphere(4.0, 0.25), shapes.floor(1.5))
    images = classic_images(depth_m)
    row, column, inside = scan.cells(depth_m, *places(depth_m.shape, camera.focal_px), 578)
    written = inside & (depth_m != 0.0) & (images.snr != 0.0)
    ball = inside & (shown == 0)
    cells = len(set(zip(row[ball].tolist(), column[ball].tolist(), strict=True)))
    owner = np.full((scan.ROWS, 578), -1)
    owner[row[written], column[written]] = shown[written]
    pixels, kept = int(np.count_nonzero(shown == 0)), int(np.count_nonzero(owner == 0))
    return Defect(
        6,
        "the last pixel of a cell wins",
        f"a ball of 0.25 m at 4 m, 1.5 m over a floor: {pixels} pixels, {cells} cells, "
        f"{kept} of them left",
        "echoes of a cell add up",
        (float(pixels), float(cells), float(kept)),
    )


def corner_range() -> Defect:
    """Range of the picture's corner in the plan view over its slant range."""
    errors = []
    for camera in (classic_camera(), classic_camera(768, 492)):
        x = camera.width / 2.0 / camera.focal_px
        y = camera.height / 2.0 / camera.focal_px
        errors.append(math.sqrt((1.0 + x * x) * (1.0 + y * y) / (1.0 + x * x + y * y)) - 1.0)
    return Defect(
        7,
        "the plan view's range is not the slant range",
        f"{errors[0]:+.1%} in the corner of 760 x 169 pixels, {errors[1]:+.1%} of 768 x 492",
        "0",
        tuple(errors),
    )


def centre_column() -> Defect:
    """Pixels that fall into the middle column, over its neighbours' mean."""
    camera = classic_camera(768, 492)
    depth_m = np.random.default_rng(1).uniform(2.0, 16.0, (492, 768)).astype(np.float32)
    _, column, inside = scan.cells(depth_m, *places(depth_m.shape, camera.focal_px), 578)
    hits = np.bincount(column[inside], minlength=578)
    ratio = float(hits[289] / np.mean(hits[[287, 288, 290, 291]]))
    return Defect(
        8,
        "truncation towards zero",
        f"the middle column gets {ratio:.1f} times the pixels of its neighbours",
        "1.0 times",
        (ratio,),
    )


def broadening() -> Defect:
    """Extent of a single cell after what is called the median filter."""
    one = np.zeros((400, 578), dtype=np.float32)
    one[200, 289] = 1.0
    rows, columns = np.nonzero(scan.broadened(one))
    half = (float(np.ptp(rows)) / 2.0, float(np.ptp(columns)) / 2.0)
    cell_m = scan.RANGE_M / scan.ROWS
    return Defect(
        10,
        "echoes are thickened",
        f"±{half[0]:.0f} rows and ±{half[1]:.0f} column: ±{100 * half[0] * cell_m:.0f} cm, "
        f"±{100 * half[1] * cell_m:.0f} cm",
        "the pulse's length and the beam's width",
        half,
    )


def principal_point() -> Defect:
    """Bearing of what lies on the camera's axis."""
    camera = classic_camera()
    x, _ = places((camera.height, camera.width), camera.focal_px)
    across, _ = camera.centre_px
    offset_deg = float(np.degrees(np.interp(across, np.arange(camera.width), np.arctan(x))))
    return Defect(
        17,
        "the principal point is a pixel beside the axis",
        f"what is straight ahead is drawn at {offset_deg:+.2f}°",
        "0°",
        (offset_deg,),
    )
