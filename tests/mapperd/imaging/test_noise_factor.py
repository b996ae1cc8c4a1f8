"""Returns stand out of the noise of their range: `filtering.noise_factor`."""

import numpy as np

from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.imaging.filter_chain import filter_ping_image
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.state_messages import first_returns
from oculus_driver.noise import is_echo

WALL_M = 6.0
ROWS, BEAMS, STEP_M = 400, 96, 0.02


def loud_noise() -> PingImage:
    """A wall, and noise that the gain over time raises beyond the fixed threshold."""
    scale = 2.0 + 30.0 * np.linspace(0, 1, ROWS) ** 2
    noise = np.random.default_rng(8).rayleigh(scale[:, None], (ROWS, BEAMS))
    noise[round(WALL_M / STEP_M) :][:12] = 220.0
    image = np.minimum(noise, 255).astype(np.float32)
    image.setflags(write=False)
    return PingImage(image, np.linspace(-0.6, 0.6, BEAMS), STEP_M)


def settings(factor: float) -> Config:
    return with_values(Config(), {"octree.voxel_resolution": 0.1, "filtering.noise_factor": factor})


def test_without_it_the_image_stays() -> None:
    image = loud_noise()
    assert filter_ping_image(image, settings(0.0))[0] is image


def test_noise_is_no_return() -> None:
    image = loud_noise()
    kept = filter_ping_image(image, settings(7.0))[0].intensity
    assert np.array_equal(kept, np.where(is_echo(image.intensity, 7.0), image.intensity, 0.0))
    for factor, most in ((0.0, 1.0), (7.0, 0.02)):
        config = settings(factor)
        points, _ = first_returns(filter_ping_image(image, config)[0], config)
        off_the_wall = np.abs(np.hypot(points[:, 0], points[:, 1]) - WALL_M) > 0.1
        assert (off_the_wall.mean() > 0.5) == (factor == 0)
        assert off_the_wall.mean() <= most


def test_the_map_holds_the_wall_and_not_the_noise() -> None:
    maps = [SonarMap(settings(factor)) for factor in (0.0, 7.0)]
    for sonar_map in maps:
        for _ in range(3):
            sonar_map.integrate(filter_ping_image(loud_noise(), sonar_map.config)[0], np.eye(4))
    off_the_wall = []
    for sonar_map in maps:
        centres_m = sonar_map.voxels("occupied").centres_m
        off_the_wall.append((np.abs(np.linalg.norm(centres_m, axis=1) - WALL_M) > 0.3).mean())
    assert off_the_wall[0] > 0.2
    assert off_the_wall[1] < 0.03


def test_the_arc_rule_gets_the_whole_image() -> None:
    config = with_values(settings(7.0), {"mapping.rule": "arc"})
    image = loud_noise()
    assert filter_ping_image(image, config)[0] is image
