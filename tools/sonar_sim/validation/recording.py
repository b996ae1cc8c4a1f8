"""A recording of a real sonar, and the same sonar simulated before a scene as bright.

No public recording comes with surveyed geometry, so the scene's echo strength is taken from the
recording itself: its mean power up to the floor's far end, smoothed over many cells so that no
speckle is left, less the noise. What is compared is all that the simulator adds: the law of pixels,
speckle, what of it stays from ping to ping, how beams and rows share it, the tail behind the floor,
and how the noise grows with range.
"""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from oculus_driver import Ping, StreamParser, decode_ping
from sonar_sim import _core
from sonar_sim.geometry.pose import FramePose, rotation_of
from sonar_sim.propagation.physics import Physics, Reverberation
from sonar_sim.receiver.beamformer import beam_former
from sonar_sim.receiver.gain import amplitude, quantise, row_gain
from sonar_sim.receiver.noise import add_random, add_tail, noise_rms, stream_key
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.water import Water
from sonar_sim.simulator import Simulator
from sonar_sim.validation.statistics import linear_amplitude, noise_power

MARGIN = 12
SMOOTHING = (6.0, 5.0)
"""Rows and beams, one sigma: some hundred cells."""
BAND_ROWS = 25
NOISY_M = ((0.2, 0.56), (1.28, 2.0))
"""Ranges of the public recording at which what changes between pings is mostly noise."""
FLOOR_END_M = 1.3
"""Of the public recording: behind lies no echo but the tail."""
FLOOR_HEIGHT_M, FLOOR_PITCH_RAD, FLOOR_GAIN_PERCENT = 0.66, math.radians(42.0), 78.0
"""Of an even floor that is as far, as long and as bright as the recorded one."""
VERTICAL_WIDTH_RAD = math.radians(14.0)
"""Unpublished; 12° to 20° are said of such units."""
BEAM_WIDTH_RAD = math.radians(0.4)
SIDE_LOBE_DB = 40.0
"""Unpublished; the recorded beams are so nearly Gaussian that their side lobes must be low."""
WATER = Water(temperature_c=15.0, salinity_ppt=0.0, depth_m=1.0, acidity_ph=7.0)
"""A tank's, for the absorption that the usual law of the varied gain makes up for."""


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Pings of one still sonar.

    Attributes:
        pixels: (pings, rows, beams).
        bearings_deg: (beams,).
        sonar: settings of the recording's header.
    """

    pixels: NDArray[np.uint8]
    bearings_deg: NDArray[np.float64]
    sonar: SonarSettings

    @property
    def amplitudes(self) -> NDArray[np.float64]:
        """Parts of full scale, (pings, rows, beams)."""
        return linear_amplitude(self.pixels, self.sonar.gamma_byte)


def read_recording(path: Path) -> Recorded:
    """Read a file of 8-bit pings, all of one setting."""
    messages = StreamParser().feed(path.read_bytes(), arrival_ns=0)
    decoded = [decode_ping(message) for message in messages]
    pings = [ping for ping in decoded if isinstance(ping, Ping)]
    return Recorded(
        np.stack([ping.image for ping in pings]).astype(np.uint8),
        np.degrees(pings[0].bearings_rad),
        _settings(pings[0]),
    )


def _settings(ping: Ping) -> SonarSettings:
    return SonarSettings(
        frequency_hz=ping.frequency_hz,
        beams=ping.beams,
        half_aperture_rad=float(ping.bearings_rad[-1]),
        beam_width_rad=BEAM_WIDTH_RAD,
        side_lobe_db=SIDE_LOBE_DB,
        demanded_range_m=ping.rows * ping.range_resolution_m,
        base_row_m=ping.range_resolution_m,
        gain_percent=ping.gain_percent,
        gamma_byte=ping.gamma,
    )


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """What changes from ping to ping, where that is noise: power = constant + a log R + b R, dB.

    Noise comes with one level, so this is the law of the receiver's varied gain.
    """

    constant_db: float
    spreading_log: float
    per_metre_db: float

    def level_db(self, range_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mean power after gains, dB of full scale."""
        level: NDArray[np.float64] = (
            self.constant_db + self.spreading_log * np.log10(range_m) + self.per_metre_db * range_m
        )
        return level


def band_centres_m(sonar: SonarSettings) -> NDArray[np.float64]:
    """Middles of the bands of `BAND_ROWS` in which the floor is measured, (bands,)."""
    centres: NDArray[np.float64] = np.arange(0.5, sonar.rows // BAND_ROWS)
    return centres * BAND_ROWS * sonar.range_resolution_m


def noisy_bands(sonar: SonarSettings) -> NDArray[np.bool_]:
    """Which bands lie within `NOISY_M`, (bands,)."""
    range_m = band_centres_m(sonar)
    noisy = np.zeros(range_m.shape, dtype=np.bool_)
    for low_m, high_m in NOISY_M:
        noisy |= (range_m > low_m) & (range_m < high_m)
    return noisy


def noise_level_db(pixels: NDArray[np.uint8], gamma_byte: int) -> NDArray[np.float64]:
    """Mean power of what changes from ping to ping, dB of full scale, (bands,)."""
    noise = noise_power(list(linear_amplitude(pixels, gamma_byte)), BAND_ROWS)
    level: NDArray[np.float64] = 10.0 * np.log10(np.maximum(noise, 1e-15))
    return level


def fitted_floor(recorded: Recorded) -> NoiseFloor:
    """Fit the floor of the bands where noise governs."""
    noisy = noisy_bands(recorded.sonar)
    range_m = band_centres_m(recorded.sonar)[noisy]
    level_db = noise_level_db(recorded.pixels, recorded.sonar.gamma_byte)[noisy]
    terms = np.stack([np.ones_like(range_m), np.log10(range_m), range_m], axis=1)
    found = np.linalg.lstsq(terms, level_db, rcond=None)[0]
    return NoiseFloor(*(float(value) for value in found))


def usual_floor_db(recorded: Recorded) -> NDArray[np.float64]:
    """The floor by the usual law 30 log R + 2 alpha R, its constant fitted alone, (bands,)."""
    sonar = recorded.sonar
    range_m = band_centres_m(sonar)
    absorption = WATER.absorption_db_per_m(sonar.frequency_hz)
    law_db: NDArray[np.float64] = 30.0 * np.log10(range_m) + 2.0 * absorption * range_m
    noisy = noisy_bands(sonar)
    level_db = noise_level_db(recorded.pixels, sonar.gamma_byte)
    return law_db + float(np.mean((level_db - law_db)[noisy]))


def simulate_recording(recorded: Recorded, pings: int = 3, seed: int = 0) -> NDArray[np.uint8]:
    """Simulate pings of the recorded sonar, standing still before a scene of the recorded power.

    Returns:
        Pixels (pings, rows, beams).
    """
    floor = fitted_floor(recorded)
    sonar = dataclasses.replace(recorded.sonar, tvg_spreading_log=floor.spreading_log)
    physics = _physics(sonar)
    gain = row_gain(sonar, physics, floor.per_metre_db / 2.0)
    # The gain's law follows the floor's, so this is one number.
    floor_power = 10.0 ** (floor.level_db(sonar.row_centres_m) / 10.0) / np.square(gain)
    physics.noise_level_db = 10.0 * math.log10(float(np.median(floor_power)))
    former = beam_former(sonar, physics, MARGIN)
    noise = noise_rms(sonar, physics, former.noise_gain)
    scene = _scene_power(recorded, gain, floor_power) / np.float32(former.noise_gain**2)
    still = np.zeros(scene.shape, dtype=np.complex64)
    _core.add_gaussian_power(still, scene, stream_key(seed, "surface"))
    # No mirror is in sight, so all that echoes leaves a tail.
    everything = np.full(sonar.rows, np.inf)
    add_tail(still, _tail(), sonar, limit=everything, key=stream_key(seed, "tail"))
    columns = np.ones(scene.shape[1], dtype=np.float32)
    images = []
    for ping_id in range(pings):
        field = still.copy()
        add_random(field, noise, columns, stream_key(seed, "noise", ping_id))
        shown = amplitude(former.form(field), gain)
        images.append(quantise(shown, physics, sonar.gamma_byte))
    return np.stack(images).astype(np.uint8)


def _tail() -> Reverberation:
    """That of any water, by default."""
    return Reverberation(
        10.0 ** (WATER.reverberation_db / 10.0), WATER.reverberation_decay_db_per_m
    )


def simulate_floor(recorded: Recorded, pings: int = 3, seed: int = 0) -> NDArray[np.uint8]:
    """Simulate pings of the recorded sonar over an even floor, about where the recorded one lies.

    All that is there comes of the scene; nothing is taken from the recording but its settings, and
    the gain that makes the floor as bright.

    Returns:
        Pixels (pings, rows, beams).
    """
    sonar = dataclasses.replace(
        recorded.sonar, gain_percent=FLOOR_GAIN_PERCENT, vertical_width_rad=VERTICAL_WIDTH_RAD
    )
    corners = 20.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    floor = Surface("floor", corners, faces, MATERIALS["gravel"])
    pose = FramePose(np.array([0.0, 0.0, FLOOR_HEIGHT_M]), rotation_of(0.0, FLOOR_PITCH_RAD, 0.0))
    simulator = Simulator(Scene((floor,), water=WATER), sonar, seed)
    images = [simulator.ping(pose, ping_id).image for ping_id in range(pings)]
    return np.stack(images).astype(np.uint8)


def _physics(sonar: SonarSettings) -> Physics:
    return Physics(
        beam_width_rad=sonar.beam_width_rad,
        side_lobe_db=sonar.side_lobe_db,
        sine_bearings=True,
        range_spread=True,
        tvg=True,
        gain=True,
        gamma=True,
        saturation=True,
        quantised=True,
    )


def _scene_power(
    recorded: Recorded, gain: NDArray[np.float32], noise_power: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Mean echo power in each beam before gains, with a margin of columns on both sides."""
    shown = np.mean(np.square(recorded.amplitudes), axis=0)
    smooth = gaussian_filter(shown, SMOOTHING, mode="nearest")
    power = np.maximum(smooth / np.square(gain[:, None]) - noise_power[:, None], 0.0)
    power[recorded.sonar.row_centres_m > FLOOR_END_M] = 0.0
    widened: NDArray[np.float32] = np.pad(power, ((0, 0), (MARGIN, MARGIN)), mode="edge").astype(
        np.float32
    )
    return widened
