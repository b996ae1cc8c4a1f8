"""A map with lost bricks is not saved: holes would look like water."""

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mapperd.api import OperationError
from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.daemon.daemon import Daemon
from mapperd.events import EventLog
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.queries import MapContent
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.store.stored_map import StoredMap
from tests.mapperd.store.dive import CONFIG, dive_on, open_store


class Persistence:
    """Has nothing to save; the file is `path`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.saves = 0

    def save(self) -> int:
        self.saves += 1
        return 1

    def whole(self) -> MapContent:
        return StoredMap(self.path, CONFIG)


@pytest.mark.parametrize("damaged", [False, True])
def test_a_map_with_lost_bricks_is_not_saved(tmp_path: Path, *, damaged: bool) -> None:
    path = tmp_path / "dive.map"
    sonar_map, store = open_store(path)
    with store:
        dive_on(sonar_map, store, 0, 20)
        store.save()
    if damaged:
        with closing(sqlite3.connect(path)) as file, file:
            file.execute("UPDATE brick SET crc = crc + 1 WHERE rowid = 1")
    daemon, kept = daemon_of(tmp_path, Persistence(path)), tmp_path / "maps" / "wall.ply"
    if damaged:
        with pytest.raises(OperationError, match="1 bricks of the map are damaged") as refused:
            asyncio.run(daemon.save("wall.ply", "test"))
        assert refused.value.reason == "cannot_write"
        assert not kept.exists()
        assert daemon.events.since(0)[0] == []
    else:
        assert asyncio.run(daemon.save("wall.ply", "test"))["path"] == str(kept)
        assert [one.code for one in daemon.events.since(0)[0]] == ["map_saved"]


def daemon_of(folder: Path, persistence: Persistence) -> Daemon:
    """A daemon of which only saving works."""
    live: Any = SimpleNamespace(
        persistence=persistence,
        poses=FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0))),
        control=None,
    )
    return Daemon(
        ConfigStore(Layered(CONFIG)),
        SonarMap(CONFIG),
        live,
        EventLog(lambda: 0),
        read=lambda: Layered(CONFIG),
        folder=folder / "maps",
    )
