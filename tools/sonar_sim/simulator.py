"""One ping, from a pose to the sonar's 8-bit image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.casting import Caster, Hits, fan_of
from sonar_sim.echo import echo_power
from sonar_sim.poses import Pose
from sonar_sim.receiver import FULL_SCALE_DB, gain_db, noise_level_db, pixels
from sonar_sim.scene import Scene
from sonar_sim.sonar import SonarSettings
from sonar_sim.speckle import beam_former, complex_gaussian, pose_generator, scattered_field
from sonar_sim.water import Water

NOISE_STREAM = 1
"""Keeps the receiver's noise apart from every other use of the seed."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPing:
    """What one ping gives.

    Attributes:
        image: (rows, beams), row 0 nearest, column 0 the most negative bearing.
        seen_m: points of the surfaces in the sonar's sight, map frame, (N, 3).
    """

    image: NDArray[np.uint8]
    seen_m: NDArray[np.float64]


class Simulator:
    """A sonar in a scene. Equal seed, pose and ping number give equal bytes."""

    def __init__(
        self, scene: Scene, sonar: SonarSettings, water: Water | None = None, seed: int = 0
    ) -> None:
        self.sonar = sonar
        self.water = water or Water()
        self._seed = seed
        self._caster = Caster(scene)
        self._fan = fan_of(sonar)
        self._form_beams = beam_former(sonar)
        self._absorption = self.water.absorption_db_per_m(sonar.frequency_hz)
        self._noise_db = noise_level_db(sonar, self.water)
        full_scale_db = FULL_SCALE_DB - gain_db(sonar, self._absorption)
        self._gain = (10.0 ** (-full_scale_db / 20.0)).astype(np.float32)[:, None]

    def ping(self, map_T_sonar: Pose, ping_id: int) -> SimulatedPing:  # noqa: N803
        """Simulate one ping from a pose; the sonar is taken to stand still while it listens."""
        hits = self._caster.cast(self._fan, map_T_sonar, self.sonar.range_m)
        power = echo_power(hits, self._fan, self.sonar, self._absorption)
        field = scattered_field(power, pose_generator(self._seed, map_T_sonar))
        field *= np.float32(10.0 ** (self.sonar.source_level_db / 20.0))
        received = self._form_beams(field) + self._noise(ping_id)
        image = pixels(np.abs(received) * self._gain, self.sonar.gamma_byte)
        return SimulatedPing(image, self._seen(hits, map_T_sonar))

    def _noise(self, ping_id: int) -> NDArray[np.complex64]:
        words = np.random.SeedSequence([self._seed, NOISE_STREAM, ping_id])
        generator = np.random.Generator(np.random.PCG64(words))
        unit = complex_gaussian(generator, self.sonar.rows * self.sonar.beams)
        return unit.reshape(self.sonar.rows, self.sonar.beams) * np.float32(
            10.0 ** (self._noise_db / 20.0)
        )

    def _seen(self, hits: Hits, map_T_sonar: Pose) -> NDArray[np.float64]:  # noqa: N803
        """First hits inside the -3 dB aperture, whether or not their echo can be heard."""
        direction = self._fan.directions[hits.ray]
        inside = (np.abs(direction[:, 1]) <= np.sin(self.sonar.half_aperture_rad)) & (
            np.abs(direction[:, 2]) <= np.sin(self.sonar.vertical_width_rad / 2.0)
        )
        local = direction[inside] * hits.range_m[inside, None]
        seen: NDArray[np.float64] = local @ map_T_sonar.rotation.T + map_T_sonar.position_m
        return seen
