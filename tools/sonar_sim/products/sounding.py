"""One ping of a scene with all that is known about it: what the products are made of."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import AUTO, Choice
from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.propagation.ground_truth import Truth
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.depth_camera import DepthCamera, DepthImage, Pinhole
from sonar_sim.receiver.gain import FULL_SCALE_DB, noise_level_db
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.simulator import Simulator

TINY = 1e-30
"""Amplitude under which there is no echo at all."""


@dataclass(frozen=True, slots=True, eq=False)
class PingProducts:
    """A ping and what is true of it.

    Attributes:
        scene: what was there.
        sonar: settings.
        map_T_sonar: the sonar's pose at the transmission.
        ping_id: its number.
        time_s: of the transmission.
        image: (rows, beams), as the sonar sends it.
        snr_db: float32 (rows, beams), expected echo over the receiver's noise, before the
            quantiser; NaN where nothing echoes.
        truth: what each pixel of the image shows.
        view: what a camera in the sonar's place sees.
    """

    scene: Scene
    sonar: SonarSettings
    map_T_sonar: FramePose  # noqa: N815 frames in the name
    ping_id: int
    time_s: float
    image: NDArray[Any]
    snr_db: NDArray[np.float32] = field(repr=False)
    truth: Truth = field(repr=False)
    view: DepthImage = field(repr=False)

    @property
    def level(self) -> NDArray[np.float32]:
        """The image as parts of full scale, 0 to 1."""
        top = 1.0 if self.image.dtype.kind == "f" else float(np.iinfo(self.image.dtype).max)
        level: NDArray[np.float32] = np.clip(self.image / top, 0.0, 1.0).astype(np.float32)
        return level


class ProductRenderer:
    """A sonar in a scene, with a camera in its place.

    Args:
        scene: what is there.
        sonar: what hears it.
        camera: that looks along the sonar's axis.
        seed: of speckle and noise.
        effects: as for `Simulator`.
        tolerance: by which the effects' rules decide.
    """

    def __init__(
        self,
        scene: Scene,
        sonar: SonarSettings,
        camera: Pinhole,
        seed: int = 0,
        *,
        effects: Choice = AUTO,
        tolerance: Tolerance | None = None,
    ) -> None:
        self._camera = camera
        self._simulator = Simulator(scene, sonar, seed, effects=effects, tolerance=tolerance)
        self._engine = PingEngine(scene, sonar, seed)

    def at(
        self,
        map_T_sonar: FramePose,  # noqa: N803
        ping_id: int = 0,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
    ) -> PingProducts:
        """Simulate one ping and look at the scene from where it was sent.

        Args:
            map_T_sonar: pose at the transmission.
            ping_id: names the noise.
            time_s: of the transmission.
            motion: of the sonar while it listens.
        """
        scene, sonar = self._engine.scene, self._engine.sonar
        ping = self._simulator.ping(map_T_sonar, ping_id, time_s, motion, truth=True)
        assert ping.truth is not None  # noqa: S101 it was asked for
        planned = self._simulator.plan(map_T_sonar, ping_id, time_s, motion)
        expected = expected_echo(planned.physics)
        quiet = self._engine.ping(map_T_sonar, expected, ping_id, time_s, motion)
        return PingProducts(
            scene,
            sonar,
            map_T_sonar,
            ping_id,
            time_s,
            ping.image,
            snr_db_of(quiet.amplitude, sonar, scene),
            ping.truth,
            DepthCamera(scene, time_s).look(self._camera, map_T_sonar),
        )


def expected_echo(physics: Physics) -> Physics:
    """The same ping without chance, noise and electronics: mean echoes at the receiver's input."""
    return replace(
        physics,
        speckle=False,
        volume_strength_db=None,
        reverberation=None,
        noise_level_db=None,
        crosstalk_db=None,
        ring_down_db=None,
        arrivals=(),
        tvg=False,
        gain=False,
        saturation=False,
        gamma=False,
        quantised=False,
    )


def snr_db_of(
    amplitude: NDArray[np.float32], sonar: SonarSettings, scene: Scene
) -> NDArray[np.float32]:
    """Expected echo over the noise of one cell, dB, (rows, beams); NaN without an echo.

    Args:
        amplitude: parts of full scale without any gain, (rows, beams).
        sonar: settings.
        scene: whose water is noisy.
    """
    there = amplitude > TINY
    level_db = 20.0 * np.log10(np.where(there, amplitude, 1.0)) + FULL_SCALE_DB
    snr_db = level_db - noise_level_db(sonar, scene.water)
    return np.where(there, snr_db, np.nan).astype(np.float32)
