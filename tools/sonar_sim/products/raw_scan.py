"""The ping in plan view, without grid or colours: the raw scan."""

import numpy as np
from numpy.typing import NDArray

from oculus_driver.render import fit_fan, warp_to_fan
from sonar_sim.scene.sonar import SonarSettings


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
