"""Maps in the files of Nav2's map server: a .yaml beside a .pgm, .png or .bmp image.

Pixels become cells as the map server documents. Darkness is 1 - pixel / 255, or pixel / 255 with
`negate`; colours use the mean of their channels. Row 0 of the image is at the largest y.

- trinary: occupied where darkness is above `occupied_thresh`, free below `free_thresh`, else
  unknown; an alpha channel counts as another colour;
- scale: the same, with percent in between; pixels that are not opaque are unknown;
- raw: the pixel is the cell, above 100 unknown; `negate` and the thresholds are ignored.
"""

import importlib.util
import math
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from mapperd.config.loader import YamlProblem, parse_yaml
from mapperd.errors import MapError, missing_extra
from mapperd.io import atomic_file
from mapperd.localization.maps import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, GridMap

__all__ = ["image_of", "pgm_bytes", "pgm_pixels", "read_nav2_map", "write_nav2_map"]

HEADER = re.compile(
    rb"P5(?:\s|#[^\n]{0,200}\n)+(\d{1,9})(?:\s|#[^\n]{0,200}\n)+(\d{1,9})"
    rb"(?:\s|#[^\n]{0,200}\n)+(\d{1,5})\s"
)
"""Magic, width, height, maximum; comments until the end of a line in between."""

MAX_HEADER_BYTES = 4096
BRIGHTEST = 255


def pgm_pixels(data: bytes, name: str) -> NDArray[np.uint8]:
    """Return the pixels of a PGM file, (height, width), scaled so that white is 255.

    Args:
        data: content of the file.
        name: its name in messages.

    Raises:
        MapError: it is not such an image, or is incomplete (`bad_map_file`).
    """
    header = HEADER.match(data[:MAX_HEADER_BYTES])
    if header is None:
        raise MapError(f"{name}: no binary grey image (PGM, P5), PNG or BMP", "bad_map_file")
    width, height, brightest = (int(number) for number in header.groups())
    if not 0 < brightest <= BRIGHTEST:
        raise MapError(
            f"{name}: 8 bits a pixel were expected, not up to {brightest}", "bad_map_file"
        )
    if not 0 < width * height <= MAX_CELLS:
        raise MapError(
            f"{name}: {width} x {height} pixels; allowed: up to {MAX_CELLS}", "bad_map_file"
        )
    if len(data) - header.end() != width * height:
        raise MapError(
            f"{name}: {len(data) - header.end()} bytes of pixels, {width} x {height} were expected",
            "bad_map_file",
        )
    pixels = np.frombuffer(data, np.uint8, offset=header.end()).reshape(height, width)
    if brightest == BRIGHTEST:
        return pixels.copy()
    if int(pixels.max()) > brightest:
        raise MapError(f"{name}: a pixel above its brightest, {brightest}", "bad_map_file")
    scaled: NDArray[np.uint8] = np.rint(pixels * (BRIGHTEST / brightest)).astype(np.uint8)
    return scaled


def pgm_bytes(pixels: NDArray[np.uint8]) -> bytes:
    """Return the PGM file of pixels (height, width)."""
    height, width = pixels.shape
    return b"P5\n%d %d\n255\n" % (width, height) + np.ascontiguousarray(pixels).tobytes()


@dataclass(frozen=True, slots=True, eq=False)
class _ImagePixels:
    """An image.

    Attributes:
        total: (height, width), sum of the channels.
        channels: number of channels, each 0 to 255.
        alpha: (height, width) opacity, 0 to 255; None without an alpha channel.
    """

    total: NDArray[np.unsignedinteger]
    channels: int = 1
    alpha: NDArray[np.uint8] | None = None


PNG, BMP = b"\x89PNG\r\n\x1a\n", b"BM"
PNG_SIZE, BMP_SIZE = struct.Struct(">16x2I"), struct.Struct("<18x2i")
ALPHA_CHANNELS = 4


def _pixels_of(data: bytes, name: str) -> _ImagePixels:
    """Return the pixels of an image file; the content decides the format, not the suffix.

    Raises:
        MapError: it is not such an image, is incomplete, or needs a library (`bad_map_file`).
    """
    layout = next(
        (at for magic, at in ((PNG, PNG_SIZE), (BMP, BMP_SIZE)) if data[:8].startswith(magic)), None
    )
    if layout is None:
        return _ImagePixels(pgm_pixels(data, name))
    if len(data) < layout.size:
        raise MapError(f"{name}: not a whole image", "bad_map_file")
    width, height = layout.unpack_from(data)
    if not 0 < width * abs(height) <= MAX_CELLS:
        raise MapError(
            f"{name}: {width} x {abs(height)} pixels; allowed: up to {MAX_CELLS}", "bad_map_file"
        )
    if importlib.util.find_spec("cv2") is None:
        raise MapError(f"{name}: {missing_extra('OpenCV', 'filters')}", "bad_map_file")
    import cv2  # noqa: PLC0415 an extra

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or image.shape[:2] != (abs(height), width):
        raise MapError(f"{name}: not a whole image", "bad_map_file")
    if image.dtype == np.uint16:
        image = np.rint(image / np.float32(257)).astype(np.uint8)
    colours = np.atleast_3d(image)
    count = colours.shape[2]
    alpha = colours[..., -1].astype(np.uint8) if count == ALPHA_CHANNELS else None
    return _ImagePixels(colours.sum(axis=2, dtype=np.uint16), count, alpha)


Mode = Literal["trinary", "scale", "raw"]

MAX_YAML_BYTES = 64 * 1024
MAX_IMAGE_BYTES = ALPHA_CHANNELS * MAX_CELLS + 4096
UNKNOWN_PIXEL = {"trinary": 205, "raw": 255}
FREE_PIXEL, OCCUPIED_PIXEL = 254, 0

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""Values that map savers write: 205 is darkness 0.1961, which a higher free_thresh makes free."""

Share = Annotated[float, Meta(ge=0, le=1)]


class _Description(Struct, frozen=True, forbid_unknown_fields=True):
    """Content of the .yaml."""

    image: Annotated[str, Meta(min_length=1, max_length=1000)]
    resolution: Annotated[float, Meta(gt=0, le=1000)]
    origin: tuple[float, float, float]
    occupied_thresh: Share
    free_thresh: Share
    negate: Literal[0, 1] | bool = 0
    mode: Mode = "trinary"

    def __post_init__(self) -> None:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("free_thresh is above occupied_thresh")
        numbers = (self.resolution, *self.origin, self.occupied_thresh, self.free_thresh)
        if not all(map(math.isfinite, numbers)):
            raise ValueError("a number is not finite")


def read_nav2_map(path: Path) -> GridMap:
    """Read a map.

    Args:
        path: the .yaml; the image path in it is relative to its folder.

    Raises:
        MapError: a file cannot be read or is not such a map; the text names the file and the
            cause (`bad_map_file`).
    """
    about = _described(_read(path, MAX_YAML_BYTES), str(path))
    image = path.parent / about.image
    pixels = _pixels_of(_read(image, MAX_IMAGE_BYTES), str(image))
    return GridMap(_cells(pixels, about)[::-1], about.resolution, *about.origin)


def image_of(path: Path) -> str:
    """Return the image path in a .yaml without opening the image.

    Raises:
        MapError: it cannot be read, or is not such a map (`bad_map_file`).
    """
    return _described(_read(path, MAX_YAML_BYTES), str(path)).image


def write_nav2_map(grid: GridMap, path: Path, mode: Mode = "trinary") -> None:
    """Write a map: the .yaml and a .pgm of the same name, each atomically.

    Args:
        grid: in `trinary`, cells are free up to 19 % and occupied from 65 % on.
        path: the .yaml.
        mode: how cells become pixels; `scale` keeps rounded percents, `raw` every cell.

    Raises:
        MapError: a cell is unknown, which `scale` cannot represent (`unknown_in_scale`).
        ExportError: it cannot be written.
    """
    pixels = _pixels(grid.occupancy, mode)[::-1]
    image = path.with_suffix(".pgm")
    limits = (1.0, 0.0) if mode == "scale" else (OCCUPIED_THRESH, FREE_THRESH)
    lines = (
        f"image: {msgspec.json.encode(image.name).decode()}",
        f"mode: {mode}",
        f"resolution: {grid.resolution_m!r}",
        f"origin: [{grid.origin_x_m!r}, {grid.origin_y_m!r}, {grid.origin_yaw_rad!r}]",
        "negate: 0",
        f"occupied_thresh: {limits[0]}",
        f"free_thresh: {limits[1]}",
    )
    with atomic_file(image) as file:
        file.write(pgm_bytes(pixels))
    with atomic_file(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


def _read(path: Path, max_bytes: int) -> bytes:
    try:
        if path.exists() and not path.is_file():  # a pipe would block
            raise MapError(f"{path}: is no regular file", "bad_map_file")
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise MapError(f"{path}: cannot be read: {error}", "bad_map_file") from error
    if len(data) > max_bytes:
        raise MapError(f"{path}: larger than {max_bytes} bytes", "bad_map_file")
    return data


def _described(data: bytes, name: str) -> _Description:
    try:
        tree: Any = parse_yaml(data.decode("utf-8-sig"))
        return msgspec.convert(tree, _Description)
    except UnicodeDecodeError as error:
        raise MapError(f"{name}: not UTF-8 text (byte {error.start})", "bad_map_file") from error
    except (YamlProblem, msgspec.ValidationError) as error:
        raise MapError(f"{name}: {error}", "bad_map_file") from error


def _cells(pixels: _ImagePixels, about: _Description) -> NDArray[np.int8]:
    """Return the cells by a table over all sums of channels."""
    total, channels = pixels.total, pixels.channels
    if pixels.alpha is not None and about.mode != "trinary":
        total, channels = total - pixels.alpha, channels - 1
    value = np.arange(BRIGHTEST * channels + 1)
    if about.mode == "raw":
        mean = np.rint(value / channels)
        known = np.where(mean <= OCCUPIED, mean, UNKNOWN)
    else:
        brightness = value / (BRIGHTEST * channels)
        darkness = brightness if about.negate else 1 - brightness
        span = about.occupied_thresh - about.free_thresh
        if about.mode == "scale" and span > 0:
            between = np.rint(100 * (darkness - about.free_thresh) / span)
        else:
            between = np.full(len(value), UNKNOWN)
        known = np.where(darkness < about.free_thresh, FREE, between)
        known = np.where(darkness > about.occupied_thresh, OCCUPIED, known)
    cells: NDArray[np.int8] = known.astype(np.int8)[total]
    if pixels.alpha is not None and about.mode == "scale":
        cells[pixels.alpha < BRIGHTEST] = UNKNOWN
    return cells


def _pixels(occupancy: NDArray[np.int8], mode: Mode) -> NDArray[np.uint8]:
    unknown = occupancy < 0
    if mode == "scale":
        if unknown.any():
            raise MapError("mode scale has no pixel for unknown cells", "unknown_in_scale")
        return np.rint((100 - occupancy.astype(np.float64)) * 2.55).astype(np.uint8)
    if mode == "raw":
        return np.where(unknown, UNKNOWN_PIXEL["raw"], occupancy).astype(np.uint8)
    pixels = np.full(occupancy.shape, UNKNOWN_PIXEL["trinary"], dtype=np.uint8)
    pixels[(occupancy >= 0) & (occupancy <= 100 * FREE_THRESH)] = FREE_PIXEL
    pixels[occupancy >= 100 * OCCUPIED_THRESH] = OCCUPIED_PIXEL
    return pixels
