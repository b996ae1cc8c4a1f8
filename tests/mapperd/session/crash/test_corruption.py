"""One byte of the map file, its log or a recording changes: the map is right, or what is missing is
stated.

`make crash-soak` does it 1000 times.
"""

import os
import random
import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from mapperd.cli import mapperd as cli
from mapperd.cli.arguments import parse_arguments
from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.daemon.run import store_facts
from mapperd.errors import MapperdError
from mapperd.events import EventLog
from mapperd.mapping.queries import MapContent
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.recordings import Tail, files_of
from mapperd.session.recovery import StoredSession, map_rest
from mapperd.session.startup import open_map
from mapperd.session_log import remarks_in
from mapperd.store.map_files import map_in
from mapperd.store.position import RecordingOffset, position_in
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore
from oculus_driver.command_line import ExitCode
from tests.mapperd.session.crash.test_startup import config_of, mapped, record, reference

pytestmark = pytest.mark.crash

CORRUPTIONS = int(os.environ.get("CRASH_CORRUPTIONS", "24"))

STATED = {
    "bricks_lost",
    "not_recovered",
    "recording_damaged",
    "sessions_not_mapped",
    "store_damaged",
}
"""Events that state that something is missing."""


@dataclass
class Scenes:
    """Folders as a daemon left them.

    Attributes:
        work: the folder to work in, which the settings name.
        copies: by name.
        expected: fingerprint of the map that the next start makes of each.
    """

    work: Path
    copies: dict[str, Path]
    expected: str

    def lay(self, name: str) -> None:
        """Put a copy in place."""
        shutil.rmtree(self.work, ignore_errors=True)
        shutil.copytree(self.copies[name], self.work)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Scenes:
    """After a clean end, in the middle of a session, and after a clean end without recordings."""
    folder = tmp_path_factory.mktemp("scenes")
    work = folder / "work"
    work.mkdir()
    config = config_of(work)
    record(config, 1, "a", range(15))
    record(config, 2, "b", range(10, 25))
    mapped(config, "a")
    shutil.copytree(work, folder / "before")
    leave_in_the_middle(config, "b")
    scenes = Scenes(work, {}, reference(config, "a", "b"))
    work.rename(folder / "in the middle")
    shutil.copytree(folder / "before", work)
    mapped(config, "b")
    shutil.copytree(work, folder / "clean end")
    shutil.rmtree(work / "recordings")
    work.rename(folder / "without recordings")
    for name in ("in the middle", "clean end", "without recordings"):
        scenes.copies[name] = folder / name
    return scenes


def leave_in_the_middle(config: Config, session: str) -> None:
    """Map half a session, and leave the files as a kill does: with a write-ahead log."""
    path = Path(config.outofcore.map_path)
    sonar_map = SonarMap(config)
    store = TileStore(path, sonar_map, tile_size_m=6.4, cache_tiles=2)
    files = files_of(Path(config.recording.folder), session)
    stored = StoredSession(store, sonar_map, session, None, position_in(store.position), 3600.0)
    remarks = remarks_in(Tail(files, RecordingOffset()))
    steps = map_rest(stored, OdometryPoses(config), Tail(files, RecordingOffset()), remarks)
    for count, _ in enumerate(steps):
        if count % 10 == 0:
            store.save()
        if count == 25:
            break
    left = {name: path.with_name(name).read_bytes() for name in ("dive.map", "dive.map-wal")}
    steps.close()
    store.close()
    for name, data in left.items():
        path.with_name(name).write_bytes(data)


def files_in(folder: Path) -> Iterator[Path]:
    yield from sorted(folder.glob("dive.map*"))
    yield from sorted(folder.glob("recordings/*"))


def outcome(folder: Path) -> tuple[str, set[str], int]:
    """Start in a folder; return the fingerprint of the map, what was stated, and the exit code."""
    events = EventLog(lambda: 0)
    try:
        opened = open_map(config_of(folder), "new", events, {}, lambda: 1.0)
        try:
            with closing(opened.persistence.whole()) as whole:
                sha256, lost = whole.sha256(), whole.bricks_lost
                code = exit_code(opened.persistence.status(), whole)
        finally:
            opened.close()
    except MapperdError as error:
        return "", {str(error)}, ExitCode.CANNOT_WRITE
    stated = {event.code for event in events.since(0)[0]} & STATED
    return sha256, stated | ({"lost"} if lost else set()), code


def exit_code(stored: dict[str, Any] | None, whole: MapContent) -> int:
    """Return the exit code of a run that maps nothing more; it prints its result line."""
    assert stored is not None
    summary = {
        "store": store_facts(stored, whole),
        "pings_mapped": 0,
        "pings_total": 0,
        "pings_dropped": {},
        "wall_s": 1.0,
        "voxels_occupied": 0,
        "live": {"told_to_stop": True},
        "config": {"localization": {"mapping": "as_given"}},
    }
    return int(cli._verdict(parse_arguments([]), summary))


def test_a_changed_byte_is_repaired_or_stated(
    scenes: Scenes, capsys: pytest.CaptureFixture[str]
) -> None:
    chance = random.Random(int(os.environ.get("CRASH_SEED", "14")))  # noqa: S311 for the places
    names = list(scenes.copies)
    for name in names:
        scenes.lay(name)
        assert outcome(scenes.work) == (scenes.expected, set(), ExitCode.OK)
    capsys.readouterr()
    silent, right, named = [], 0, 0
    for number in range(CORRUPTIONS):
        name = names[number % len(names)]
        scenes.lay(name)
        place = corrupt(scenes.work, chance)
        try:
            fingerprint, stated, code = outcome(scenes.work)
        except Exception as error:  # noqa: BLE001 all are listed
            silent.append(f"{number}, {name}, {place}: {error!r}")
            continue
        lines = capsys.readouterr().err
        if fingerprint != scenes.expected and not stated:
            silent.append(f"{number}, {name}, {place}: another map, and nothing is stated")
        elif fingerprint != scenes.expected and code == ExitCode.OK:
            silent.append(f"{number}, {name}, {place}: {stated}, and the run counts as done")
        elif fingerprint not in ("", scenes.expected) and "dive.map" not in lines:
            silent.append(f"{number}, {name}, {place}: the result lines do not name the loss")
        right += fingerprint == scenes.expected
        named += bool(stated)
    counts = f"{right} right maps, {named} with a statement, {len(silent)} silent"
    print(f"{CORRUPTIONS} changed bytes: {counts}")  # noqa: T201
    assert silent == []
    assert right > CORRUPTIONS / 3


def map_of_source(path: Path) -> str:
    with closing(map_in(path, Config()).map) as whole:
        return whole.sha256()


def map_of_reader(path: Path) -> str:
    with StoreReader(path) as reader:
        sonar_map = SonarMap(with_values(Config(), reader.kind()))
        loaded = reader.load(sonar_map)
    return sonar_map.sha256() if not loaded.lost else ""


def test_readers_of_a_changed_file_return_the_right_map_or_refuse(scenes: Scenes) -> None:
    chance = random.Random(int(os.environ.get("CRASH_SEED", "14")))  # noqa: S311 for the places
    path = scenes.work / "dive.map"
    scenes.lay("clean end")
    sound = path.read_bytes()
    assert map_of_source(path) == map_of_reader(path) == scenes.expected
    silent, right, refused = [], 0, 0
    for number in range(10 * CORRUPTIONS):
        data = bytearray(sound)
        at = place_in(data, chance, number % 3)
        data[at] ^= chance.randrange(1, 256)
        path.write_bytes(data)
        for read in (map_of_source, map_of_reader):
            try:
                fingerprint = read(path)
            except MapperdError:
                fingerprint = ""
            except Exception as error:  # noqa: BLE001 all are listed
                fingerprint = repr(error)
            right += fingerprint == scenes.expected
            refused += not fingerprint
            if fingerprint not in (scenes.expected, ""):
                silent.append(f"byte {at}, {read.__name__}: {fingerprint}")
    print(f"readers: {right} right maps, {refused} refusals, {len(silent)} silent")  # noqa: T201
    assert silent == []
    assert right
    assert refused


def place_in(data: bytearray, chance: random.Random, where: int) -> int:
    """Choose a byte of any page, of the header of a page, or of the pages of the settings."""
    page = int.from_bytes(data[16:18], "big")
    if where == 0:
        return chance.randrange(len(data))
    if where == 1:
        return chance.randrange(1, len(data) // page) * page + chance.randrange(12)
    used = [at for at in range(page, 3 * page) if data[at]]
    return chance.choice(used)


def corrupt(folder: Path, chance: random.Random) -> str:
    """Change one byte of one file; return which."""
    path = chance.choice([one for one in files_in(folder) if one.stat().st_size])
    data = bytearray(path.read_bytes())
    at = chance.randrange(len(data))
    data[at] ^= chance.randrange(1, 256)
    path.write_bytes(data)
    return f"byte {at} of {path.name}"
