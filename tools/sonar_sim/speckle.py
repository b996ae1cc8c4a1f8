"""Speckle: the complex field behind a mean power, seen through the beams.

The scatterers of a cell add with random phases, so each cell of surface holds a complex Gaussian
number. Cells of the echo grid are disjoint pieces of surface and therefore independent; what
correlates neighbouring beams and rows is the receiver's response, which is applied to the field.
"""

import struct
from collections.abc import Callable
from hashlib import blake2b

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sonar_sim.casting import MARGIN_BEAMS
from sonar_sim.pattern import azimuth_amplitude
from sonar_sim.poses import Pose
from sonar_sim.sonar import SonarSettings

KERNEL_REACH = 256
"""Beam pitches; out there the side lobes have fallen by another 30 dB."""
ROW_LEAK = 0.24
"""Field that leaks into the neighbouring row; gives the measured power correlation of 0.19."""


def pose_generator(seed: int, pose: Pose) -> np.random.Generator:
    """Random numbers that belong to a pose: standing still repeats the speckle.

    Speckle renews when the sonar moves sideways by half its array (5 cm). Here it renews with any
    step above 1 mm or 0.1 mrad; what correlation remains between is not modelled.
    """
    steps = np.concatenate([pose.position_m * 1e3, pose.rotation.ravel() * 1e4])
    packed = struct.pack(f"<{len(steps)}q", *(int(v) for v in np.rint(steps)))
    digest = blake2b(packed, digest_size=16).digest()
    words = [seed, *struct.unpack("<4I", digest)]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))


def complex_gaussian(generator: np.random.Generator, count: int) -> NDArray[np.complex64]:
    """Circular complex Gaussian numbers of mean power 1, (count,)."""
    parts = generator.standard_normal(2 * count, dtype=np.float32)
    parts *= np.float32(np.sqrt(0.5))
    return parts.view(np.complex64)


def scattered_field(
    power: NDArray[np.float64], generator: np.random.Generator
) -> NDArray[np.complex64]:
    """Draw a field whose mean power is given, cell by cell."""
    field = np.zeros(power.shape, dtype=np.complex64)
    echoing = power > 0.0
    amplitude = np.sqrt(power[echoing]).astype(np.float32)
    field[echoing] = amplitude * complex_gaussian(generator, len(amplitude))
    return field


def beam_former(
    sonar: SonarSettings,
) -> Callable[[NDArray[np.complex64]], NDArray[np.complex64]]:
    """Make the function that turns a field (rows, columns) into beams (rows, beams).

    Columns and beams share one pitch in the sine, so the azimuth response is one convolution.
    """
    columns = sonar.beams + 2 * MARGIN_BEAMS
    pattern = azimuth_amplitude(sonar.beam_width_rad, sonar.side_lobe_db)
    offsets = np.arange(-KERNEL_REACH, KERNEL_REACH + 1, dtype=np.float64)
    taps = pattern(offsets * sonar.sine_pitch)
    length = scipy.fft.next_fast_len(columns + 2 * KERNEL_REACH)
    spectrum = scipy.fft.fft(taps.astype(np.complex64), length)
    start = KERNEL_REACH + MARGIN_BEAMS

    def form(field: NDArray[np.complex64]) -> NDArray[np.complex64]:
        transformed = scipy.fft.fft(_range_response(field), length, axis=1)
        transformed *= spectrum
        formed = scipy.fft.ifft(transformed, axis=1, overwrite_x=True)
        beams: NDArray[np.complex64] = formed[:, start : start + sonar.beams]
        return beams

    return form


def _range_response(field: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Spread each row a little over its neighbours, power kept; nothing wraps around."""
    spread = field.copy()
    spread[1:] += np.float32(ROW_LEAK) * field[:-1]
    spread[:-1] += np.float32(ROW_LEAK) * field[1:]
    spread *= np.float32(1.0 / np.sqrt(1.0 + 2.0 * ROW_LEAK**2))
    return spread
