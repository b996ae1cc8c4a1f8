"""Mechanically scanned sonars: one beam that a motor turns, as the Ping360's.

They are for the library: none of them speaks the Oculus protocol.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.plan import AUTO, Choice
from sonar_sim.errors import SceneError
from sonar_sim.geometry.pose import FramePose, SonarMotion, rotation_of
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.simulator import Simulator

FAN_BEAMS = 9
"""Beams that are formed about the head's direction; the middle one is the head's."""
BEAM_PITCHES = 4.0
"""Beams in a -3 dB width of that fan."""


@dataclass(frozen=True, slots=True)
class ScanningHead:
    """A sonar with one beam on a motor.

    Attributes:
        name: of the model.
        frequency_hz: acoustic frequency.
        beam_width_rad, vertical_width_rad: -3 dB full widths of the transducer, one way; it sends
            and receives, so an echo suffers both twice.
        min_range_m, max_range_m: what may be asked for.
        samples: rows of a line.
        step_rad: finest step of the motor.
        overhead_s: of a step, on top of the sound's travel.
    """

    name: str
    frequency_hz: float
    beam_width_rad: float
    vertical_width_rad: float
    min_range_m: float
    max_range_m: float
    samples: int
    step_rad: float
    overhead_s: float


PING360 = ScanningHead(
    name="Ping360",
    frequency_hz=750e3,
    beam_width_rad=math.radians(2.0),
    vertical_width_rad=math.radians(25.0),
    min_range_m=0.75,
    max_range_m=50.0,
    samples=1200,
    step_rad=math.tau / 400.0,
    overhead_s=0.0198,
)
"""Blue Robotics' Ping360 by its technical details: 750 kHz, 2° x 25°, 0.75 to 50 m, 1200 samples,
steps of 0.9°. A turn takes 9 s at 2 m and 35 s at 50 m: the sound's travel and 20 ms for each step.
"""


@dataclass(frozen=True, slots=True, eq=False)
class ScanLine:
    """The echo of one direction.

    Attributes:
        bearing_rad: of the head, positive to starboard.
        time_s: of the transmission.
        samples: (rows,), nearest first, as of `SimulatedPing.image`.
        amplitude: (rows,), float32 parts of full scale before clipping and rounding.
    """

    bearing_rad: float
    time_s: float
    samples: NDArray[np.generic]
    amplitude: NDArray[np.float32]


class ScanningSonar:
    """A scanning sonar in a scene. Equal seed, poses and times give equal bytes.

    Args:
        scene: what is there.
        head: the sonar; None is a Ping360.
        range_m: of a line.
        seed: of speckle and noise.
        effects: as for `Simulator`.
        samples: rows of a line; None has all of the head.
        changes: other fields of `SonarSettings`, such as its gain.

    Raises:
        SceneError: the head cannot do that.

    Attributes:
        settings: of each line.
    """

    def __init__(
        self,
        scene: Scene,
        head: ScanningHead | None = None,
        *,
        range_m: float = 10.0,
        seed: int = 0,
        effects: Choice = AUTO,
        samples: int | None = None,
        **changes: float,
    ) -> None:
        self.head = head = head or PING360
        if not head.min_range_m <= range_m <= head.max_range_m:
            raise SceneError(
                f"range {range_m:g} m is not {head.min_range_m:g} to {head.max_range_m:g} m, "
                f"which is what a {head.name} hears"
            )
        # One transducer sends and receives: its pattern twice is one narrower by the root of two,
        # with side lobes twice as far down.
        width_rad = head.beam_width_rad / math.sqrt(2.0)
        fields: dict[str, float] = {"side_lobe_db": 26.5, **changes}
        self.settings = SonarSettings(
            model=head.name,
            frequency_hz=head.frequency_hz,
            beams=FAN_BEAMS,
            half_aperture_rad=width_rad * (FAN_BEAMS - 1) / (2.0 * BEAM_PITCHES),
            beam_width_rad=width_rad,
            vertical_width_rad=head.vertical_width_rad,
            demanded_range_m=range_m,
            max_range_m=head.max_range_m,
            forced_rows=samples or head.samples,
            **fields,  # type: ignore[arg-type]
        )
        self._water = scene.water
        self._simulator = Simulator(scene, self.settings, seed, effects=effects)
        self._lines = 0

    @property
    def step_s(self) -> float:
        """Time from one line to the next."""
        return 2.0 * self.settings.range_m / self._water.speed_of_sound_mps + self.head.overhead_s

    @property
    def row_centres_m(self) -> NDArray[np.float64]:
        """Range of each sample's middle, (rows,)."""
        return self.settings.row_centres_m

    def line(
        self,
        map_T_sonar: FramePose,  # noqa: N803 frames are named
        bearing_rad: float,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
    ) -> ScanLine:
        """Ping once.

        Args:
            map_T_sonar: pose of the housing: x ahead, y to port, z up along the motor's axis.
            bearing_rad: of the head, positive to starboard.
            time_s: of the transmission.
            motion: of the sonar while it listens.
        """
        turn = FramePose(np.zeros(3), rotation_of(0.0, 0.0, -bearing_rad))
        if motion is not None:
            motion = SonarMotion(motion.linear_mps, turn.rotation.T @ motion.angular_rps)
        ping = self._simulator.ping(map_T_sonar @ turn, self._lines, time_s, motion)
        self._lines += 1
        middle = FAN_BEAMS // 2
        return ScanLine(bearing_rad, time_s, ping.image[:, middle], ping.amplitude[:, middle])

    def scan(
        self,
        pose_at: Callable[[float], FramePose],
        sector_rad: tuple[float, float] = (-math.pi, math.pi),
        *,
        start_s: float = 0.0,
        steps: int = 1,
    ) -> Iterator[ScanLine]:
        """Sweep a sector once, from its first bearing on; the vehicle may move meanwhile.

        Args:
            pose_at: of the housing in the map, at a time.
            sector_rad: first and last bearing; a whole turn leaves out the last.
            start_s: time of the first line.
            steps: of the motor between two lines.

        Raises:
            SceneError: the sector is empty or more than a turn, or so are the steps.
        """
        first, last = sector_rad
        if not 0.0 < last - first <= math.tau + 1e-9 or steps < 1:
            raise SceneError(f"no sector runs from {first:g} to {last:g} rad in {steps} steps")
        pitch = steps * self.head.step_rad
        if pitch > math.tau:
            raise SceneError(f"{steps} steps of a {self.head.name} are more than a turn")
        whole_turn = last - first > math.tau - 1e-9
        count = (
            round((last - first) / pitch) if whole_turn else int((last - first) / pitch + 1e-9) + 1
        )
        for k in range(count):
            time_s = start_s + k * self.step_s
            yield self.line(pose_at(time_s), first + k * pitch, time_s)
