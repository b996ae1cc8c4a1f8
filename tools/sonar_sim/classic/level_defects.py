"""What is wrong with the levels."""

import math
from dataclasses import replace

import numpy as np

from sonar_sim.classic import normals, scan, shapes, snr, visual
from sonar_sim.classic.defect import Defect
from sonar_sim.classic.pipeline import classic_camera, classic_images
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.scene.water import Water

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
    plane, _ = shapes.seen(camera, shapes.wall(5.0))
    lost = float(np.mean(np.isnan(classic_images(plane).normals[..., 2])))
    alone, _ = shapes.seen(camera, shapes.floor(2.0), shapes.wall(12.0))
    beside, shown = shapes.seen(
        camera, shapes.floor(2.0), shapes.wall(12.0), shapes.sphere(1.5, 0.2)
    )
    place = np.unravel_index(int(np.argmax(shown == 1)), shown.shape)
    wall = [float(classic_images(depth).snr[place]) for depth in (alone, beside)]
    return Defect(
        3,
        "each frame has a gain of its own",
        f"a plane across the view: {lost:.0%} NaN; a wall's level {wall[0]:.3f}, "
        f"{wall[1]:.3f} once a ball is nearer",
        "no NaN; levels that others in the view do not change",
        (lost, *wall),
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
    camera = replace(classic_camera(768, 492), far_m=shapes.FAR_M)
    rays = camera.rays()
    length = np.linalg.norm(rays, axis=-1)
    errors = []
    for shape, up, far_m in ((shapes.wall(12.0), 0, 1e4), (shapes.floor(3.0), 2, 17.0)):
        depth_m, shown = shapes.seen(replace(camera, far_m=far_m), shape)
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
    empty = scan.pie(classic_camera().horizontal_rad)
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
    depth_m, shown = shapes.seen(classic_camera(), shapes.floor(2.0))
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
