"""A ping's products as images: camera pictures, fan, and the camera's parameters."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oculus_driver.errors import OculusError
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.render import COLOURS, Painter, Style
from oculus_driver.stream import StreamParser
from sonar_sim.products.sounding import PingProducts
from sonar_sim.raycast import meshes
from sonar_sim.raycast.depth_camera import Pinhole
from sonar_sim.wire import compass_heading_deg, ping_message

DEPTH_UNIT_M = 0.001
"""Of a grey step of depth pictures, as in ROS' 16UC1."""
SNR_FLOOR_DB = -20.0
SNR_TOP_DB = 60.0
NOTHING = (34, 26, 20)
SEA = (220, 190, 150)


def depth_picture(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Depth in millimetres, 0 where nothing is; what is beyond 65.535 m stays there."""
    steps = np.rint(np.clip(depth_m / DEPTH_UNIT_M, 0.0, 65535.0))
    grey: NDArray[np.uint16] = steps.astype(np.uint16)
    return grey


def normal_picture(normals: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Normals as colours: red right, green down, blue ahead, -1 to 1 as 0 to 255; else black."""
    there = np.any(normals != 0.0, axis=-1)
    colours = np.rint((normals + 1.0) * 127.5).astype(np.uint8)
    colours[~there] = 0
    return np.ascontiguousarray(colours[..., ::-1])


def level_picture(level_db: NDArray[np.float32], colours: str = "viridis") -> NDArray[np.uint8]:
    """Levels from -20 to 60 dB in colours; NaN is dark."""
    share = (level_db - SNR_FLOOR_DB) / (SNR_TOP_DB - SNR_FLOOR_DB)
    grey = np.rint(255.0 * np.clip(np.nan_to_num(share), 0.0, 1.0)).astype(np.uint8)
    picture = colour_map(grey, colours)
    picture[np.isnan(level_db)] = NOTHING
    return picture


def label_picture(label: NDArray[np.int32]) -> NDArray[np.uint8]:
    """A colour of its own for each surface, by the golden angle around the hues.

    What is nothing is dark, the sea's surface light blue.
    """
    hue = (label.astype(np.int64) * 137 % 360 // 2).astype(np.uint8)
    saturation = np.where(label % 2 == 0, 200, 130).astype(np.uint8)
    wheel = np.stack([hue, saturation, np.full_like(hue, 230)], axis=-1)
    picture: NDArray[np.uint8] = cv2.cvtColor(wheel, cv2.COLOR_HSV2BGR).astype(np.uint8)
    picture[label == meshes.NOTHING] = NOTHING
    picture[label == meshes.SEA] = SEA
    return picture


def colour_map(grey: NDArray[np.uint8], colours: str) -> NDArray[np.uint8]:
    """Apply one of the driver's colour maps."""
    if grey.size == 0:
        return np.zeros((*grey.shape, 3), dtype=np.uint8)
    chosen = COLOURS[colours]
    if chosen is None:
        return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR).astype(np.uint8)
    return cv2.applyColorMap(grey, chosen).astype(np.uint8)


def decoded_ping(sounding: PingProducts) -> Ping:
    """Send the ping through the sonar's protocol, and read it as the driver does."""
    image = sounding.image
    if image.dtype.kind == "f":
        image = np.rint(sounding.level * 65535.0).astype(np.uint16)
    message = ping_message(
        image,
        ping_id=sounding.ping_id,
        start_time_s=sounding.time_s,
        heading_deg=compass_heading_deg(sounding.map_T_sonar.rotation),
        sonar=sounding.sonar,
        water=sounding.scene.water,
    )
    parser = StreamParser()
    for found in (*parser.feed(message), *parser.finish()):
        ping = decode_ping(found)
        if isinstance(ping, Ping):
            return ping
    raise OculusError(f"ping {sounding.ping_id}: the driver cannot read it")


def fan_picture(sounding: PingProducts, style: Style) -> NDArray[np.uint8]:
    """Draw with range rings, bearing spokes and captions; blue first."""
    return Painter(style).paint(decoded_ping(sounding))


def camera_info(camera: Pinhole, frame_id: str = "sonar_optical") -> dict[str, Any]:
    """Intrinsics of a camera without distortion, axes x right, y down, z ahead."""
    focal = camera.focal_px
    across, down = camera.centre_px
    return {
        "header": {"frame_id": frame_id},
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "D": [0.0] * 5,
        "K": [focal, 0.0, across, 0.0, focal, down, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [focal, 0.0, across, 0.0, 0.0, focal, down, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
