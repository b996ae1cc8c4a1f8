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
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest

from mapperd.cli.replay import _replayed
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import ReplayError
from mapperd.events import EventLog
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
STATEMENTS = frozenset({"sessions_not_mapped", "recording_damaged", "store_damaged"})
"""Codes of the events that say that a recording is not in the map."""

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


def only_what_was_recorded(whole: Path, left: Path, headless: frozenset[str]) -> bool:
    """Whether the undamaged pieces of each surviving file are those that were recorded.

    Files without a beginning have no pieces with a checksum, and are not mapped.
    """
    for path in sorted(path for path in left.glob("*") if path.name not in headless):
        try:
            with open_recording(path) as cut, open_recording(whole / path.name) as recording:
                pieces = ((chunk.link, chunk.data) for chunk in recording)
                kept = ((chunk.link, chunk.data) for chunk in cut if not chunk.damaged)
                if not all(piece in pieces for piece in kept):  # in order
                    return False
        except RecordingError:
            continue
    return True


@dataclass(frozen=True)
class Reference:
    """What the recordings in a folder are worth.

    Attributes:
        sha256: fingerprint of the map of the sessions whose beginning is readable.
        pings: their number.
        headless: files that are not readable, or of a session without a beginning.
    """

    sha256: str
    pings: int
    headless: frozenset[str]


def recorded(folder: Path, config: Config) -> Reference:
    """Map what is readable in a folder."""
    files, headless = [], set()
    for path in files_in([folder], begun=True) if folder.exists() else []:
        try:
            sessions_of([path])
            files.append(path)
        except RecordingError:
            headless.add(path.name)
    sonar_map, pings, runs = SonarMap(config), 0, []
    for session in sessions_of(files):
        try:
            runs.append(as_recorded(session))
        except ReplayError:
            headless |= {path.name for path in session.paths}
    if runs:
        with closing(TrajectoryWriter(folder)) as trajectory:
            summary = _replayed(runs, sonar_map, Window(), trajectory)(sonar_map)
            pings = summary["pings_total"]
    return Reference(sonar_map.sha256(), pings, frozenset(headless))


def is_named(name: str, whole: Path, events: EventLog) -> bool:
    """Whether a start said that a file, or its session, is not in the map."""
    with open_recording(whole / name) as recording:
        session = recording.metadata["session"]
    texts = [event.text for event in events.since(0)[0] if event.code in STATEMENTS]
    return any(name in text or session in text for text in texts)


def check(folder: Path, config: Config) -> Reference:
    """Start on what a power cut left; the map is that of the recordings, or the start says why not.

    Args:
        folder: with what was `left`, the same as it was `cut`, what was `synced`, and all that was
            recorded, `uncut`.
        config: settings of `left`.
    """
    left, whole = folder / "disk", folder / "uncut" / "recordings"
    events = recovered(config)
    found, least = (recorded(folder / of / "recordings", config) for of in ("disk", "synced"))
    assert found.pings >= least.pings
    assert only_what_was_recorded(whole, folder / "cut" / "recordings", found.headless)
    unsaid = [name for name in found.headless if not is_named(name, whole, events)]
    # What was synced of a file without a statement is its name at most.
    assert not any(has_pieces(folder / "synced" / "recordings" / name) for name in unsaid), unsaid
    if content(left / "dive.map", config) != found.sha256:
        assert found.headless, f"{found.pings} pings"
        assert not unsaid, f"{found.pings} pings, nothing said of {unsaid}"
    return found


def has_pieces(path: Path) -> bool:
    """Whether a recording holds an undamaged piece."""
    try:
        with open_recording(path) as recording:
            return any(not chunk.damaged for chunk in recording)
    except (RecordingError, FileNotFoundError):
        return False


def test_a_recording_that_lost_its_beginning_is_named(
    tmp_path: Path, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    dive(world, tmp_path, random.Random(SEED))  # noqa: S311 for the instants
    config = config_from_text(settings_of(world, tmp_path / "disk"))

    def lose_a_beginning() -> None:
        for name in ("disk", "cut", "synced"):
            shutil.rmtree(tmp_path / name, ignore_errors=True)
            shutil.copytree(tmp_path / "uncut", tmp_path / name)
        for name in ("disk", "cut"):
            first = min((tmp_path / name / "recordings").iterdir())
            with first.open("r+b") as file:
                file.write(bytes(4096))
            for path in (tmp_path / name).glob("dive.map*"):
                path.unlink()
        for path in (tmp_path / "synced" / "recordings").iterdir():
            path.write_bytes(b"")

    lose_a_beginning()
    assert len(check(tmp_path, config).headless) == 1
    monkeypatch.setattr(f"{__name__}.STATEMENTS", frozenset())
    lose_a_beginning()
    assert len(check(tmp_path, config).headless) == 1  # nothing of it was synced, and no map has it
    lose_a_beginning()
    shutil.copytree(tmp_path / "uncut", tmp_path / "synced", dirs_exist_ok=True)
    with pytest.raises(AssertionError):
        check(tmp_path, config)


def test_map_after_a_power_cut_is_that_of_the_recordings(tmp_path: Path, world: World) -> None:
    chance = random.Random(SEED)  # noqa: S311 for the instants
    mapped = headless = tried = 0
    faults: list[str] = []
    while tried < CUTS:
        number, cuts = tried, min(CUTS_OF_A_DIVE, CUTS - tried)
        folder = tmp_path / str(number)
        changes = dive(world, folder, chance)
        disk, left, synced = Disk(), folder / "disk", folder / "synced"
        config = config_from_text(settings_of(world, left))
        instants = sorted(chance.randrange(len(changes)) for _ in range(cuts))
        for before, instant in pairwise([0, *instants]):
            for change in changes[before:instant]:
                disk.apply(change)
            for target, survival in ((left, None), (synced, Survival.SYNCED)):
                target.mkdir()
                disk.cut(chance, target, survival)
            shutil.copytree(left, folder / "cut")
            try:
                found = check(folder, config)
                mapped += found.pings
                headless += bool(found.headless)
            except Exception as error:  # noqa: BLE001 every cut is tried
                faults.append(f"dive {number}, change {instant}: {type(error).__name__}: {error}")
                shutil.copytree(folder / "cut", folder / f"fault-{instant}-{len(faults)}")
            finally:
                for target in (left, synced, folder / "cut"):
                    shutil.rmtree(target)
        tried += cuts
        progress = f"{tried} cuts, {mapped} pings, {headless} with a recording without beginning"
        print(f"{progress}, {len(faults)} faults")  # noqa: T201
    assert not faults, "\n".join([f"{len(faults)} of {CUTS} cuts:", *faults])
    assert mapped > CUTS
