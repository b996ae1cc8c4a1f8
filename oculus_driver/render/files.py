"""Writes frames to PNG images or an MP4 video."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, Self

import cv2

from oculus_driver.errors import OculusError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray


class FrameSink(Protocol):
    """Accepts frames, uint8 (height, width, 3), BGR, all of one size.

    Attributes:
        files: the written files.
    """

    files: list[Path]

    def add(self, frame: NDArray[np.uint8], name: str) -> None:
        """Add the next frame."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


class PngFolder:
    """A folder of PNG files, one per frame, numbered in order.

    Raises:
        OculusError: a file or the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.files: list[Path] = []
        self._folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _cannot_write(folder) from error

    def add(self, frame: NDArray[np.uint8], name: str) -> None:
        """Write the next frame."""
        path = self._folder / f"{len(self.files):06d}_{name}.png"
        write_png(path, frame)
        self.files.append(path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class PngFile:
    """One PNG file; each frame replaces the previous one.

    Raises:
        OculusError: the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.files = [path]

    def add(self, frame: NDArray[np.uint8], name: str) -> None:  # noqa: ARG002 - part of the protocol
        """Write the frame."""
        write_png(self.files[0], frame)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class VideoFile:
    """An MP4 file.

    Raises:
        OculusError: the file cannot be written, or OpenCV has no encoder for it.
    """

    def __init__(self, path: Path, frames_per_s: float) -> None:
        self.files = [path]
        self._path = path
        self._frames_per_s = frames_per_s
        self._writer: cv2.VideoWriter | None = None

    def add(self, frame: NDArray[np.uint8], name: str) -> None:  # noqa: ARG002 - part of the protocol
        """Append the next frame."""
        if self._writer is None:
            size = (frame.shape[1], frame.shape[0])
            code: Any = cv2.VideoWriter.fourcc(*"mp4v")
            self._writer = cv2.VideoWriter(str(self._path), code, self._frames_per_s, size)
            if not self._writer.isOpened():
                raise _cannot_write(self._path)
        self._writer.write(frame)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.release()


def write_png(path: Path, frame: NDArray[np.uint8]) -> None:
    """Write one image.

    Raises:
        OculusError: the file cannot be written.
    """
    done, data = cv2.imencode(".png", frame)
    try:
        if not done:
            raise _cannot_write(path)
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise _cannot_write(path) from error


def _cannot_write(path: Path) -> OculusError:
    return OculusError(f"{path}: cannot be written; check folder, permissions and free space")
