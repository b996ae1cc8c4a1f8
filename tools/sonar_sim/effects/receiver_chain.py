"""Effects of the receiver: noise, gains, saturation, gamma, quantisation."""

import math

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.coarse_picture import Gains, change_db
from sonar_sim.effects.effect import Cost, Effect, EffectParameter, RuleResult, by_level
from sonar_sim.effects.image_difference import (
    Tolerance,
    expected_clipped,
    gamma_of,
    level_change_db,
    quantiser_change_db,
)
from sonar_sim.effects.multipath import ghost_picture
from sonar_sim.effects.preview import PingPreview
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.gain import (
    FULL_SCALE_DB,
    GAIN_DB_PER_PERCENT,
    RING_DOWN_DB_PER_M,
    gain_db,
    noise_level_db,
    ring_down_power_db,
)


def decide_noise(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the noise, after the gains, shows anywhere."""
    # Ghosts may fill what were dark without them.
    picture = view.picture + ghost_picture(view)
    silence = np.maximum(picture - view.noise_power, 0.0)
    floor = view.gains.amplitude(np.full_like(view.picture, view.noise_power)).max()
    reason = f"after gains the noise reaches {20.0 * math.log10(floor):.0f} dB of full scale"
    before, after = (view.gains.amplitude(power) for power in (picture, silence))
    return by_level(change_db(before, after, view.sonar, tolerance), tolerance, reason)


def configure_noise(physics: Physics, view: PingPreview) -> None:
    """Give the level in a cell."""
    physics.noise_level_db = noise_level_db(view.sonar, view.scene.water)


NOISE = Effect(
    name="noise",
    does="fills what is silent, the more so the farther out; new in every ping",
    needs="bandwidth, array gain, the receiver's own noise",
    formula="-15 + 20 log f_kHz dB re 1 µPa²/Hz in band, less array gain, plus self noise",
    source="Mellen 1952",
    rule="the picture without noise differs by more than the tolerance",
    cost=Cost.CELL,
    parameters=(
        EffectParameter("sonar.array_gain_db", "dB", "against ambient noise"),
        EffectParameter(
            "sonar.noise_excess_db", "dB", "of the receiver's own noise over ambient noise"
        ),
    ),
    decide=decide_noise,
    configure=configure_noise,
)


def decide_ring_down(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the first row's ring shows."""
    sonar = view.sonar
    if sonar.ring_down_db is None:
        return RuleResult(on=False, reason="the sonar has none", predicted_db=0.0)
    raw_db = ring_down_power_db(sonar, sonar.ring_down_db, view.water_db_per_m)[:1]
    gain = gain_db(sonar, view.water_db_per_m)[:1] - FULL_SCALE_DB
    noise = 10.0 * math.log10(max(view.noise_power, 1e-30))
    shown = 10.0 ** ((np.logaddexp(raw_db * LOG_DB, noise * LOG_DB) / LOG_DB + gain) / 20.0)
    silent = 10.0 ** ((noise + gain) / 20.0)
    first = [np.full((1, 1), float(level[0])) for level in (shown, silent)]
    predicted_db = level_change_db(first[0], first[1], sonar, 0.0)
    reason = f"the first row rings at {20.0 * math.log10(max(shown[0], 1e-9)):.0f} dB of full scale"
    return by_level(predicted_db, tolerance, reason)


def configure_ring_down(physics: Physics, view: PingPreview) -> None:
    """Give the level."""
    physics.ring_down_db = view.sonar.ring_down_db


LOG_DB = math.log(10.0) / 10.0
RING_DOWN = Effect(
    name="ring_down",
    does="lights the first rows, alike in every ping",
    needs="the sonar's ring",
    formula=f"level of full scale at 50 % of gain, falling by {RING_DOWN_DB_PER_M:.0f} dB/m",
    source="public Oculus recording: 25 dB below its floor's echo",
    rule="the first row differs by more than the tolerance",
    cost=Cost.ROW,
    parameters=(EffectParameter("sonar.ring_down_db", "dB", "of full scale at 50 % of gain"),),
    decide=decide_ring_down,
    configure=configure_ring_down,
    anywhere=True,
)


def decide_tvg(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the picture without it differs."""
    gains = view.gains
    flat = Gains(np.zeros_like(gains.tvg_db), gains.operator_db, gains.full_scale_db)
    predicted_db = change_db(view.amplitude, flat.amplitude(view.picture), view.sonar, tolerance)
    reason = f"{gains.tvg_db[0]:.0f} to {gains.tvg_db[-1]:.0f} dB over the rows"
    return by_level(predicted_db, tolerance, reason)


def configure_tvg(physics: Physics, view: PingPreview) -> None:
    """Switch the receiver's gain on."""
    del view
    physics.tvg = True


TVG = Effect(
    name="tvg",
    does="levels near and far",
    needs="the receiver's law",
    formula="a log R + 2 alpha R dB",
    source="public Oculus recording: 30 log R + 2 alpha R",
    rule="always: it costs next to nothing",
    cost=Cost.ROW,
    parameters=(EffectParameter("sonar.tvg_spreading_log", "dB a decade", "a"),),
    decide=decide_tvg,
    configure=configure_tvg,
)


def decide_gain(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the picture without it differs."""
    none = Gains(view.gains.tvg_db, 0.0, view.gains.full_scale_db)
    predicted_db = change_db(view.amplitude, none.amplitude(view.picture), view.sonar, tolerance)
    reason = f"{view.sonar.gain_percent:.0f} % are {view.gains.operator_db:.0f} dB"
    return by_level(predicted_db, tolerance, reason)


def configure_gain(physics: Physics, view: PingPreview) -> None:
    """Switch the operator's gain on."""
    del view
    physics.gain = True


GAIN = Effect(
    name="gain",
    does="makes the whole picture brighter",
    needs="the operator's setting",
    formula=f"{GAIN_DB_PER_PERCENT} dB a percent",
    source="a choice: the device's own law is not published",
    rule="wherever it is not 0 dB: it costs next to nothing",
    cost=Cost.ROW,
    parameters=(EffectParameter("sonar.gain_percent", "%", "the operator's gain"),),
    decide=decide_gain,
    configure=configure_gain,
)


UNCLIPPED = 0.5
"""Amplitude of full scale, rms, below which clipping takes less than 0.05 dB."""
NEIGHBOUR_ROW_WEIGHT = 0.24
"""Part of a row's amplitude in each neighbour (see `range_spread`)."""


def decide_saturation(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if speckle's peaks are clipped so that what is expected of a pixel falls.

    A flash is thin, and brighter than its mean over a coarse row: rows are those of the sonar.
    """
    brighter = 10.0 ** (tolerance.brighter_db / 20.0)
    loudest = float(view.amplitude.max(initial=0.0)) * brighter
    loudest_db = 20.0 * math.log10(max(loudest, 1e-6))
    reason = f"the loudest echo is at {loudest_db:+.0f} dB of full scale"
    if loudest * math.sqrt(view.fine.grid.rows / view.grid.rows) <= UNCLIPPED:
        return by_level(0.0, tolerance, reason)
    sonar = view.sonar
    shown = view.fine.gains.amplitude(_spread(view.fine.picture)) * brighter
    cells = (
        tolerance.cells * shown.shape[0] / sonar.rows,
        tolerance.cells * shown.shape[1] / sonar.beams,
    )
    limited = expected_clipped(shown)
    # To clip costs next to nothing.
    predicted_db = level_change_db(limited, shown, sonar, 0.0, cells)
    return by_level(predicted_db, tolerance, reason)


def _spread(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """With what a loud row leaks into its neighbours."""
    spread = picture.copy()
    spread[1:] += NEIGHBOUR_ROW_WEIGHT**2 * picture[:-1]
    spread[:-1] += NEIGHBOUR_ROW_WEIGHT**2 * picture[1:]
    return spread


def configure_saturation(physics: Physics, view: PingPreview) -> None:
    """Clip."""
    del view
    physics.saturation = True


SATURATION = Effect(
    name="saturation",
    does="cuts bright echoes off at full scale",
    needs="gains",
    formula="min(amplitude, full scale); of speckle of rms m expected m erf(1 / m)",
    source="the converter's end",
    rule="always: it costs next to nothing",
    cost=Cost.CELL,
    parameters=(EffectParameter("sonar.gain_percent", "%", "the operator's gain"),),
    decide=decide_saturation,
    configure=configure_saturation,
    anywhere=True,
)


def decide_gamma(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if linear pixels, read by the sonar's curve, show other levels."""
    gamma = gamma_of(view.sonar)
    shown = np.minimum(view.amplitude, 1.0)
    predicted_db = change_db(shown, shown ** (1.0 / gamma), view.sonar, tolerance)
    return by_level(predicted_db, tolerance, f"pixels go with the amplitude's power {gamma:.2f}")


def configure_gamma(physics: Physics, view: PingPreview) -> None:
    """Obey the byte."""
    del view
    physics.gamma = True


GAMMA = Effect(
    name="gamma",
    does="brings a wider range of levels into the pixels",
    needs="the gamma byte",
    formula="pixel = full scale * amplitude^(byte / 255); 0 and 255 are linear",
    source="public Oculus recording: byte 127 shows the amplitude's square root",
    rule="linear pixels differ by more than the tolerance",
    cost=Cost.CELL,
    parameters=(EffectParameter("sonar.gamma_byte", "1", "0 to 255"),),
    decide=decide_gamma,
    configure=configure_gamma,
)


def decide_quantisation(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On: an Oculus sends integers. The result holds the change by rounding."""
    shown = np.minimum(view.amplitude, 1.0)
    predicted_db = quantiser_change_db(shown, view.sonar, tolerance.share)
    return RuleResult(on=True, reason=f"{view.sonar.bits} bits a sample", predicted_db=predicted_db)


def configure_quantisation(physics: Physics, view: PingPreview) -> None:
    """Round to integers."""
    del view
    physics.quantised = True


QUANTISATION = Effect(
    name="quantisation",
    does="rounds, which shows in what is dark",
    needs="width of a sample",
    formula="round(full scale * amplitude^gamma)",
    source="Oculus data format: 8, 16 or 32 bits",
    rule="always, since an Oculus sends integers",
    cost=Cost.CELL,
    parameters=(EffectParameter("sonar.bits", "bit", "of a sample"),),
    decide=decide_quantisation,
    configure=configure_quantisation,
)
