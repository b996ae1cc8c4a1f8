"""Which cell of the ping holds what a camera's pixel sees."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.raycast.depth_camera import View
from sonar_sim.scene.sonar import SonarSettings


def cells_of(
    view: View, sonar: SonarSettings
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


def looked_up(values: NDArray[np.float32], view: View, sonar: SonarSettings) -> NDArray[np.float32]:
    """Value of each pixel's cell, (height, width); NaN where it has none.

    Args:
        values: (rows, beams).
        view: what the camera sees.
        sonar: whose cells they are.
    """
    row, beam, inside = cells_of(view, sonar)
    found: NDArray[np.float32] = np.where(inside, values[row, beam], np.float32(np.nan))
    return found
