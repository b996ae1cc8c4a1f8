"""The power fails at any instant; what the next start maps is what the disk has of the recording.

A kill loses nothing that was written. A power cut loses any part of what was not synced:
tests/support/power_cut is the model. `make power-cuts` does it 500 times.
"""

import os
import random
import shutil
import signal
from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest

from mapperd.cli.replay import _mapped
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import ReplayError
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.mapping.sonar_map import SonarMap
from mapperd.session.recordings import files_in, sessions_of
from mapperd.session.replay import Window, as_recorded
from oculus_driver.errors import RecordingError
from oculus_driver.recording import open_recording
from tests.mapperd.session.crash.client import Daemons, World
from tests.mapperd.session.crash.test_crash import (
    content,
    recovered,
    settings_of,
    wait_for_bytes,
)
from tests.support.power_cut.disk import Change, Disk, DiskLog, Survival, read_changes

pytestmark = pytest.mark.crash

CUTS = int(os.environ.get("POWER_CUTS", "40"))
CUTS_OF_A_DIVE = 20
SEED = int(os.environ.get("POWER_CUTS_SEED", "5"))


@pytest.fixture
def world() -> Iterator[World]:
    world = World()
    yield world
    world.close()


def dive(world: World, folder: Path, chance: random.Random) -> list[Change]:
    """Let one to three daemons map into a folder; return the changes of its files."""
    disk = folder / "disk"
    disk.mkdir(parents=True)
    log = DiskLog(disk, folder)
    (folder / "live.yaml").write_text(settings_of(world, disk), encoding="utf-8")
    daemons = Daemons(folder / "log", log.environ)
    for _ in range(chance.randint(1, 3)):
        process = daemons.start("--config", folder / "live.yaml", "--out", disk / "out")
        assert wait_for_bytes(process, disk / "recordings", "*", chance.randint(20_000, 600_000))
        end = signal.SIGKILL if chance.random() < 0.7 else signal.SIGTERM
        os.kill(process, end)
        assert daemons.ended() == (-end if end is signal.SIGKILL else 0)
        log.complete()
    daemons.close()
    shutil.move(disk, folder / "uncut")
    return list(read_changes(log.path))


def only_what_was_recorded(whole: Path, left: Path) -> bool:
    """Whether the undamaged pieces of each surviving file are those that were recorded."""
    for path in sorted(left.glob("*")):
        try:
            with open_recording(path) as cut, open_recording(whole / path.name) as recording:
                pieces = ((chunk.link, chunk.data) for chunk in recording)
                kept = ((chunk.link, chunk.data) for chunk in cut if not chunk.damaged)
                if not all(piece in pieces for piece in kept):  # in order
                    return False
        except RecordingError:
            continue
    return True


def recorded(folder: Path, config: Config) -> tuple[str, int] | None:
    """The map of the sessions in a folder, and their pings; None if a beginning is lost.

    The map file repeats a session's settings. So the daemon may map what this cannot.
    """
    sonar_map, pings = SonarMap(config), 0
    try:
        files = files_in([folder], begun=True) if folder.exists() else []
        runs = [as_recorded(session) for session in sessions_of(files)]
    except (RecordingError, ReplayError):
        return None
    if runs:
        with closing(TrajectoryWriter(folder)) as trajectory:
            pings = _mapped(runs, sonar_map, Window(), trajectory)["pings_total"]
    return sonar_map.sha256(), pings


def test_map_after_a_power_cut_is_that_of_the_recordings(tmp_path: Path, world: World) -> None:
    chance = random.Random(SEED)  # noqa: S311 for the instants
    mapped = headless = 0
    faults: list[str] = []
    for number in range(0, CUTS, CUTS_OF_A_DIVE):
        folder = tmp_path / str(number)
        changes = dive(world, folder, chance)
        disk, left, synced = Disk(), folder / "disk", folder / "synced"
        config = config_from_text(settings_of(world, left))
        instants = sorted(chance.randrange(len(changes)) for _ in range(CUTS_OF_A_DIVE))
        for before, instant in pairwise([0, *instants]):
            for change in changes[before:instant]:
                disk.apply(change)
            for target, survival in ((left, None), (synced, Survival.SYNCED)):
                target.mkdir()
                disk.cut(chance, target, survival)
            shutil.copytree(left, folder / "cut")
            try:
                recovered(config)
                found, least = (recorded(f / "recordings", config) for f in (left, synced))
                if found is None:
                    headless += 1
                    continue
                assert least is None or found[1] >= least[1]
                assert only_what_was_recorded(
                    folder / "uncut" / "recordings", folder / "cut" / "recordings"
                )
                assert content(left / "dive.map", config) == found[0], f"{found[1]} pings"
                mapped += found[1]
            except Exception as error:  # noqa: BLE001 every cut is tried
                faults.append(f"dive {number}, change {instant}: {type(error).__name__}: {error}")
                shutil.copytree(folder / "cut", folder / f"fault-{instant}-{len(faults)}")
            finally:
                for target in (left, synced, folder / "cut"):
                    shutil.rmtree(target)
        progress = f"{number + CUTS_OF_A_DIVE} cuts, {mapped} pings, {headless} without beginning"
        print(f"{progress}, {len(faults)} faults")  # noqa: T201
    assert not faults, "\n".join([f"{len(faults)} of {CUTS} cuts:", *faults])
    assert mapped > CUTS
    assert headless <= CUTS // 20
