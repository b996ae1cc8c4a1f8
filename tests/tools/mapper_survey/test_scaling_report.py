"""The scaling report, from the records of runs to its files."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mapper_survey.command import main
from mapper_survey.run_record import TaskTime


def survey_json(path: Path, wall_s: float, slower: float = 1.0) -> Path:
    tasks = [
        TaskTime(
            kind="plan", name="plan/a", cpu_s=2.0 * slower, read_bytes=4_000_000, written_bytes=0
        ),
        *(
            TaskTime(
                kind="tile",
                name=f"tile/{k}",
                cpu_s=1.0 * slower,
                read_bytes=1_000_000,
                written_bytes=500_000,
                after=("plan/a",),
            )
            for k in range(6)
        ),
        TaskTime(
            kind="merge",
            name="merge",
            cpu_s=0.5,
            read_bytes=3_000_000,
            written_bytes=3_000_000,
            after=tuple(f"tile/{k}" for k in range(6)),
        ),
    ]
    reported = {"wall_s": {"plan": wall_s / 4, "tiles": wall_s * 3 / 4}, "tasks": tasks, "pings": 8}
    path.write_bytes(msgspec.json.encode(reported))
    return path


def report(tmp_path: Path, *words: str) -> int:
    return main(["scaling", *words, "--out", str(tmp_path / "out")])


@pytest.fixture(name="out", scope="module")
def out_fixture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a report on runs with one and two workers, on slow storage."""
    folder = tmp_path_factory.mktemp("scaling")
    one, two = survey_json(folder / "1", 10.0), survey_json(folder / "2", 6.25, 1.2)
    words = (f"2={two}", f"1={one}", "--workers", "1", "10", "--scheduler-ms", "0")
    assert report(folder, *words, "--storage-mb-per-s", "8", "--link-mb-per-s", "0") == 0
    return folder / "out"


@pytest.fixture(name="record", scope="module")
def record_fixture(out: Path) -> dict[str, Any]:
    reported: dict[str, Any] = json.loads((out / "scaling.json").read_text())
    return reported


def test_measured_runs_stand_beside_their_simulation(record: dict[str, Any]) -> None:
    one, two = record["measured"]
    assert (one["workers"], one["wall_s"], one["speedup"]) == (1, 10.0, 1.0)
    assert one["simulated_s"] == pytest.approx(8.5)
    assert two["speedup"] == pytest.approx(1.6)
    assert two["cpu_s"] == pytest.approx(8.0 * 1.2 + 0.5)
    assert two["simulated_s"] == pytest.approx(2.0 + 3.0 + 0.5)


def test_tasks_are_summed_by_kind(record: dict[str, Any]) -> None:
    assert record["kinds"]["tile"] == {
        "tasks": 6,
        "cpu_s": 6.0,
        "longest_s": 1.0,
        "read_bytes": 6_000_000,
        "written_bytes": 3_000_000,
    }


def test_shared_storage_is_in_the_simulated_steps_alone(record: dict[str, Any]) -> None:
    one, ten = record["steps"]
    assert one["wall_s"] == pytest.approx(8.5 + 19 / 8)
    assert ten["wall_s"] == pytest.approx(2.0 + 1.0 + 0.5 + 19 / 8)
    assert ten["bottleneck"] == "storage"
    assert ten["saved"]["storage"] == pytest.approx(19 / 8 / ten["wall_s"])
    assert (record["storage_bytes_per_s"], record["link_bytes_per_s"]) == (8e6, None)


def test_the_tables_and_the_picture_are_there(out: Path, record: dict[str, Any]) -> None:
    table = (out / "scaling.md").read_text()
    assert "| tile | 6 | 6.0 | 1.00 | 6 | 3 |" in table
    assert "| 2 | 6.2 | 5.5 | 1.60 | 10.1 |" in table
    assert f"| 10 | 5.9 | {record['steps'][1]['speedup']:.1f} |" in table
    assert (out / "scaling.png").read_bytes().startswith(b"\x89PNG")
    files = ["scaling.json", "scaling.md", "scaling.png"]
    assert sorted(path.name for path in out.iterdir()) == files


@pytest.mark.parametrize("word", ["survey.json", "0=survey.json", "two=survey.json"])
def test_a_run_without_its_workers_is_refused(
    tmp_path: Path, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        report(tmp_path, word)
    assert "allowed:" in capsys.readouterr().err


def test_a_file_that_is_no_record_is_one_line_and_a_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "survey.json"
    path.write_text('{"tasks": []}')
    assert report(tmp_path, f"1={path}") == 2
    assert report(tmp_path, f"1={tmp_path / 'none'}") == 2
    stated = capsys.readouterr().err.splitlines()
    assert len(stated) == 2
    assert "no record of a survey" in stated[0]
