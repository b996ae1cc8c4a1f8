"""`oculus render`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oculus_driver.recording import OCULUS, RecordingWriter

if TYPE_CHECKING:
    from pathlib import Path

    from tests.oculus_driver.cli.conftest import Oculus


def test_every_ping_becomes_a_picture(oculus: Oculus, capture_path: Path, tmp_path: Path) -> None:
    result = oculus("render", capture_path, tmp_path / "out", "--height", "300", "--json")
    assert result.code == 0
    (facts,) = result.facts
    assert facts["pings"] == 3
    names = [f"00000{index}_ping_{415323 + index}.png" for index in range(3)]
    assert facts["files"] == [str(tmp_path / "out" / name) for name in names]
    for name in facts["files"]:
        picture = cv2.imread(name)
        assert picture is not None
        assert picture.shape[0] == 300


def test_one_ping_becomes_one_picture(oculus: Oculus, capture_path: Path, tmp_path: Path) -> None:
    out = tmp_path / "one.png"
    result = oculus("render", capture_path, out, "--ping", "415324")
    assert (result.code, result.out) == (0, f"1 pings drawn: {out}\n")
    assert oculus("render", capture_path, out, "--ping", "7").code == 1


def test_detections_are_marked(oculus: Oculus, capture_path: Path, tmp_path: Path) -> None:
    plain, some, most = (tmp_path / name for name in ("plain.png", "some.png", "most.png"))
    oculus("render", capture_path, plain, "--bare")
    assert oculus("render", capture_path, some, "--bare", "--detections").code == 0
    assert oculus("render", capture_path, most, "--bare", "--detections", "4").code == 0
    before, *after = (np.asarray(cv2.imread(str(path))) for path in (plain, some, most))
    marked = [np.count_nonzero(picture != before) for picture in after]
    assert 0 < marked[0] < marked[1]
    assert oculus("render", capture_path, some, "--detections", "0").code == 2


def test_a_film_runs_as_fast_as_it_was_recorded(
    oculus: Oculus, capture: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "dive.mcap"
    with RecordingWriter(path) as writer:
        link = writer.add_link("sonar", OCULUS)
        for index in range(3):
            writer.write(link, capture[182016 * index :][:182016], 10**18 + 250_000_000 * index)
    assert oculus("render", path, tmp_path / "a.mp4", "--height", "200").code == 0
    assert oculus("render", path, tmp_path / "b.mp4", "--height", "200", "--every", 2).code == 0
    for name, facts in (("a.mp4", (4.0, 3.0)), ("b.mp4", (2.0, 2.0))):
        film = cv2.VideoCapture(str(tmp_path / name))
        assert (film.get(cv2.CAP_PROP_FPS), film.get(cv2.CAP_PROP_FRAME_COUNT)) == facts
        film.release()


def test_some_pings_can_be_chosen(oculus: Oculus, capture_path: Path, tmp_path: Path) -> None:
    words = ("render", capture_path, tmp_path / "o", "--height", "200", "--json")
    assert "415324" in oculus(*words, "--first", "1", "--limit", "1").facts[0]["files"][0]
    assert len(oculus(*words, "--every", "2").facts[0]["files"]) == 2


@pytest.mark.parametrize("words", [("--height", "0"), ("--gamma", "nan"), ("--ping", "x"), ()])
def test_what_cannot_be_is_one_line(oculus: Oculus, tmp_path: Path, words: tuple[str, ...]) -> None:
    result = oculus("render", tmp_path / "missing.raw", tmp_path / "o", *words)
    assert result.code == (2 if words else 66)
    assert result.err.startswith("oculus")
    assert result.err.count("\n") == 1
    assert "Traceback" not in result.err


def test_a_failure_is_json_too(oculus: Oculus, tmp_path: Path) -> None:
    (facts,) = oculus("render", tmp_path / "no.raw", tmp_path / "o", "--json").facts
    assert facts.keys() == {"error"}
    assert facts["error"].startswith(f"{tmp_path / 'no.raw'}: ")
