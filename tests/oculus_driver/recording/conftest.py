"""Recordings for the tests: what was written, and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, RecordingWriter
from oculus_driver.recording.mcap_records import message_head

if TYPE_CHECKING:
    from pathlib import Path

START_NS = 1_790_000_000_000_000_000

Row = tuple[str, str, int | None, bytes]


@dataclass(frozen=True)
class Written:
    """A recording on disk and what went into it."""

    path: Path
    data: bytes
    rows: list[Row]
    ends: list[int]
    """Size of the file when each row had been written."""

    def start(self, row: int) -> int:
        """Return the offset of a row's record."""
        return self.ends[row] - len(message_head(1, 0, 0, 0)) - len(self.rows[row][3])


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """Return a closed recording of several chunks: a stream in pieces, and odometry between."""
    return _record(tmp_path_factory, {"sonar": OCULUS, "dvl": ODOMETRY_NATIVE})


@pytest.fixture(scope="session")
def odometry_written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """Return a closed recording whose chunks hold several messages."""
    return _record(tmp_path_factory, {"dvl": ODOMETRY_NATIVE, "usbl": ODOMETRY_NATIVE})


def _record(tmp_path_factory: pytest.TempPathFactory, links: dict[str, str]) -> Written:
    path = tmp_path_factory.mktemp("recording") / "capture.bin"
    rng = np.random.default_rng(1)
    rows: list[Row] = []
    ends: list[int] = []
    with RecordingWriter(path) as writer:
        numbers = {name: writer.add_link(name, encoding) for name, encoding in links.items()}
        for index in range(60):
            stamp_ns = START_NS + index * 1_000_000
            for name, encoding in links.items():
                limits = (1, 90_000) if encoding == OCULUS else (0, 200)
                data = rng.bytes(int(rng.integers(*limits)))
                writer.write(numbers[name], data, stamp_ns)
                rows.append((name, encoding, stamp_ns, data))
                ends.append(writer.size_bytes)
    return Written(path, path.read_bytes(), rows, ends)
