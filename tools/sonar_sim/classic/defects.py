"""All defects, measured; the table of the page is made from them."""

from dataclasses import fields

import numpy as np

from sonar_sim.classic import level_defects as level
from sonar_sim.classic import shape_defects as shape
from sonar_sim.classic.defect import Defect
from sonar_sim.classic.pipeline import ClassicImages, classic_camera, classic_images
from sonar_sim.geometry.pose import Pose
from sonar_sim.material import MATERIALS
from sonar_sim.raycast.depth_camera import Onlooker
from sonar_sim.scene.scene import Scene, Surface

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
        view = Onlooker(scene).look(classic_camera(), Pose(np.zeros(3), np.eye(3)))
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
        level.attenuation(),
        shape.fixed_range(),
        level.frame_gain(),
        level.vertical_pattern(),
        level.incidence(),
        shape.last_write(),
        shape.corner_range(),
        shape.centre_column(),
        level.pedestal(),
        shape.broadening(),
        level.speckle(),
        level.colour_jump(),
        level.clipping(),
        all_or_nothing(),
        nothing_else(),
        level.infinite_depth(),
        shape.principal_point(),
    ]


def defect_table() -> list[str]:
    """Lines of the page's table."""
    head = ["| # | defect | measured on it | right |", "|---|---|---|---|"]
    return head + [
        f"| {found.number} | {found.title} | {found.measured} | {found.right} |"
        for found in defects()
    ]
