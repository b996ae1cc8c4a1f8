"""Draw scans over the fan pictures of the pings that they are taken out of.

    .venv/bin/python tools/studies/scan_picture.py RECORDING --out out/scans

A dot is a return, the brighter the better it is; yellow ones may be floor or surface.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.imaging.ping_image import PingImage, ping_image_of
from mapperd.localization.extraction import ScanContext, scan_of
from mapperd.localization.scan import Scan
from oculus_driver import Ping, StreamParser, decode_ping
from oculus_driver.render import fit_fan, warp_to_fan

SIZE_PX = (1200, 760)
MARGINS_PX = (10, 10, 10, 10)
CONTRAST_GAMMA = 0.5
RETURN, FALSE = (90, 255, 90), (70, 70, 255)
FLOOR_QUALITY = 0.5
FLOOR = (60, 220, 255)
"""Colours, blue first."""


def draw_scan(
    image: PingImage, scan: Scan, true: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """The fan with the returns on it, (height, width, 3), blue first as OpenCV has it.

    Args:
        image: the image.
        scan: taken out of it.
        true: (N,) which returns are true, where it is known: others are red.
    """
    fan = fit_fan(image.bearings_rad, image.max_range_m, SIZE_PX, MARGINS_PX)
    level = (image.intensity / np.float32(255)) ** np.float32(CONTRAST_GAMMA)
    grey = np.rint(np.clip(warp_to_fan(level, fan), 0, 1) * 255).astype(np.uint8)
    grey[fan.outside] = 0
    frame: NDArray[np.uint8] = np.repeat(grey[:, :, None], 3, axis=2)
    good = np.ones(len(scan), dtype=np.bool_) if true is None else true
    for k in range(len(scan)):
        x, y = fan.pixel(float(scan.range_m[k]), float(scan.bearing_rad[k]))
        sure = FLOOR if scan.quality[k] < FLOOR_QUALITY else RETURN
        cv2.circle(frame, (round(x), round(y)), 2, sure if good[k] else FALSE, -1)
    return frame


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a .png, with its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), picture):
        raise OSError(f"{path}: cannot be written")


def main() -> None:
    """Draw every ping of a raw recording."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, help="the bytes of a stream, as they came")
    parser.add_argument("--out", type=Path, default=Path("out/scans"))
    asked = parser.parse_args()
    config = Config()
    for message in StreamParser().feed(asked.recording.read_bytes(), arrival_ns=0):
        ping = decode_ping(message)
        if not isinstance(ping, Ping):
            print(f"no ping: {ping.detail}")
            continue
        try:
            image = ping_image_of(ping, config.sonar)
        except MapError as error:
            print(f"ping {ping.ping_id}: {error}")
            continue
        scan = scan_of(image, ScanContext(0, np.eye(4)), config)
        if isinstance(scan, Scan):
            print(f"ping {ping.ping_id}: {len(scan)} returns of {len(image.bearings_rad)} beams")
            write_picture(asked.out / f"scan-{ping.ping_id}.png", draw_scan(image, scan))


if __name__ == "__main__":
    main()
