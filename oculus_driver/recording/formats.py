"""The kinds of recordings that can be read, and how a file's content tells which it is."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO, Final

from oculus_driver.errors import RecordingError
from oculus_driver.recording.mcap_reader import read_mcap
from oculus_driver.recording.mcap_records import MAGIC
from oculus_driver.recording.network_capture import read_network_capture
from oculus_driver.recording.oculus_log import is_encrypted, read_oculus_log
from oculus_driver.recording.oculus_log_records import CONVERTED_MAGIC, FILE_MAGIC
from oculus_driver.recording.pcap_files import PCAP_MAGICS
from oculus_driver.recording.pcapng_packets import PCAPNG_MAGIC
from oculus_driver.recording.raw import is_raw_stream, read_raw
from oculus_driver.recording.viewpoint_log import read_viewpoint_log

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from oculus_driver.recording.chunk import Chunk, Progress

MCAP: Final = "mcap"
OCULUS_RAW: Final = "oculus-raw"
OCULUS_LOG: Final = "oculus-log"
VIEWPOINT_LOG: Final = "viewpoint-log"
PCAP: Final = "pcap"
PCAPNG: Final = "pcapng"

READERS: Final[dict[str, Callable[[BinaryIO, int, Progress], Iterator[Chunk]]]] = {
    MCAP: read_mcap,
    OCULUS_RAW: lambda file, _, progress: read_raw(file, progress),
    OCULUS_LOG: read_oculus_log,
    VIEWPOINT_LOG: read_viewpoint_log,
    PCAP: read_network_capture,
    PCAPNG: read_network_capture,
}
"""What yields the chunks of an open file of a size, and fills in what it finds wrong with it."""

_PROBE: Final = 1 << 16
_LEAST_MAGIC: Final = 6

_MAGICS: Final = {
    FILE_MAGIC.to_bytes(4, "little"): OCULUS_LOG,
    CONVERTED_MAGIC.to_bytes(4, "little"): OCULUS_LOG,
    b"SQLite format 3\0": VIEWPOINT_LOG,
    **dict.fromkeys(PCAP_MAGICS, PCAP),
    PCAPNG_MAGIC: PCAPNG,
}

_FOREIGN: Final = {
    b"#ROSBAG": "a ROS 1 bag",
    b"\x1f\x8b": "compressed with gzip",
    b"\x28\xb5\x2f\xfd": "compressed with zstd",
    b"PK\x03\x04": "a zip archive",
}


def kind_of(path: Path, file: BinaryIO, size: int) -> str:
    """Return the format of an open file, told by content. Moves the file.

    Raises:
        RecordingError: it holds no recording, or an encrypted one.
    """
    if size == 0:
        raise RecordingError(f"{path}: is empty; nothing was recorded")
    file.seek(0)
    probe = file.read(_PROBE)
    alike = sum(a == b for a, b in zip(probe, MAGIC, strict=False))
    if alike >= min(_LEAST_MAGIC, size):
        return MCAP
    for magic, kind in _MAGICS.items():
        if probe.startswith(magic):
            if kind == OCULUS_LOG and is_encrypted(probe):
                raise RecordingError(f"{path}: is encrypted; export it without encryption")
            return kind
    if is_raw_stream(file):
        return OCULUS_RAW
    raise RecordingError(
        f"{path}: {_description(probe)}; expected MCAP, a raw Oculus stream, an .oculus log, "
        "or a pcap or pcapng capture"
    )


def _description(probe: bytes) -> str:
    for magic, name in _FOREIGN.items():
        if probe.startswith(magic):
            return f"is {name}, which cannot be read"
    if not any(probe):
        return "holds only zeros"
    printable = sum(byte >= 0x20 or byte in b"\t\n\r\f" for byte in probe)  # noqa: PLR2004 - space
    if printable == len(probe):
        return "is a text file"
    return "holds no sonar messages"
