"""The step's first stage: the image without what is not to be mapped.

OpenCV belongs to the extra `filters`; it is imported only when a filter that needs it is on.
"""

import dataclasses
import importlib.util

from mapperd.config.tree import Config
from mapperd.errors import ConfigError, missing_extra
from mapperd.imaging.ping_image import PingImage
from mapperd.imaging.robots import Robot

__all__ = ["check_filters", "filter_ping_image"]


def check_filters(config: Config) -> None:
    """Check that the filters that are on can run.

    Raises:
        ConfigError: OpenCV is not installed.
    """
    for name in ("crosstalk", "robot_detection"):
        if getattr(config, name).enabled and importlib.util.find_spec("cv2") is None:
            path = f"$.{name}.enabled"
            raise ConfigError(f"{path}: {missing_extra('OpenCV', 'filters')}", path)


def filter_ping_image(echo: PingImage, config: Config) -> tuple[PingImage, tuple[Robot, ...]]:
    """Remove stripes from an image and separate robots from terrain.

    Args:
        echo: intensities and geometry.
        config: the settings; `check_filters` has passed them.

    Returns:
        The echo that the map is to see, and the robots in it.
    """
    image = echo.intensity
    crosstalk, robots = config.crosstalk, config.robot_detection
    if crosstalk.enabled:
        from mapperd.imaging.crosstalk import without_stripes  # noqa: PLC0415 an extra
        from mapperd.imaging.fft_notch import notched  # noqa: PLC0415 only where wanted

        if crosstalk.morpho_enabled or crosstalk.azimuth_enabled:
            threshold = config.filtering.intensity_threshold
            image = without_stripes(image, echo.bearings_rad, crosstalk, threshold)
        image = notched(image, crosstalk) if crosstalk.fft_enabled else image
    found: tuple[Robot, ...] = ()
    if robots.enabled:
        from mapperd.imaging.robot_bands import find_robots, terrain_of  # noqa: PLC0415 an extra

        found = tuple(find_robots(image, echo.bearings_rad, echo.range_resolution_m, robots))
        image = terrain_of(image, config.terrain_detection, robots)
    if image is echo.intensity:
        return echo, found
    image.setflags(write=False)
    return dataclasses.replace(echo, intensity=image), found
