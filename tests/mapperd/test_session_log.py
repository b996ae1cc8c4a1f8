from dataclasses import replace
from pathlib import Path
from typing import get_args

import msgspec
import pytest

from mapperd.session_log import (
    DECISIONS,
    LINK,
    ClockSet,
    Decision,
    Drop,
    Gap,
    GlobalLocalization,
    InitialPose,
    NewMap,
    NoMotionUpdate,
    Remarks,
    RemovedRemark,
    Reset,
    ResetFailed,
    Session,
    SetMap,
    Settings,
    Skip,
    chunk_of,
    decision_of,
    is_remark,
    remarks_in,
    without_skipped,
)
from oculus_driver.recording import OCULUS, Chunk

ALL: list[Decision] = [
    Session("a", "1.0", {"octree": {"voxel_resolution": 0.1}}, (0.1, 0, 0, 1, 0, 0, 0)),
    Session("a", "1.0", {}),
    Session("a", "1.0", {}, None, (1.0, 2.0, 0.5, 0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1), "abc"),
    Settings({"filtering.min_range": 0.1, "odometry.sources": []}, "SIGHUP"),
    Reset(1, "mapperctl"),
    ResetFailed(1),
    InitialPose(1, 1.0, -2.0, 0.5, (0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1), "map", "mqtt"),
    GlobalLocalization(2, "mapperctl"),
    NoMotionUpdate(3),
    NewMap(4, "/maps/harbour.yaml", "abc"),
    SetMap(5, "/maps/b.map", "abc", 1.0, -2.0, 0.5, (0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1), "map"),
    Gap("sonar"),
    Skip("sonar", 5),
    Drop(7),
    ClockSet(-3_600_000_000_000),
    RemovedRemark(),
]


@pytest.mark.parametrize("decision", ALL, ids=str)
def test_damaged_decision_is_none(decision: Decision) -> None:
    data = chunk_of(decision, 5).data
    for place in range(len(data)):
        damaged = data[:place] + b"\xff" + data[place + 1 :]
        decision_of(Chunk(LINK, DECISIONS, 0, damaged))  # no error, whatever it reads
    assert decision_of(Chunk(LINK, DECISIONS, 0, data[:-1])) is None


def bytes_of(data: bytes, link: str = "sonar") -> Chunk:
    return Chunk(link, OCULUS, 0, data)


@pytest.mark.parametrize("decision", ALL, ids=str)
def test_decision_comes_back_as_it_was(decision: Decision) -> None:
    chunk = chunk_of(decision, 5)
    assert decision_of(chunk) == decision
    assert isinstance(msgspec.msgpack.decode(chunk.data), dict)


@pytest.mark.parametrize("data", [b"", b"\xc1", b"\x80", msgspec.msgpack.encode({"kind": "new"})])
def test_what_cannot_be_understood_is_no_decision(data: bytes) -> None:
    assert decision_of(Chunk("mapperd", DECISIONS, 0, data)) is None


def test_damaged_remarks_and_skips_are_ignored() -> None:
    chunks = [
        replace(chunk_of(decision, 0), damaged=True)
        for decision in (Drop(3), ResetFailed(1), Skip("sonar", 2))
    ]
    assert remarks_in(chunks) == Remarks()
    found = list(without_skipped([*chunks, bytes_of(b"ab")]))
    assert found == [*chunks, bytes_of(b"ab")]


def test_other_links_hold_no_decisions() -> None:
    data = chunk_of(Drop(1), 0).data
    assert decision_of(bytes_of(data)) is None


def test_remarks_are_collected() -> None:
    chunks = [chunk_of(decision, 0) for decision in [*ALL, Drop(3)]]
    found = remarks_in([*chunks, bytes_of(b"x")])
    assert found == Remarks(frozenset({3, 7}), frozenset({1}))
    assert [is_remark(one) for one in ALL].count(True) == 4


@pytest.mark.parametrize("value", [0.1, None])
def test_remark_about_the_removed_error_bound_is_read_and_ignored(value: float | None) -> None:
    data = msgspec.msgpack.encode({"kind": "error_bound", "ping": 8, "value": value})
    chunk = Chunk("mapperd", DECISIONS, 0, data)
    decision = decision_of(chunk)
    assert decision == RemovedRemark()
    assert is_remark(decision)
    assert remarks_in([chunk]) == Remarks()


def test_skipped_bytes_are_left_out_however_they_were_cut() -> None:
    chunks = [
        bytes_of(b"ab"),
        chunk_of(Skip("sonar", 4), 0),
        bytes_of(b"cd"),
        bytes_of(b"other", "vehicle"),
        chunk_of(Skip("sonar", 1), 0),
        bytes_of(b"ef"),
        bytes_of(b"g"),
        bytes_of(b"h"),
    ]
    left = [chunk.data for chunk in without_skipped(chunks) if chunk.encoding == OCULUS]
    assert left == [b"ab", b"other", b"h"]


def test_every_kind_is_explained() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "recordings.md").read_text(
        "utf-8"
    )
    for kind in get_args(Decision):
        assert f"| `{kind.__struct_config__.tag}` |" in page
        assert {kind} <= {type(one) for one in ALL}
