import math

import numpy as np
import pytest
from sonar_sim.errors import SceneError
from sonar_sim.geometry.pose import FramePose, rotation_of
from sonar_sim.scanning import PING360, ScanningSonar
from sonar_sim.scene.scene import PointTarget, Scene
from sonar_sim.scene.water import Water

BEARING = math.radians(40.5)
RANGE_M = 4.0
# A target well above the noise, and nothing else: what is left is the pattern.
PATTERN = "spreading,azimuth_pattern,vertical_pattern"
pytestmark = pytest.mark.filterwarnings("ignore::sonar_sim.effects.plan.EffectWarning")


def target_at(bearing_rad: float, range_m: float, elevation_rad: float = 0.0) -> Scene:
    flat_m = range_m * math.cos(elevation_rad)
    place = (
        flat_m * math.cos(bearing_rad),
        -flat_m * math.sin(bearing_rad),
        range_m * math.sin(elevation_rad) - 5.0,
    )
    return Scene(targets=(PointTarget("ball", place, 0.0),))


def still(yaw_rad: float = 0.0) -> FramePose:
    return FramePose(np.array([0.0, 0.0, -5.0]), rotation_of(0.0, 0.0, yaw_rad))


def level_db(scene: Scene, bearing_rad: float) -> float:
    sonar = ScanningSonar(scene, range_m=8.0, effects=PATTERN, samples=400)
    return 20.0 * math.log10(sonar.line(still(), bearing_rad).amplitude.max())


def test_a_sector_finds_a_target_at_its_bearing_and_range() -> None:
    sonar = ScanningSonar(target_at(BEARING, RANGE_M), range_m=8.0, samples=400, effects=PATTERN)
    lines = list(sonar.scan(lambda _: still(), (0.0, math.pi / 2)))
    assert len(lines) == 101
    levels = np.array([line.amplitude for line in lines])
    step, row = np.unravel_index(int(levels.argmax()), levels.shape)
    assert lines[step].bearing_rad == pytest.approx(BEARING, abs=PING360.step_rad / 2 + 1e-9)
    assert sonar.row_centres_m[row] == pytest.approx(RANGE_M, abs=0.02)
    assert lines[1].time_s == pytest.approx(sonar.step_s)


def test_the_transducer_narrows_the_echo_twice() -> None:
    """3 dB one way at half its width is 6 dB in the echo, in azimuth and in elevation."""
    ahead = level_db(target_at(0.0, RANGE_M), 0.0)
    aside = level_db(target_at(0.0, RANGE_M), math.radians(1.0))
    above = level_db(target_at(0.0, RANGE_M, math.radians(12.5)), 0.0)
    assert ahead - aside == pytest.approx(6.0, abs=0.6)
    assert ahead - above == pytest.approx(6.0, abs=0.3)


def test_a_turning_vehicle_is_seen_line_by_line() -> None:
    """The housing turns to port at half the head's rate: the head takes twice as many steps."""
    sonar = ScanningSonar(target_at(BEARING, RANGE_M), range_m=8.0, samples=100, effects=PATTERN)
    rate = 0.5 * PING360.step_rad / sonar.step_s
    lines = list(sonar.scan(lambda time_s: still(rate * time_s), (0.0, math.pi / 2)))
    best = max(lines, key=lambda line: float(line.amplitude.max()))
    assert best.bearing_rad == pytest.approx(2.0 * BEARING, abs=2 * PING360.step_rad)


def test_a_target_astern_of_the_head_is_silent() -> None:
    sonar = ScanningSonar(target_at(BEARING, RANGE_M), range_m=8.0, samples=400, effects=PATTERN)
    ahead, astern = (
        float(sonar.line(still(), bearing).amplitude.max())
        for bearing in (BEARING, BEARING - math.pi)
    )
    assert ahead > 0.0
    assert astern == 0.0


def test_a_whole_turn_has_each_direction_once() -> None:
    sonar = ScanningSonar(Scene(), range_m=2.0, samples=10, effects="none")
    bearings = [line.bearing_rad for line in sonar.scan(lambda _: still(), steps=4)]
    assert np.diff(bearings) == pytest.approx(4 * PING360.step_rad)
    assert len(bearings) == 100


def test_a_turn_takes_as_long_as_the_makers() -> None:
    scene = Scene(water=Water(profile=((0.0, 1500.0),)))
    for range_m, seconds in ((2.0, 9.0), (50.0, 35.0)):
        turn_s = 400 * ScanningSonar(scene, range_m=range_m).step_s
        assert turn_s == pytest.approx(seconds, rel=0.02)


def test_what_the_head_cannot_is_refused() -> None:
    with pytest.raises(SceneError, match=r"0\.75 to 50 m, which is what a Ping360 hears"):
        ScanningSonar(Scene(), range_m=60.0)
    sonar = ScanningSonar(Scene())
    for sector in ((0.0, 0.0), (0.0, 7.0)):
        with pytest.raises(SceneError, match="no sector"):
            next(sonar.scan(lambda _: still(), sector))
    with pytest.raises(SceneError, match="401 steps of a Ping360 are more than a turn"):
        next(sonar.scan(lambda _: still(), steps=401))
