"""Recordings for the tests: what was written, and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, RecordingWriter

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


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """Return a closed recording of several chunks: a stream in pieces, and odometry between."""
    path = tmp_path_factory.mktemp("recording") / "capture.bin"
    rng = np.random.default_rng(1)
    rows: list[Row] = []
    ends: list[int] = []
    with RecordingWriter(path) as writer:
        sonar = writer.add_link("sonar", OCULUS)
        odometry = writer.add_link("dvl", ODOMETRY_NATIVE)
        for index in range(60):
            stamp_ns = START_NS + index * 1_000_000
            for link, name, encoding, size in (
                (sonar, "sonar", OCULUS, int(rng.integers(1, 90_000))),
                (odometry, "dvl", ODOMETRY_NATIVE, int(rng.integers(0, 200))),
            ):
                data = rng.bytes(size)
                writer.write(link, data, stamp_ns)
                rows.append((name, encoding, stamp_ns, data))
                ends.append(writer.size_bytes)
    return Written(path, path.read_bytes(), rows, ends)
