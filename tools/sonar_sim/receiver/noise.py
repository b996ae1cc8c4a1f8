"""Contributions other than surface echoes: noise, reverberation, other sonars, crosstalk.

Cells are a field, complex64 (rows, columns), or mean powers, float32 of that shape; columns lie at
the beams' mean pitch in the sine of the bearing. Levels are dB re 1 µPa of a cell's amplitude.
"""

import math
from functools import lru_cache
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.geometry.matmul import Real
from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import InterferencePulse, Physics, Reverberation
from sonar_sim.scene.sonar import SonarSettings

Cells = NDArray[np.complex64] | NDArray[np.float32]

TAIL_SPREAD_SINE = 0.06
"""Standard deviation over which a tail spreads in the sine of the bearing."""
TAIL_REACH = 4.0
"""Standard deviations beyond which nothing of a tail is heard: all but 6e-5 of it is within."""
TAIL_STEP_SINE = 0.03
"""Width of the blocks of columns whose mean power is taken together."""
TURN_STEPS = 400
"""Steps of the rotation matrix's entries in which the tail's speckle is the same."""
INTEGRATION_STEPS = 512
"""Steps of the integral over the vertical pattern."""


def stream_key(*words: int | str) -> int:
    """A 64-bit key of a random stream, such as `stream_key(seed, "noise", ping_id)`."""
    digest = blake2b(repr(words).encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little")


def column_sines(columns: int, sonar: SonarSettings) -> NDArray[np.float64]:
    """Sine of the bearing at each column's middle, (columns,)."""
    sines: NDArray[np.float64] = np.arange(columns, dtype=np.float64) - (columns - 1) / 2.0
    sines *= sonar.sine_pitch
    return sines


def add_random(
    cells: Cells,
    row_rms: NDArray[np.float32],
    column_rms: NDArray[np.float32],
    key: int,
    threads: int = 2,
    *,
    extra_power: NDArray[np.float32] | None = None,
) -> None:
    """Add an independent complex Gaussian number, or its mean power, to every cell, in place.

    Args:
        cells: field or mean power.
        row_rms: rms amplitude, (rows,).
        column_rms: factor to it, (columns,).
        key: of the numbers; mean powers need none.
        threads: that share the work.
        extra_power: added to the mean power, (rows, columns) or (rows, 1).
    """
    if np.iscomplexobj(cells):
        field: NDArray[np.complex64] = cells  # type: ignore[assignment]
        _core.add_gaussian(field, row_rms, column_rms, key, threads, extra_power)
    else:
        cells += np.outer(np.square(row_rms), np.square(column_rms))
        if extra_power is not None:
            cells += extra_power


def noise_rms(sonar: SonarSettings, physics: Physics, noise_gain: float) -> NDArray[np.float32]:
    """Amplitude of the noise to put into each cell, (rows,).

    Args:
        sonar: for its rows.
        physics: its noise level holds in the beams, per cell, before gains.
        noise_gain: of the beam former, `BeamFormer.noise_gain`.
    """
    level_db = -math.inf if physics.noise_level_db is None else physics.noise_level_db
    rms = 10.0 ** (level_db / 20.0) / noise_gain
    return np.full(sonar.rows, rms, dtype=np.float32)


def volume_rms(
    sonar: SonarSettings, physics: Physics, columns: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Amplitude of the water's own back scattering, (rows,) and a factor (columns,).

    SL - 40 log R - 2 alpha R + Sv + 10 log(dR Psi R²), dR the row and Psi the solid angle of a
    column weighted by the vertical pattern twice (Urick 1983). All elevations count as open.
    """
    strength_db = -math.inf if physics.volume_strength_db is None else physics.volume_strength_db
    range_m = sonar.row_centres_m
    level_db = sonar.source_level_db + strength_db - 2.0 * physics.attenuation_db_per_m * range_m
    power = 10.0 ** (level_db / 10.0) * sonar.range_resolution_m * np.square(range_m)
    if physics.spreading:
        power = power / range_m**4
    solid_angle = _solid_angle_sr(sonar, physics, columns)
    return np.sqrt(power).astype(np.float32), np.sqrt(solid_angle).astype(np.float32)


def _solid_angle_sr(sonar: SonarSettings, physics: Physics, columns: int) -> NDArray[np.float64]:
    """Of each column, weighted by the two-way vertical pattern: ds times the integral of dw / x.

    A direction of sines s along the array and w up is x = sqrt(1 - s² - w²) ahead.
    """
    s = column_sines(columns, sonar)[:, None]
    # With w = sqrt(1 - s²) sin(turn) the integrand has no pole at the cone's top.
    turn = (np.arange(INTEGRATION_STEPS) + 0.5) * (math.pi / INTEGRATION_STEPS) - math.pi / 2.0
    w = np.sqrt(np.maximum(1.0 - s**2, 0.0)) * np.sin(turn)
    heard = np.ones_like(w)
    if physics.vertical_width_rad is not None:
        heard = vertical_two_way_power(w, physics.vertical_width_rad)
    total: NDArray[np.float64] = (
        heard.sum(axis=1) * (math.pi / INTEGRATION_STEPS) * sonar.sine_pitch
    )
    return total


def tail_power(
    power: NDArray[Real],
    sines: NDArray[np.float64],
    row_m: float,
    tail: Reverberation,
    heard: NDArray[np.float64] | None = None,
    *,
    threads: int = 1,
) -> NDArray[Real]:
    """Mean power of the reverberant tail behind echoes, (rows, M).

    The last scatterers of sound on its detours lie around the first: the tail spreads over
    bearings, and only follows what it is the tail of.

    Args:
        power: mean power of the echoes in a row of the sonar, (rows, N).
        sines: of the bearings, (N,).
        row_m: spacing of these rows, which may be coarser than the sonar's.
        tail: its energy and decay.
        heard: sines of the bearings of the tail, (M,); without them those of the echoes.
        threads: that share the rows.
    """
    kept = 10.0 ** (-tail.decay_db_per_m * row_m / 10.0)
    filled = _core.decaying_sum(power, kept * tail.energy_per_m * row_m, kept)
    spread = _tail_spread(sines.tobytes(), (sines if heard is None else heard).tobytes())
    return _core.spread_columns(filled, spread.astype(power.dtype), threads)


@lru_cache(maxsize=8)
def _tail_spread(sines: bytes, heard: bytes) -> NDArray[np.float64]:
    """Part of the tail at the first bearings (float64, as bytes) that is heard at the second."""
    away = (np.frombuffer(sines)[:, None] - np.frombuffer(heard)) / TAIL_SPREAD_SINE
    spread = np.where(np.abs(away) < TAIL_REACH, np.exp(-0.5 * np.square(away)), 0.0)
    spread /= spread.sum(axis=0)
    spread.setflags(write=False)
    return spread


def diffuse_limit_m2(sonar: SonarSettings, mu: float) -> NDArray[np.float64]:
    """Cross section of a cell that a plane of Lambert's coefficient mu fills head on, (rows,).

    The first row of a wall is 2 sqrt(2 R dR) high and R ds wide; twice that leaves room for
    speckle. What is louder is a mirror's flash, whose sound is not scattered about.
    """
    range_m, row_m = sonar.row_centres_m, sonar.range_resolution_m
    area_m2 = 2.0 * range_m * sonar.sine_pitch * np.sqrt(2.0 * range_m * row_m)
    limit: NDArray[np.float64] = 2.0 * mu * area_m2
    return limit


def add_tail(
    cells: Cells,
    tail: Reverberation,
    sonar: SonarSettings,
    *,
    limit: NDArray[np.float64],
    key: int,
    shared: float = 1.0,
    threads: int = 2,
) -> None:
    """Add the tail behind all echoes in the cells, in place.

    Args:
        cells: field or mean power of the echoes.
        tail: its energy and decay.
        sonar: for rows and columns.
        limit: of the mean power that leaves a tail, (rows,).
        key: of the numbers; mean powers need none.
        shared: mean power of an echo's cells over its own, see `cells_share`.
        threads: that share the work.
    """
    columns = cells.shape[1]
    width = max(1, int(TAIL_STEP_SINE / sonar.sine_pitch))
    blocks = _core.block_powers(cells, width, threads)
    blocks /= np.float32(shared)
    # Some weights of whole columns are negative: beside a flash so is a block of mean powers.
    np.clip(blocks, 0.0, limit[:, None].astype(np.float32), out=blocks)
    ends = np.minimum(np.arange(blocks.shape[1] + 1) * width, columns)
    sines = column_sines(columns, sonar)
    middles = 0.5 * (sines[ends[:-1]] + sines[ends[1:] - 1])
    # The tail is smooth: half a block is fine enough to be linear between.
    step = max(1.0, width / 2.0)
    heard = sines if step == 1.0 else sines[0] + np.arange(0.0, columns, step) * sonar.sine_pitch
    power = tail_power(blocks, middles, sonar.range_resolution_m, tail, heard, threads=threads)
    if np.iscomplexobj(cells):
        _core.add_gaussian_power(cells, power, key, threads, step=step)  # type: ignore[arg-type]
    else:
        between = [np.interp(sines, heard, row) for row in power]
        cells += np.asarray(between, dtype=np.float32)


def pose_key(seed: int, pose: FramePose, wavelength_m: float) -> int:
    """Key that is constant while the sonar stands still, and changes after an eighth of a wave."""
    place = np.rint(pose.position_m * (8.0 / wavelength_m)).astype(np.int64)
    turned = np.rint(pose.rotation * TURN_STEPS).astype(np.int64)
    return stream_key(seed, "tail", *place.tolist(), *turned.ravel().tolist())


def add_arrival(
    cells: Cells,
    arrival: InterferencePulse,
    sonar: SonarSettings,
    speed_of_sound_mps: float,
    key: int,
) -> None:
    """Add the direct sound of another sonar, in place.

    Its waveform is not ours: behind our matched filter each row holds it with a phase of its own.
    What arrives beyond the last row or outside the columns is not heard.

    Args:
        cells: field or mean power.
        arrival: when, from where, how loud.
        sonar: for rows and columns.
        speed_of_sound_mps: that turns time into rows.
        key: of the phases.
    """
    rows, columns = cells.shape
    row_s = 2.0 * sonar.range_resolution_m / speed_of_sound_mps
    # Share of each row's time in which the pulse arrives.
    edges = np.clip((np.arange(rows + 1) * row_s - arrival.time_s) / arrival.duration_s, 0.0, 1.0)
    share = np.diff(edges) * arrival.duration_s / row_s
    place = arrival.sine / sonar.sine_pitch + (columns - 1) / 2.0
    column = math.floor(place)
    amplitude = np.sqrt(share) * 10.0 ** (arrival.level_db / 20.0)
    unit = _core.complex_gaussian(key, rows)
    wave = amplitude * unit / np.maximum(np.abs(unit), np.float32(1e-6))
    for at, weight in ((column, 1.0 - place + column), (column + 1, place - column)):
        if 0 <= at < columns:
            # Between two columns the beams hear both in phase, so the power shares out like the
            # amplitude.
            heard = weight * (wave if np.iscomplexobj(cells) else np.square(amplitude))
            cells[:, at] += heard.astype(cells.dtype)


def add_crosstalk(beams: Cells, crosstalk_db: float, key: int) -> None:
    """Add to every beam a part of its row's mean power, of one phase a row, in place.

    Args:
        beams: (rows, beams), field or mean power.
        crosstalk_db: the part, negative.
        key: of the phases; of the seed alone, for the wiring does not change between pings.
    """
    factor = 10.0 ** (crosstalk_db / 10.0)
    if np.iscomplexobj(beams):
        parts = beams.view(np.float32)
        power = 2.0 * np.mean(np.square(parts), axis=1)
        unit = _core.complex_gaussian(key, len(beams))
        turn = unit / np.maximum(np.abs(unit), np.float32(1e-6))
        beams += (np.sqrt(factor * power) * turn).astype(np.complex64)[:, None]
    else:
        beams += np.float32(factor) * beams.mean(axis=1, keepdims=True)
