"""Interference: another sonar's sound comes straight, without an echo's losses."""

import math

import numpy as np

from sonar_sim.effects.effect import Cost, Effect, EffectParameter, RuleResult, by_level
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.preview import PingPreview
from sonar_sim.propagation.beam_pattern import azimuth_amplitude, vertical_two_way_power
from sonar_sim.propagation.physics import InterferencePulse, Physics
from sonar_sim.scene.scene import Emitter


def arrivals(view: PingPreview) -> tuple[InterferencePulse, ...]:
    """What is heard of all emitters in this ping."""
    heard = [arrival for emitter in view.scene.emitters for arrival in _arrivals_of(emitter, view)]
    return tuple(sorted(heard, key=lambda a: (a.time_s, a.sine)))


def _arrivals_of(emitter: Emitter, view: PingPreview) -> list[InterferencePulse]:
    band_hz = (emitter.bandwidth_hz + view.sonar.bandwidth_hz(view.speed_of_sound_mps)) / 2.0
    if abs(emitter.frequency_hz - view.sonar.frequency_hz) > band_hz:
        return []
    away_m = np.asarray(emitter.position_m, dtype=np.float64) - view.own_pose.position_m
    range_m = max(float(np.linalg.norm(away_m)), 1.0)
    x, y, z = (away_m @ view.own_pose.rotation) / range_m
    if x <= 0.0:
        return []
    one_way = math.sqrt(float(vertical_two_way_power(np.array(z), view.sonar.vertical_width_rad)))
    loss_db = 20.0 * math.log10(range_m) + (view.water_db_per_m + view.sediment_db_per_m) * range_m
    level_db = emitter.source_level_db - loss_db + 10.0 * math.log10(max(one_way, 1e-12))
    # The first transmission of the emitter that is still heard at or after ours.
    since_s = (
        view.own_time_s - range_m / view.speed_of_sound_mps - emitter.offset_s - emitter.pulse_s
    )
    number = max(math.ceil(since_s / emitter.period_s), 0)
    heard: list[InterferencePulse] = []
    end_s = 2.0 * view.sonar.range_m / view.speed_of_sound_mps
    while True:
        sent_s = emitter.offset_s + number * emitter.period_s
        time_s = sent_s + range_m / view.speed_of_sound_mps - view.own_time_s
        if time_s > end_s:
            return heard
        heard.append(InterferencePulse(time_s, emitter.pulse_s, -float(y), level_db))
        number += 1


def decide(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if an emitter in band is heard in this ping above what is there."""
    if not view.scene.emitters:
        return RuleResult(on=False, reason="nothing else sounds", predicted_db=0.0)
    heard = arrivals(view)
    if not heard:
        return RuleResult(
            on=False, reason="no other sonar in band is heard in this ping", predicted_db=0.0
        )
    added = sum((_picture(arrival, view) for arrival in heard), np.zeros_like(view.picture))
    loudest = max(arrival.level_db for arrival in heard)
    reason = f"{len(heard)} arrivals, the loudest of {loudest:.0f} dB re 1 µPa"
    return by_level(view.change_db(view.picture + added, tolerance), tolerance, reason)


def _picture(
    arrival: InterferencePulse, view: PingPreview
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    start_m = arrival.time_s * view.speed_of_sound_mps / 2.0
    end_m = start_m + arrival.duration_s * view.speed_of_sound_mps / 2.0
    half = view.grid.row_m / 2.0
    rows = (view.grid.range_m + half > start_m) & (view.grid.range_m - half < end_m)
    pattern = azimuth_amplitude(view.sonar.beam_width_rad, view.sonar.side_lobe_db)
    beams = np.square(pattern(view.grid.sine - arrival.sine))
    picture: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
    picture = 10.0 ** (arrival.level_db / 10.0) * rows[:, None] * beams
    return picture


def configure(physics: Physics, view: PingPreview) -> None:
    """List the arrivals."""
    physics.arrivals = arrivals(view)


INTERFERENCE = Effect(
    name="interference",
    does="draws spokes and drifting arcs of other sonars",
    needs="emitters in band",
    formula="SL' - 20 log R' - alpha R' and patterns, at (t' + R'/c - t) modulo the period",
    source="one-way sonar equation",
    rule="an arrival in this ping changes the picture by more than the tolerance",
    cost=Cost.ROW,
    parameters=(
        EffectParameter("emitter.source_level_db", "dB re 1 µPa", "at 1 m"),
        EffectParameter("emitter.frequency_hz", "Hz", "with its bandwidth"),
        EffectParameter(
            "emitter.period_s", "s", "between transmissions, with their length and offset"
        ),
    ),
    decide=decide,
    configure=configure,
)
