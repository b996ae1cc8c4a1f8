"""What the filters make of a ping, as pictures: for whoever sets their thresholds.

Rows are ranges, the nearest at the bottom; columns are beams, port on the left.
"""

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config import Config
from mapperd.config_store import ConfigStore
from mapperd.echo import echo_of
from mapperd.errors import ExportError, MapError
from mapperd.events import EventLog, Severity
from mapperd.export.atomic import atomic_file, make_folder
from mapperd.export.png import png_bytes
from mapperd.filters.stage import filter_echo
from oculus_driver.ping import Ping

__all__ = ["debug_pictures", "draw_pictures", "write_debug_pictures"]

DRAW_S = 1.0
"""Between pictures, while `visualization.show_opencv_visualization` is on."""

ROBOT = (255, 64, 64)
TERRAIN = (64, 255, 64)

Picture = NDArray[np.uint8]


def debug_pictures(ping: Ping, config: Config) -> dict[str, Picture]:
    """Draw a ping.

    Args:
        ping: what the sonar heard.
        config: whose filters and bands.

    Returns:
        `ping` and `filtered` (rows, beams): the image before the filters, and what the map is to
        see; `bands` (rows, beams, 3): samples above the intensity threshold, green in the band of
        terrain, red from `robot_detection.min_threshold` on.

    Raises:
        MapError: the ping has no image that can be mapped.
    """
    echo = echo_of(ping, config.sonar)
    filtered, _ = filter_echo(echo, config)
    seen = echo.intensity
    terrain, robots = config.terrain_detection, config.robot_detection
    bands = np.repeat((seen / 2)[:, :, None], 3, axis=2)
    loud = seen > config.filtering.intensity_threshold
    in_band = (seen >= terrain.min_threshold) & (seen < terrain.max_threshold)
    bands[loud & in_band] = TERRAIN
    bands[loud & (seen >= robots.min_threshold)] = ROBOT
    images: dict[str, NDArray[np.floating]]
    images = {"ping": seen, "filtered": filtered.intensity, "bands": bands}
    return {name: _upright(image) for name, image in images.items()}


def write_debug_pictures(ping: Ping, config: Config, folder: Path) -> list[Path]:
    """Write the pictures of a ping as PNG, each whole or not at all; returns their paths.

    Args:
        ping: what the sonar heard.
        config: whose filters and bands.
        folder: is made where it is not there; older pictures in it are replaced.

    Raises:
        MapError: the ping has no image that can be mapped.
        ExportError: nothing can be written there.
    """
    pictures = debug_pictures(ping, config)
    make_folder(folder)
    paths = []
    for name, picture in pictures.items():
        path = folder / f"{name}.png"
        with atomic_file(path) as file:
            file.write(png_bytes(picture))
        paths.append(path)
    return paths


async def draw_pictures(
    newest: Callable[[], Ping | None], settings: ConfigStore, events: EventLog, folder: Path
) -> None:
    """Draw the newest ping every second while the settings want it; until cancelled.

    Args:
        newest: the ping that was mapped last.
        settings: in force.
        events: is told once of what stands in the way.
        folder: for the pictures.
    """
    settings.follow(("visualization",), lambda _: None)  # read anew every second
    drawn: Ping | None = None
    told = ""
    while True:
        ping, config = newest(), settings.current
        if config.visualization.show_opencv_visualization and ping is not None:
            try:
                if ping is not drawn:
                    await asyncio.to_thread(write_debug_pictures, ping, config, folder)
                drawn, told = ping, ""
            except (ExportError, MapError) as error:
                if str(error) != told:
                    events.add(Severity.WARNING, "debug_pictures", f"not drawn: {error}")
                told = str(error)
        await asyncio.sleep(DRAW_S)


def _upright(image: NDArray[np.floating]) -> Picture:
    return np.ascontiguousarray(np.clip(image, 0, 255).astype(np.uint8)[::-1])
