from pathlib import Path

import msgspec
import pytest
from mapper_survey.run_record import Kind, TaskTime, in_order, read_task_times


def task(name: str, *after: str, cpu_s: float = 1.0, kind: Kind = "tile") -> TaskTime:
    return TaskTime(kind=kind, name=name, cpu_s=cpu_s, read_bytes=5, written_bytes=6, after=after)


def test_tasks_come_after_those_that_they_wait_for_and_keep_their_order_otherwise() -> None:
    tasks = [task("merge", "b", "a"), task("b", "plan"), task("a", "plan"), task("plan")]
    assert [t.name for t in in_order(tasks)] == ["plan", "b", "a", "merge"]


def test_a_wait_that_is_named_twice_is_one_wait() -> None:
    assert len(in_order([task("plan"), task("tile", "plan", "plan")])) == 2


@pytest.mark.parametrize(
    ("tasks", "reported"),
    [
        ([task("a"), task("a")], "two tasks are called 'a'"),
        ([task("a", "b")], "'a' waits for 'b', which is not there"),
        ([task("a", "b"), task("b", "a")], "'a' waits for itself"),
        ([task("a", cpu_s=-1.0)], "negative or infinite"),
        ([task("a", cpu_s=float("inf"))], "negative or infinite"),
        ([task("a", cpu_s=float("nan"))], "negative or infinite"),
    ],
)
def test_tasks_that_make_no_sense_are_refused(tasks: list[TaskTime], reported: str) -> None:
    with pytest.raises(ValueError, match=reported):
        in_order(tasks)


def test_a_survey_is_read_whatever_else_it_reports(tmp_path: Path) -> None:
    path = tmp_path / "survey.json"
    tasks = [task("tile", "plan"), task("plan", kind="plan", cpu_s=0.25)]
    path.write_bytes(msgspec.json.encode({"version": 3, "tasks": tasks, "lost": []}))
    assert read_task_times(path) == [tasks[1], tasks[0]]


@pytest.mark.parametrize("text", ["", "{}", '{"tasks": [{"kind": "sort", "name": "a"}]}'])
def test_a_file_that_is_no_survey_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "survey.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"survey\.json: "):
        read_task_times(path)


def test_tasks_in_a_circle_are_reported_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "survey.json"
    path.write_bytes(msgspec.json.encode({"tasks": [task("a", "a")]}))
    with pytest.raises(ValueError, match=r"survey\.json: 'a' waits for itself"):
        read_task_times(path)
