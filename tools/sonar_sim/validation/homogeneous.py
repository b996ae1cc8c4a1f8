"""An even sheet of scatterers before a sonar: what the statistics of speckle are measured on."""

import math

import numpy as np
from numpy.typing import NDArray

from sonar_sim.beams import BeamFormer, beam_former
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.noise import add_random, stream_key
from sonar_sim.scene.sonar import SonarSettings

MARGIN = 24
"""Columns beyond the outermost beams, so that those hear as much as the middle."""


class Homogeneous:
    """Fully developed speckle of one level, frozen, and noise that is new in every ping.

    Args:
        sonar: for the beams.
        rows: of the sheet.
        physics: beam width, side lobes and range spread are obeyed.
        seed: of the scatterers.
    """

    def __init__(
        self, sonar: SonarSettings, rows: int, physics: Physics | None = None, seed: int = 0
    ) -> None:
        self.physics = physics or Physics(
            beam_width_rad=sonar.beam_width_rad,
            side_lobe_db=sonar.side_lobe_db,
            range_spread=True,
            sine_bearings=True,
        )
        self._rows = rows
        self._columns = sonar.beams + 2 * MARGIN
        self._seed = seed
        self.former: BeamFormer = beam_former(sonar, self.physics, MARGIN)

    def beams(
        self, ping_id: int = 0, signal_db: float = 0.0, noise_db: float = -math.inf
    ) -> NDArray[np.complex64]:
        """What the beams hear, (rows, beams).

        Args:
            ping_id: of the noise.
            signal_db: mean level of the echo in a beam.
            noise_db: of the noise in a beam.
        """
        field = np.zeros((self._rows, self._columns), dtype=np.complex64)
        everywhere = np.ones(self._columns, dtype=np.float32)
        for level_db, key in (
            (signal_db, stream_key(self._seed, "surface")),
            (noise_db, stream_key(self._seed, "noise", ping_id)),
        ):
            rms = 10.0 ** (level_db / 20.0) / self.former.noise_gain
            add_random(field, np.full(self._rows, rms, dtype=np.float32), everywhere, key)
        return self.former.form(field)
