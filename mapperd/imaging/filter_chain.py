"""The image without what is not to be mapped: the step's first stage, and `CrosstalkFilter`.

OpenCV belongs to the extra `filters`; it is imported only when a filter that needs it is on.
"""

import dataclasses
import importlib.util

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.config.catalog import hint_at, rule_text
from mapperd.config.tree import Config, CrosstalkConfig, FilteringConfig, SonarConfig
from mapperd.errors import ConfigError, MapError, missing_extra
from mapperd.imaging.ping_image import PingImage, ping_image_of_array
from mapperd.imaging.robots import Robot, find_robots, terrain_of
from oculus_driver.noise import is_echo

__all__ = ["CrosstalkFilter", "check_filters", "filter_ping_image"]


def check_filters(config: Config) -> None:
    """Check that the filters that are on can run.

    Raises:
        ConfigError: OpenCV is not installed.
    """
    for name in ("crosstalk", "robot_detection"):
        if getattr(config, name).enabled and importlib.util.find_spec("cv2") is None:
            path = f"$.{name}.enabled"
            raise ConfigError(f"{path}: {missing_extra('OpenCV', 'filters')}", path)


def filter_ping_image(image: PingImage, config: Config) -> tuple[PingImage, tuple[Robot, ...]]:
    """Remove stripes and noise from an image, and separate robots from terrain.

    Args:
        image: intensities and geometry.
        config: the settings; `check_filters` has passed them.

    Returns:
        The image that the map is to see, and the robots in it.
    """
    intensity = image.intensity
    crosstalk, robots = config.crosstalk, config.robot_detection
    if crosstalk.enabled:
        from mapperd.imaging.crosstalk import notched, without_stripes  # noqa: PLC0415 an extra

        if crosstalk.morpho_enabled or crosstalk.azimuth_enabled:
            threshold = config.filtering.intensity_threshold
            intensity = without_stripes(intensity, image.bearings_rad, crosstalk, threshold)
        intensity = notched(intensity, crosstalk) if crosstalk.fft_enabled else intensity
    if config.filtering.noise_factor > 0 and config.mapping.rule == "iwlo":
        echoes = is_echo(intensity, config.filtering.noise_factor)
        intensity = np.where(echoes, intensity, np.float32(0.0))
    found: tuple[Robot, ...] = ()
    if robots.enabled:
        found = tuple(find_robots(intensity, image.bearings_rad, image.range_resolution_m, robots))
        intensity = terrain_of(intensity, config.terrain_detection, robots)
    if intensity is image.intensity:
        return image, found
    intensity.setflags(write=False)
    return dataclasses.replace(image, intensity=intensity), found


class CrosstalkFilter:
    """Removes stripes from polar images: thin rows over the whole fan, from another sound source.

    It is the filter of the settings' section `crosstalk`, for images outside a map.

    Args:
        kernel_size: stripes are thinner than this many rows; 2 to 101.
        kernel_shape: rect, ellipse or cross.
        consistency_threshold: share of the sectors, in each third of the fan, that a stripe stands
            out in; above 0, at most 1.
        morpho_enabled: only what is thinner than the kernel is a stripe.
        azimuth_check_enabled: only what stands out over the whole fan is a stripe.

    Raises:
        ConfigError: a value that is not allowed, or OpenCV is not installed.
    """

    def __init__(
        self,
        kernel_size: int = 5,
        kernel_shape: str = "rect",
        consistency_threshold: float = 0.5,
        morpho_enabled: bool = True,  # noqa: FBT001, FBT002 the published signature
        azimuth_check_enabled: bool = True,  # noqa: FBT001, FBT002
    ) -> None:
        given = {
            "kernel_size": ("morpho_kernel_size", kernel_size),
            "kernel_shape": ("morpho_kernel_shape", kernel_shape),
            "consistency_threshold": ("azimuth_threshold", consistency_threshold),
            "morpho_enabled": ("morpho_enabled", morpho_enabled),
            "azimuth_check_enabled": ("azimuth_enabled", azimuth_check_enabled),
        }
        for argument, (field, value) in given.items():
            path = f"$.crosstalk.{field}"
            try:
                msgspec.convert(value, hint_at(path))
            except msgspec.ValidationError as error:
                text = f"{argument}: {value!r} is not allowed; allowed: {rule_text(path)}"
                raise ConfigError(text, argument) from error
        fields = dict(given.values())
        self._settings = msgspec.convert(fields | {"enabled": True}, CrosstalkConfig)
        check_filters(Config(crosstalk=self._settings))

    def apply(
        self,
        polar_image: ArrayLike,
        *,
        bearings: ArrayLike | None = None,
        intensity_threshold: float = FilteringConfig().intensity_threshold,
    ) -> NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.floating]:
        """Return an image without stripes.

        Args:
            polar_image: (rows, beams), row 0 nearest; uint8, uint16 or float in 0..255.
            bearings: (beams,) radians, increasing; None for beams uniform in sine over 130 degrees.
            intensity_threshold: 0..255, above which a sample is a return.

        Returns:
            (rows, beams) of the same dtype, nowhere brighter; samples outside stripes keep their
            value.

        Raises:
            MapError: no image, or bearings that are no fan.
        """
        image = np.asarray(polar_image)
        fan = SonarConfig() if bearings is None else SonarConfig(horizontal_fov=180.0)
        ping_image = ping_image_of_array(image, 1.0, bearings, fan)
        if ping_image.intensity.shape != image.shape:
            raise MapError("bearings are beyond 90 degrees", "bad_bearings")
        config = Config(
            crosstalk=self._settings,
            filtering=FilteringConfig(intensity_threshold=intensity_threshold),
        )
        filtered = filter_ping_image(ping_image, config)[0].intensity
        scale = np.iinfo(image.dtype).max / 255 if image.dtype.kind == "u" else 1.0
        changed = np.rint(filtered * scale) if image.dtype.kind == "u" else filtered
        result: NDArray[np.uint8] = np.where(
            filtered < ping_image.intensity, changed.astype(image.dtype), image
        )
        return result
