"""The statistics of V6 to V9 hold for a floor's own scatterers, through the whole engine."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim.engine import NODES_PER_BEAM, EnginePing, PingEngine
from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.material import Material
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.simulator import SPARSE_NODES_PER_BEAM
from sonar_sim.validation.statistics import correlation, speckle

SONAR = SonarSettings(demanded_range_m=10.0)
PHYSICS = Physics(
    spreading=True,
    lambert=True,
    shadows=True,
    vertical_width_rad=SONAR.vertical_width_rad,
    beam_width_rad=SONAR.beam_width_rad,
    side_lobe_db=SONAR.side_lobe_db,
    range_spread=True,
    speckle=True,
    sine_bearings=True,
    tvg=True,
    gain=True,
)
FROM_ROW = int(6.0 / SONAR.range_resolution_m)
"""Beyond the foot of the main lobe, where the mean level is smooth."""
POSES = 5


def at(ahead_m: float) -> FramePose:
    return FramePose(np.array([ahead_m, 0.0, 0.0]), np.eye(3))


def alike(one: EnginePing, other: EnginePing) -> float:
    """Correlation of amplitudes; the level's course over range would count, and is taken out."""
    heard = (ping.amplitude[FROM_ROW:, 60:-60] for ping in (one, other))
    first, second = (part / part.mean(axis=1, keepdims=True) for part in heard)
    return correlation(first, second)


@pytest.fixture(scope="module")
def engine() -> PingEngine:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 200.0
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    floor = Surface("floor", corners - [0.0, 0.0, 2.0], faces, Material("sand", -27.0))
    return PingEngine(Scene((floor,)), SONAR, seed=1)


@pytest.fixture(scope="module")
def relative(engine: PingEngine) -> NDArray[np.float64]:
    """Amplitude over the root of the mean power, from poses far apart, (poses, rows, beams)."""
    mean = engine.ping(at(0.0), dataclasses.replace(PHYSICS, speckle=False)).amplitude
    pings = [engine.ping(at(3.7 * pose), PHYSICS).amplitude for pose in range(POSES)]
    heard = np.stack(pings)[:, FROM_ROW:, 60:-60].astype(np.float64)
    return heard / mean[FROM_ROW:, 60:-60]


def test_mean_power_is_that_of_the_picture_without_speckle(
    relative: NDArray[np.float64],
) -> None:
    assert 10.0 * np.log10(np.mean(np.square(relative))) == pytest.approx(0.0, abs=0.15)


def test_amplitude_is_rayleighs(relative: NDArray[np.float64]) -> None:
    found = speckle(relative[:, ::3, ::10])
    assert found.cv == pytest.approx(0.5227, abs=0.01)
    assert found.rayleigh_distance < 0.01
    assert found.power_cv == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize("beams", [256, 512])
def test_amplitude_is_rayleighs_however_many_beams(beams: int) -> None:
    corners = np.array([[-1, -1, -0.01], [1, -1, -0.01], [1, 1, -0.01], [-1, 1, -0.01]]) * 200.0
    floor = Surface("floor", corners, np.array([[0, 1, 2], [0, 2, 3]]), Material("sand", -27.0))
    engine = PingEngine(Scene((floor,)), dataclasses.replace(SONAR, beams=beams), seed=1)
    mean = engine.ping(at(0.0), dataclasses.replace(PHYSICS, speckle=False)).amplitude
    edge = beams // 8
    heard = np.stack([engine.ping(at(3.7 * pose), PHYSICS).amplitude for pose in range(POSES)])
    found = heard[:, FROM_ROW:, edge:-edge] / mean[FROM_ROW:, edge:-edge].astype(np.float64)
    assert found.std() / found.mean() == pytest.approx(0.5227, abs=0.005)
    assert speckle(found[:, ::3, :: beams // 50]).rayleigh_distance < 0.01


@pytest.mark.parametrize(
    ("nodes_per_beam", "off"), [(NODES_PER_BEAM, 0.002), (SPARSE_NODES_PER_BEAM, 0.004)]
)
def test_few_scatterers_are_enough(
    engine: PingEngine, *, nodes_per_beam: float, off: float
) -> None:
    """As their places are even: over whole cells of the lattice they would vary by 0.002 more."""
    mean = engine.ping(at(0.0), dataclasses.replace(PHYSICS, speckle=False)).amplitude
    pings = [
        PingEngine(engine.scene, SONAR, seed, nodes_per_beam=nodes_per_beam).ping(
            at(3.7 * pose), PHYSICS
        )
        for seed in (1, 2, 3)
        for pose in range(POSES)
    ]
    heard = np.stack([ping.amplitude for ping in pings])[:, FROM_ROW:, 60:-60]
    found = heard / mean[FROM_ROW:, 60:-60].astype(np.float64)
    assert found.std() / found.mean() == pytest.approx(0.5227, abs=off)
    assert correlation(found[:, 1:], found[:, :-1]) == pytest.approx(0.19, abs=0.01)
    power = np.square(found)[:, :, 90:181]
    assert correlation(power[:, :, 1:], power[:, :, :-1]) == pytest.approx(0.937, abs=0.01)


def test_neighbours_share_speckle_as_by_beams_and_lines(
    relative: NDArray[np.float64],
) -> None:
    power = np.square(relative)[:, :, 150:241]
    assert correlation(power[:, :, 1:], power[:, :, :-1]) == pytest.approx(0.937, abs=0.015)
    assert correlation(relative[:, 1:], relative[:, :-1]) == pytest.approx(0.19, abs=0.03)
    assert abs(correlation(relative[:, 2:], relative[:, :-2])) < 0.05


def test_standing_still_repeats_the_speckle_through_faint_noise_only(engine: PingEngine) -> None:
    quiet, loud = (
        [
            engine.ping(at(0.0), dataclasses.replace(PHYSICS, noise_level_db=level_db), ping_id)
            for ping_id in (1, 2)
        ]
        for level_db in (20.0, 160.0)
    )
    assert alike(*quiet) > 0.95
    assert abs(alike(*loud)) < 0.05


def test_a_few_centimetres_aside_renew_it(
    engine: PingEngine, relative: NDArray[np.float64]
) -> None:
    assert abs(correlation(relative[0], relative[1])) < 0.05
    here, aside = (
        engine.ping(FramePose(np.array([0.0, y, 0.0]), np.eye(3)), PHYSICS) for y in (0.0, 0.1)
    )
    assert alike(here, aside) < 0.3
