"""`oculus convert`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from tests.oculus_driver.cli.conftest import Oculus


@pytest.mark.parametrize("suffix", [".mcap", ".oculus", ".pcap"])
def test_there_and_back_is_the_same_stream(
    oculus: Oculus, capture_path: Path, capture: bytes, tmp_path: Path, suffix: str
) -> None:
    there, back = tmp_path / f"a{suffix}", tmp_path / "back.raw"
    assert oculus("convert", capture_path, there).code == 0
    assert oculus("convert", there, back).code == 0
    assert back.read_bytes() == capture


def test_data_the_format_cannot_hold_are_reported(
    oculus: Oculus, capture: bytes, tmp_path: Path
) -> None:
    (tmp_path / "a.raw").write_bytes(capture[:182016] + b"noise" + capture[182016:])
    (facts,) = oculus("convert", tmp_path / "a.raw", tmp_path / "a.oculus", "--json").facts
    assert facts["left_out"] == {"no_message": 5}
    assert facts["target_format"] == "oculus-log"


def test_a_file_that_exists_is_kept_unless_asked(
    oculus: Oculus, capture_path: Path, tmp_path: Path
) -> None:
    out = tmp_path / "a.mcap"
    out.write_bytes(b"mine")
    assert oculus("convert", capture_path, out).code == 73
    assert out.read_bytes() == b"mine"
    assert oculus("convert", capture_path, out, "--overwrite").code == 0


def test_a_name_that_has_no_known_format_is_one_line(
    oculus: Oculus, capture_path: Path, tmp_path: Path
) -> None:
    result = oculus("convert", capture_path, tmp_path / "a.xyz")
    assert (result.code, result.err.count("\n")) == (2, 1)
    assert oculus("convert", capture_path, tmp_path / "a.xyz", "--format", "pcap").code == 0
