"""Pictures of a ping before and after each filter, to set their thresholds without a topside PC.

`visualization.show_opencv_visualization` turns them on.

Rows are ranges, the nearest at the bottom; columns are beams, port on the left. And where
localization believes that the vehicle is.
"""

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.config.live import ConfigStore
from mapperd.config.tree import Config
from mapperd.errors import ExportError, MapError
from mapperd.events import EventLog, Severity
from mapperd.export.png import png_bytes
from mapperd.imaging.filter_chain import filter_ping_image
from mapperd.imaging.ping_image import ping_image_of
from mapperd.io import atomic_file, make_folder
from mapperd.localization.picture import Trail, localization_picture
from mapperd.localization.status import LocalizationSnapshot
from oculus_driver.ping import Ping

__all__ = [
    "debug_pictures",
    "draw_pictures",
    "write_debug_pictures",
    "write_localization_picture",
]

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
    echo = ping_image_of(ping, config.sonar)
    filtered, _ = filter_ping_image(echo, config)
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
    return [_write(folder / f"{name}.png", picture) for name, picture in pictures.items()]


async def draw_pictures(
    newest: Callable[[], Ping | None],
    settings: ConfigStore,
    events: EventLog,
    folder: Path,
    localized: Callable[[], LocalizationSnapshot | None] = lambda: None,
) -> None:
    """Draw the newest ping and localization every second while the settings want it, for ever.

    Args:
        newest: the ping that was mapped last.
        settings: in force.
        events: where a failure is logged once.
        folder: for the pictures.
        localized: how localization goes; None where it is off.
    """
    settings.follow(("visualization",), lambda _: None)  # read again every second
    artist = _Artist(folder)
    reported = ""
    while True:
        config, snapshot = settings.current, localized()
        if config.visualization.show_opencv_visualization:
            try:
                await asyncio.to_thread(artist.draw, newest(), snapshot, config)
                reported = ""
            except (ExportError, MapError) as error:
                if str(error) != reported:
                    events.add(Severity.WARNING, "debug_pictures", f"not drawn: {error}")
                reported = str(error)
        await asyncio.sleep(DRAW_S)


class _Artist:
    """Draws what is new; one thread at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._ping: Ping | None = None
        self._snapshot: LocalizationSnapshot | None = None
        self._trail = Trail()

    def draw(
        self, ping: Ping | None, snapshot: LocalizationSnapshot | None, config: Config
    ) -> None:
        if snapshot is not None and snapshot is not self._snapshot:
            if snapshot.belief is not None:
                self._trail.add(snapshot.belief.best)
            write_localization_picture(snapshot, self._trail.points_m(), self._folder)
            self._snapshot = snapshot
        if ping is not None and ping is not self._ping:
            write_debug_pictures(ping, config, self._folder)
            self._ping = ping


def write_localization_picture(
    snapshot: LocalizationSnapshot, trail_m: NDArray[np.float64], folder: Path
) -> Path | None:
    """Write `localization.png`, whole or not at all; nothing without a map.

    Args:
        snapshot: how localization goes.
        trail_m: (N, 2) places before.
        folder: is made where it is not there.

    Raises:
        ExportError: nothing can be written there.
    """
    picture = localization_picture(snapshot, trail_m)
    if picture is None:
        return None
    make_folder(folder)
    return _write(folder / "localization.png", picture)


def _write(path: Path, picture: Picture) -> Path:
    with atomic_file(path) as file:
        file.write(png_bytes(picture))
    return path


def _upright(image: NDArray[np.floating]) -> Picture:
    return np.ascontiguousarray(np.clip(image, 0, 255).astype(np.uint8)[::-1])
