"""Defects of the published plugin, each measured by a function."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sonar_sim.classic import pipeline as normals
from sonar_sim.classic import pipeline as snr
from sonar_sim.classic import scan
from sonar_sim.classic import scan as visual
from sonar_sim.classic.pipeline import ClassicImages, classic_camera, classic_images, places
from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.raycast.depth_camera import DepthCamera, Pinhole
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.water import Water


@dataclass(frozen=True, slots=True)
class Defect:
    """A defect.

    Attributes:
        number: as in the documentation's table.
        title: what is wrong.
        measured: what the pipeline gives, in words.
        right: what it should give.
        numbers: behind the words.
    """

    number: int
    title: str
    measured: str
    right: str
    numbers: tuple[float, ...]


FAR_M = 1e4

DepthFunction = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Depth along rays (…, 3) in the sonar frame with x = 1; infinite where nothing is."""


def wall(ahead_m: float) -> DepthFunction:
    """A plane across the axis."""
    return lambda rays: np.full(rays.shape[:-1], ahead_m)


def floor(below_m: float) -> DepthFunction:
    """A level plane under the camera."""

    def depth(rays: NDArray[np.float64]) -> NDArray[np.float64]:
        down = -rays[..., 2]
        meets = down > below_m / FAR_M
        return np.where(meets, below_m / np.where(meets, down, 1.0), np.inf)

    return depth


def sphere(ahead_m: float, radius_m: float) -> DepthFunction:
    """A sphere on the axis: nearer root of |t ray - centre| = radius."""

    def depth(rays: NDArray[np.float64]) -> NDArray[np.float64]:
        squared = np.sum(rays * rays, axis=-1)
        root = ahead_m**2 - squared * (ahead_m**2 - radius_m**2)
        nearer = (ahead_m - np.sqrt(np.maximum(root, 0.0))) / squared
        return np.where(root >= 0.0, nearer, np.inf)

    return depth


def depth_image(
    camera: Pinhole, *shapes: DepthFunction
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Depth image of shapes, 0 where nothing is, and which of them each pixel shows, or -1."""
    depths = np.stack([shape(camera.rays()) for shape in shapes])
    nearest = np.argmin(depths, axis=0)
    depth_m = np.min(depths, axis=0)
    there = (depth_m >= camera.near_m) & (depth_m <= camera.far_m)
    return np.where(there, depth_m, 0.0).astype(np.float32), np.where(there, nearest, -1)


RAYLEIGH_CV = math.sqrt(4.0 / math.pi - 1.0)
"""Coefficient of variation of the amplitude of fully developed speckle."""


def attenuation() -> Defect:
    """Level lost from 4 to 5 m, everything else equal."""
    axis, one = np.zeros(1, dtype=np.float32), np.ones((1, 1), dtype=np.float32)
    level = [float(snr.level_db(one * depth, one, axis, axis)[0, 0]) for depth in (4.0, 5.0)]
    loss_db = level[0] - level[1]
    true_db = [2.0 * Water().absorption_db_per_m(f) for f in (750e3, 1200e3)]
    return Defect(
        1,
        "attenuation, and no spreading",
        f"{loss_db:.2f} dB/m two way",
        f"{true_db[0]:.2f} dB/m at 750 kHz, {true_db[1]:.2f} at 1.2 MHz, and 40 log R",
        (loss_db, *true_db),
    )


def frame_gain() -> Defect:
    """A plane across the view; then a wall's level alone and with something near beside it."""
    camera = replace(classic_camera(), far_m=math.inf)
    plane, _ = depth_image(camera, wall(5.0))
    lost = float(np.mean(np.isnan(classic_images(plane).normals[..., 2])))
    alone, _ = depth_image(camera, floor(2.0), wall(12.0))
    beside, shown = depth_image(camera, floor(2.0), wall(12.0), sphere(1.5, 0.2))
    place = np.unravel_index(int(np.argmax(shown == 1)), shown.shape)
    levels = [float(classic_images(depth).snr[place]) for depth in (alone, beside)]
    return Defect(
        3,
        "each frame has a gain of its own",
        f"a plane across the view: {lost:.0%} NaN; a wall's level {levels[0]:.3f}, "
        f"{levels[1]:.3f} once a ball is nearer",
        "no NaN; levels that others in the view do not change",
        (lost, *levels),
    )


def vertical_pattern() -> Defect:
    """Level at the picture's upper edge against the axis, at equal range and incidence."""
    camera = classic_camera()
    up = math.radians(12.0)
    y = np.array([0.0, math.tan(up)], dtype=np.float32)
    depth_m = np.array([[5.0], [5.0 * math.cos(up)]], dtype=np.float32)
    level = snr.level_db(depth_m, np.ones((2, 1), np.float32), np.zeros(1, np.float32), y)
    lost_db = float(level[0, 0] - level[1, 0])
    edge_deg = math.degrees(camera.vertical_rad) / 2.0
    true_db = -10.0 * math.log10(
        float(vertical_two_way_power(np.array(math.sin(up)), math.radians(20.0)))
    )
    return Defect(
        4,
        "the vertical pattern is the picture's height",
        f"{abs(lost_db):.1f} dB lost at 12° elevation, all of it beyond {edge_deg:.2f}°",
        f"{true_db:.1f} dB at 12° with a 20° beam, and something beyond",
        (lost_db, edge_deg, true_db),
    )


def incidence() -> Defect:
    """Third component of the "normals" against the true cosine of incidence."""
    camera = replace(classic_camera(768, 492), far_m=FAR_M)
    rays = camera.rays()
    length = np.linalg.norm(rays, axis=-1)
    errors = []
    for shape, up, far_m in ((wall(12.0), 0, 1e4), (floor(3.0), 2, 17.0)):
        depth_m, shown = depth_image(replace(camera, far_m=far_m), shape)
        there = shown == 0
        there[1:-1, 1:-1] &= (shown[:-2, 1:-1] == 0) & (shown[2:, 1:-1] == 0)
        third = normals.gradients(depth_m, camera.focal_px)[..., 2]
        true = np.abs(rays[..., up]) / length
        errors.append(float(np.mean(np.abs(third - true)[there])))
    return Defect(
        5,
        "the normals lack the perspective term",
        f"mean error of the cosine of incidence {errors[0]:.3f} on a wall at 12 m, "
        f"{errors[1]:.3f} on a floor",
        "0",
        tuple(errors),
    )


def pedestal() -> Defect:
    """Empty water in the plan view, and an echo weaker than it."""
    empty = scan.sector_mask(classic_camera().horizontal_rad)
    grey = float(np.mean(empty[np.nonzero(empty)]))
    share = float(np.mean(empty == scan.PEDESTAL))
    weak = empty.copy()
    weak[100, 289] = 0.1
    return Defect(
        9,
        "empty water is grey in the outer two thirds",
        f"{grey:.2f} in {share:.0%} of the picture; an echo of {weak[100, 289]:.1f} is darker",
        "0 but for noise",
        (grey, share),
    )


def speckle() -> Defect:
    """Coefficient of variation of an even area."""
    even = scan.speckled(np.ones((400, 578), dtype=np.float32), np.random.default_rng(1))
    variation = float(even.std() / even.mean())
    return Defect(
        11,
        "speckle is too weak",
        f"coefficient of variation {variation:.3f}",
        f"{RAYLEIGH_CV:.3f}",
        (variation,),
    )


def colour_jump() -> Defect:
    """Red just below and at the knee."""
    reds = visual.colours(np.array([0.7999, 0.8], dtype=np.float32))[:, 0]
    return Defect(
        12,
        "the colours jump",
        f"red {reds[0]} just below 0.8, {reds[1]} at it",
        "colours that rise with the level",
        tuple(float(red) for red in reds),
    )


def clipping() -> Defect:
    """Share of a bright area that ends in the one colour of everything above 1."""
    even = scan.speckled(np.ones((400, 578), dtype=np.float32), np.random.default_rng(1))
    yellow = float(np.mean(np.all(visual.colours(even) == (255, 255, 0), axis=-1)))
    return Defect(
        13,
        "speckle lifts values over the top",
        f"{yellow:.0%} of an area at the frame's maximum are one colour",
        "full scale is set by gain, and reached by choice",
        (yellow,),
    )


def infinite_depth() -> Defect:
    """Levels that are left when pixels without an echo are infinite instead of 0."""
    depth_m, shown = depth_image(classic_camera(), floor(2.0))
    depth_m[shown < 0] = np.inf
    with np.errstate(invalid="ignore", over="ignore"):
        images = classic_images(depth_m)
    lost = float(np.mean(~(images.snr[shown == 0] > 0.0)))
    return Defect(
        16,
        "only a depth of 0 is nothing",
        f"with infinite depths outside the clip, {lost:.0%} of the echoes are lost",
        "0 %",
        (lost,),
    )


def fixed_range() -> Defect:
    """Row of an echo at 8.5 m, whatever the camera's far end; and one at 20 m."""
    rows = []
    for far_m in (9.0, 17.0, 34.0):
        camera = replace(classic_camera(), far_m=far_m)
        depth_m, _ = depth_image(camera, sphere(8.75, 0.25), floor(40.0))
        row, _, inside = scan.cells(depth_m, *places(depth_m.shape, camera.focal_px), 578)
        rows.append(int(row[inside & (depth_m > 0.0)].max()))
    beyond, _ = depth_image(replace(camera, far_m=34.0), sphere(20.0, 0.5))
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
    depth_m, shown = depth_image(camera, sphere(4.0, 0.25), floor(1.5))
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
    rows, columns = np.nonzero(scan.blurred(one))
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


BOARD_M = np.array([[8.0, -1.0, -1.0], [9.0, 1.0, -1.0], [9.0, 1.0, 1.0], [8.0, -1.0, 1.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def all_or_nothing() -> Defect:
    """Images that are computed for one that is wanted."""
    made = len(fields(ClassicImages))
    return Defect(
        14,
        "all pictures are made if one is wanted",
        f"{made} of {made}",
        "those that are asked for",
        (float(made),),
    )


def nothing_else() -> Defect:
    """What the pipeline is given: a depth image and nothing of the material, water or motion."""
    scans = []
    for name in ("mud", "rusty_steel"):
        scene = Scene((Surface("board", BOARD_M, FACES, MATERIALS[name]),))
        view = DepthCamera(scene).look(classic_camera(), FramePose(np.zeros(3), np.eye(3)))
        scans.append(classic_images(view.depth_m).raw_scan)
    changed = float(np.count_nonzero(scans[0] != scans[1]))
    louder_db = MATERIALS["rusty_steel"].lambert_db - MATERIALS["mud"].lambert_db
    return Defect(
        15,
        "no materials, beams, side lobes, multipath, noise, motion, seed",
        f"its only input is depth: of mud or of steel, {changed:.0f} pixels of a board differ",
        f"{louder_db:.0f} dB",
        (changed, louder_db),
    )


def defects() -> list[Defect]:
    """Measure them all, in order."""
    return [
        attenuation(),
        fixed_range(),
        frame_gain(),
        vertical_pattern(),
        incidence(),
        last_write(),
        corner_range(),
        centre_column(),
        pedestal(),
        broadening(),
        speckle(),
        colour_jump(),
        clipping(),
        all_or_nothing(),
        nothing_else(),
        infinite_depth(),
        principal_point(),
    ]


def defect_table() -> list[str]:
    """Lines of the page's table."""
    head = ["| # | defect | measured on it | right |", "|---|---|---|---|"]
    return head + [
        f"| {found.number} | {found.title} | {found.measured} | {found.right} |"
        for found in defects()
    ]
