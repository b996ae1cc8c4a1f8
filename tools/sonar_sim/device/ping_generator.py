"""Simulates pings as messages that answer fire messages."""

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oculus_driver.encode import bearing_table_cdeg, encode_ping
from oculus_driver.sound_speed import pressure_bar_at
from oculus_driver.virtual_sonar.device import FireRequest
from oculus_driver.virtual_sonar.resample import with_settings_echo
from oculus_driver.wire import FireFlags
from sonar_sim.device.fire_settings import BITS_32, part_number_of, settings_for
from sonar_sim.effects.plan import AUTO, EffectWarning
from sonar_sim.geometry.pose import FramePose, Mounting, SonarMotion
from sonar_sim.receiver.gain import gain_db
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.simulator import Simulator
from sonar_sim.wire import compass_heading_deg

TICK_S = 8e-9
"""Length of a version-1 clock tick."""

TOP_GAIN_WORD = 2.0**31
"""Gain word of the loudest row; the reference of real gain words is not documented."""

SIMULATORS_KEPT = 2


@dataclass(frozen=True, slots=True, eq=False)
class TransmitState:
    """A ping's number, times, and the vehicle's state at transmission.

    Attributes:
        ping_id: increasing number.
        boot_s: seconds since power-up.
        time_s: time of the scene.
        map_T_base: pose of the vehicle.
        velocity_mps, turn_rates_rps: motion of the vehicle, body frame, (3,).
    """

    ping_id: int
    boot_s: float
    time_s: float
    map_T_base: FramePose  # noqa: N815 frames are named
    velocity_mps: NDArray[np.float64]
    turn_rates_rps: NDArray[np.float64]


class PingGenerator:
    """Simulates requested pings; slow, so call it in a separate thread.

    Args:
        scene: the scene.
        sonar: the scenario's sonar; fire messages change it.
        mounting: mounting of the sonar on the vehicle.
        seed: seed of speckle and noise.
        source_id: source id in the messages' headers.
        effects: as for `sonar_sim.Simulator`.

    Attributes:
        part_number: part number of the model.
    """

    def __init__(
        self,
        scene: Scene,
        sonar: SonarSettings,
        mounting: Mounting,
        *,
        seed: int = 0,
        source_id: int = 0,
        effects: str = AUTO,
    ) -> None:
        self._scene = scene
        self._sonar = sonar
        self._mounting = mounting
        self._seed = seed
        self._effects = effects
        self._source_id = source_id
        self.part_number = part_number_of(sonar.model)
        self._simulators: dict[SonarSettings, Simulator] = {}

    def settings(self, demand: FireRequest) -> SonarSettings:
        """Return the sonar's settings after a fire message."""
        return settings_for(demand, self._sonar, self._scene.water)

    def make(self, demand: FireRequest, when: TransmitState) -> bytes:
        """Simulate a ping and encode it.

        Args:
            demand: the fire message; the ping repeats it.
            when: number, times and state.
        """
        sonar = self.settings(demand)
        map_T_sonar = when.map_T_base @ self._mounting.pose  # noqa: N806 frames are named
        simulator, motion = self._simulator(sonar), self._motion(when)
        with warnings.catch_warnings():
            if sonar.bits == BITS_32:  # requested without varying gain, regardless of the scene
                warnings.simplefilter("ignore", EffectWarning)
            ping = simulator.ping(map_T_sonar, when.ping_id, when.time_s, motion)
        image: NDArray[Any] = ping.image  # integers, because quantisation is always on
        return self._encoded(demand, sonar, image, when)

    def _motion(self, when: TransmitState) -> SonarMotion:
        """Return the motion of the sonar, which is mounted off the vehicle's origin."""
        mounting = self._mounting.pose
        body_mps = when.velocity_mps + np.cross(when.turn_rates_rps, mounting.position_m)
        return SonarMotion(
            linear_mps=when.map_T_base.rotation @ body_mps,
            angular_rps=mounting.rotation.T @ when.turn_rates_rps,
        )

    def _encoded(
        self,
        demand: FireRequest,
        sonar: SonarSettings,
        image: NDArray[Any],
        when: TransmitState,
    ) -> bytes:
        water, map_T_base = self._scene.water, when.map_T_base  # noqa: N806 frames are named
        depth_m = max(0.0, -float(map_T_base.position_m[2]))
        roll_deg, pitch_deg = _tilt_deg(map_T_base)
        data = encode_ping(
            version=demand.version,
            ping_id=when.ping_id % 2**32,
            mode=sonar.mode,
            frequency_hz=sonar.frequency_hz,
            range_m=demand.range_demand,
            gain_percent=demand.gain_percent,
            speed_of_sound_mps=sonar.told_speed_mps or water.speed_of_sound_mps,
            salinity_ppt=demand.salinity_ppt,
            start_time=when.boot_s if demand.version != 1 else round(when.boot_s / TICK_S),
            range_resolution_m=sonar.range_resolution_m,
            bearings_cdeg=bearing_table_cdeg(sonar.beams, sonar.half_aperture_rad),
            image=image,
            gains=self._gain_words(sonar) if demand.flags & FireFlags.SEND_GAIN else None,
            source_id=self._source_id,
            part_number=self.part_number,
            flags=demand.flags,
            gamma=demand.gamma,
            temperature_c=water.temperature_c,
            pressure_bar=pressure_bar_at(depth_m, water.salinity_ppt),
            heading_deg=compass_heading_deg(map_T_base.rotation),
            pitch_deg=pitch_deg,
            roll_deg=roll_deg,
        )
        return with_settings_echo(data, demand)

    def _simulator(self, sonar: SonarSettings) -> Simulator:
        """Return the simulator for these settings; the last one is cached."""
        if sonar not in self._simulators:
            while len(self._simulators) >= SIMULATORS_KEPT:
                del self._simulators[next(iter(self._simulators))]
            forced = ",+quantisation" + (",-tvg" if sonar.bits == BITS_32 else "")
            self._simulators[sonar] = Simulator(
                self._scene, sonar, self._seed, effects=self._effects + forced
            )
        return self._simulators[sonar]

    def _gain_words(self, sonar: SonarSettings) -> NDArray[np.uint32]:
        """Return the power gain of each row, (rows,): sample / sqrt(gain) is the echo's level."""
        if sonar.bits == BITS_32:
            return np.full(sonar.rows, TOP_GAIN_WORD, dtype=np.uint32)
        level_db = gain_db(sonar, self._scene.water.absorption_db_per_m(sonar.frequency_hz))
        words = TOP_GAIN_WORD * 10.0 ** ((level_db - level_db.max()) / 10.0)
        whole: NDArray[np.uint32] = np.maximum(1, np.rint(words)).astype(np.uint32)
        return whole


def _tilt_deg(map_T_base: FramePose) -> tuple[float, float]:  # noqa: N803 frames are named
    """Return roll, positive to starboard, and pitch, positive nose up."""
    up = map_T_base.rotation[2]
    return math.degrees(math.atan2(up[1], up[2])), math.degrees(math.asin(np.clip(up[0], -1, 1)))
