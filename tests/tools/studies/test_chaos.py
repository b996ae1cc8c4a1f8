"""The story of a bad dive, and what it does to a process."""

import shutil
import subprocess
import sys
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import IO

import pytest
from studies.chaos.run import FAULTS, trouble
from studies.chaos.shim import Shim

CHILD = """
import os, sys, time
for _ in sys.stdin:
    try:
        os.write(os.open(sys.argv[1], os.O_WRONLY | os.O_APPEND | os.O_CREAT), b"x")
        wrote = "yes"
    except OSError as error:
        wrote = error.strerror
    print(int(time.time()), int(time.monotonic()), wrote, sep="|", flush=True)
"""


def test_a_story_is_sent_again_by_its_number() -> None:
    story = list(trouble(3, 600.0))
    assert story == list(trouble(3, 600.0))
    assert story != list(trouble(4, 600.0))


def test_everything_happens_and_ends_in_time() -> None:
    story = list(trouble(1, 600.0))
    assert {one.fault for one in story} == set(FAULTS)
    assert all(one.begin_s < one.end_s <= 600.0 for one in story)
    for fault in FAULTS:
        mine = [one for one in story if one.fault == fault]
        assert all(a.end_s <= b.begin_s for a, b in pairwise(mine))
    assert any(a.end_s > b.begin_s for a, b in pairwise(story))


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_a_process_sees_another_time_and_a_full_disk(tmp_path: Path) -> None:
    with closing(Shim(tmp_path)) as shim:
        command = [sys.executable, "-c", CHILD, str(tmp_path / "file")]
        pipe = subprocess.PIPE
        with subprocess.Popen(  # noqa: S603 our own words
            command, env=shim.environ, stdin=pipe, stdout=pipe, text=True
        ) as process:
            stated, reported = process.stdin, process.stdout
            assert stated is not None
            assert reported is not None

            def asked(
                stated: IO[str] = stated, reported: IO[str] = reported
            ) -> tuple[int, int, str]:
                stated.write("\n")
                stated.flush()
                unix, monotonic, wrote = reported.readline().strip().split("|")
                return int(unix), int(monotonic), wrote

            before = asked()
            shim.step_clock(3600.0)
            shim.fill_disk(full=True)
            during = asked()
            shim.step_clock(0.0)
            shim.fill_disk(full=False)
            after = asked()
    assert (before[2], during[2], after[2]) == ("yes", "No space left on device", "yes")
    assert 3590 < during[0] - before[0] < 3700
    assert during[1] - before[1] < 60
    assert after[0] - before[0] < 60
