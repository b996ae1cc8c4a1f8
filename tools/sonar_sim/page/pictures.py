"""A ping as pictures of a page: the fan with rings, and the fan bare, to lie in the scene."""

import cv2
import numpy as np
from numpy.typing import NDArray

from oculus_driver.fan import FanGeometry, fit_fan
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.render import Painter, Style
from oculus_driver.render.painter import warp_to_fan
from oculus_driver.stream import StreamParser

PANEL_PX = 460
TEXTURE_PX = 384
GAMMA = 0.6
WATER_ALPHA, ECHO_ALPHA = 60, 255


def ping_of(message: bytes) -> Ping | None:
    """Read a message as the driver does; None if it is no ping."""
    parser = StreamParser()
    for found in (*parser.feed(message), *parser.finish()):
        ping = decode_ping(found)
        if isinstance(ping, Ping):
            return ping
    return None


class PingPictures:
    """Paints pings; the geometry of the last shape is kept."""

    def __init__(self) -> None:
        self._painter = Painter(Style(height_px=PANEL_PX))
        self._fan: FanGeometry | None = None
        self._shape: tuple[object, ...] = ()

    def panel(self, ping: Ping) -> NDArray[np.uint8]:
        """Paint the fan with rings and captions, RGB, (height, width, 3)."""
        return np.ascontiguousarray(self._painter.paint(ping)[..., ::-1])

    def texture(self, ping: Ping) -> tuple[NDArray[np.uint8], float, float]:
        """Paint the fan bare: water is faint, and what is outside of the fan clear.

        Returns:
            RGBA, (height, width, 4), ahead is up and starboard right; its width and height in m.
            The sonar is in the middle of the lower edge.
        """
        shape = (ping.rows, ping.beams, ping.range_resolution_m, ping.bearings_rad.tobytes())
        if self._fan is None or shape != self._shape:
            half = max(float(np.abs(np.sin(ping.bearings_rad)).max()), 0.1)
            width_px = max(16, round(2.0 * half * TEXTURE_PX))
            size = (width_px, TEXTURE_PX)
            self._fan = fit_fan(ping.bearings_rad, ping.max_range_m, size, (0, 0, 0, 0))
            self._shape = shape
        fan = self._fan
        full = float(np.iinfo(ping.image.dtype).max)
        level = np.clip(np.asarray(ping.image, dtype=np.float32) / full, 0.0, 1.0) ** GAMMA
        warped = np.clip(warp_to_fan(level.astype(np.float32), fan), 0.0, 1.0)
        grey = np.rint(255.0 * warped).astype(np.uint8)
        colours = cv2.applyColorMap(grey, cv2.COLORMAP_INFERNO)[..., ::-1]
        alpha = WATER_ALPHA + (ECHO_ALPHA - WATER_ALPHA) * np.minimum(1.0, 2.5 * warped)
        alpha[fan.outside] = 0.0
        picture = np.dstack([colours, alpha.astype(np.uint8)]).astype(np.uint8)
        return picture, fan.width_px * fan.metres_per_px, fan.height_px * fan.metres_per_px
