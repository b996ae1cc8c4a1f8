"""The daemon dies while it maps at poses of the localization; the map is that of the recordings.

The vehicle stands in a room that is known, and its odometry thinks that it moves to and fro.
"""

import math
import os
import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.paths import pose_path
from mapperd.localization.saved_pose import load_pose
from mapperd.session.recordings import files_in, sessions_of
from tests.mapperd.localization.room import dive, pings, room, settings, write_room
from tests.mapperd.session.crash.client import Daemons, World
from tests.mapperd.session.crash.test_crash import (
    as_recorded,
    content,
    mid_session,
    recovered,
    settings_of,
    wait_for_bytes,
)

pytestmark = [pytest.mark.crash, pytest.mark.slow]

KILLS = int(os.environ.get("CRASH_KILLS", "50")) // 5


def swaying(k: int) -> tuple[float, float]:
    return 4.0 + 0.6 * math.sin(0.02 * k), 0.0


@pytest.fixture
def world() -> Iterator[World]:
    still = dive(2).truth[[0] * 100]
    world = World(list(pings(room(), still)), swaying)
    yield world
    world.close()


@pytest.fixture
def daemons(tmp_path: Path) -> Iterator[Daemons]:
    daemons = Daemons(tmp_path / "log")
    yield daemons
    daemons.close()


def text_of(world: World, folder: Path) -> str:
    ours = settings(write_room(folder), mapping="corrected").splitlines()
    theirs = settings_of(world, folder).splitlines()
    return "\n".join([*theirs, *ours[2:]]) + f"\nservice: {{state_folder: {folder}}}\n"


def wait_for_file(path: Path) -> None:
    until_s = time.monotonic() + 10
    while not path.exists() and time.monotonic() < until_s:
        time.sleep(0.01)


def test_map_at_corrected_poses_after_a_kill_is_that_of_the_recordings(
    tmp_path: Path, world: World, daemons: Daemons
) -> None:
    chance = random.Random(5)  # noqa: S311 for the instants
    kills = mid = mapped = saved = folders = gone_on = 0
    while kills < KILLS:
        folder = tmp_path / str(kills)
        folder.mkdir()
        text = text_of(world, folder)
        (folder / "live.yaml").write_text(text, encoding="utf-8")
        config = config_from_text(text)
        for _ in range(2):
            process = daemons.start("--config", folder / "live.yaml", "--out", folder / "out")
            wait_for_bytes(process, folder / "recordings", "*", chance.randint(100_000, 500_000))
            wait_for_file(pose_path(config, {}))  # on a loaded machine the first takes a while
            time.sleep(chance.uniform(0.1, 0.6))
            os.kill(process, signal.SIGKILL)
            assert daemons.ended() == -signal.SIGKILL
            kills += 1
        mid += mid_session(folder / "dive.map")
        folders += 1
        codes = [event.code for event in recovered(config).since(0)[0]]
        assert "not_recovered" not in codes
        reference, count = as_recorded(folder / "recordings")
        assert content(folder / "dive.map", config) == reference, f"{folder} {count} pings"
        mapped += count
        saved += load_pose(pose_path(config, {}), "map") is not None
        sessions = sessions_of(files_in([folder / "recordings"]))
        begun = [one for one in (session.beginning() for session in sessions) if one is not None]
        gone_on += any(one.saved_pose is not None for one in begun)
    assert mid >= folders / 2
    assert saved >= folders / 2
    assert gone_on >= folders / 2
    assert mapped > 5 * KILLS
