"""`oculus info`."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from tests.oculus_driver.cli.conftest import Oculus


def test_json_reports_every_ping(oculus: Oculus, capture_path: Path) -> None:
    (facts,) = oculus("info", capture_path, "--json").facts
    wanted = {"format": "oculus-raw", "messages": 3, "pings": 3, "bytes_rejected": 0, "rejects": {}}
    assert wanted.items() <= facts.items()
    first = facts["ping_list"][0]
    shape = (first["id"], first["rows"], first["beams"], first["range_m"], first["frequency_hz"])
    assert shape == (415323, 703, 256, 1.9980588466688405, 2098880.5970149254)


def test_text_has_a_histogram_of_rejects(oculus: Oculus, capture: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.raw"
    path.write_bytes(capture[:182016] + b"noise" + capture[182016:] + capture[:5000])
    result = oculus("info", path, "--pings")
    assert result.code == 0
    lines = result.out.splitlines()
    assert "messages: 3, valid pings: 3" in lines
    assert "  3 x 703 rows x 256 beams, 8 bit, 2.00 m, 2.099 MHz" in lines
    assert any(line.split()[:2] == ["truncated", "1"] and line.endswith("#") for line in lines)
    assert lines[-1].split()[0] == "415325"


def test_what_is_no_recording_is_one_line(oculus: Oculus, tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(100))
    result = oculus("info", tmp_path / "a")
    assert (result.code, result.out, result.err.count("\n")) == (65, "", 1)
