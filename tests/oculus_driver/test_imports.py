"""What importing the driver costs."""

from __future__ import annotations

import subprocess
import sys

import oculus_driver

LISTING = "import sys, oculus_driver, oculus_driver.recording; print(*sys.modules, sep='\\n')"


def test_the_driver_needs_only_numpy_until_a_file_needs_more() -> None:
    command = [sys.executable, "-c", LISTING]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)  # noqa: S603 - our own words
    roots = {name.partition(".")[0] for name in done.stdout.split()}
    assert "numpy" in roots
    assert not roots & {
        "asyncio",
        "cv2",
        "mcap",
        "zstandard",
        "lz4",
        "sqlite3",
        "msgpack",
        "mapperd",
        "sonar_sim",
    }


def test_every_public_name_exists() -> None:
    assert all(hasattr(oculus_driver, name) for name in oculus_driver.__all__)
