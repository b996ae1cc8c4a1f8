"""Mapping one tile: the pings that touch it, in order, by the ordinary core."""

import contextlib
import time
from collections.abc import Iterator, Sequence
from typing import BinaryIO

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mapper_survey.errors import SurveyError
from mapper_survey.folder import Folder
from mapper_survey.order import PLACE, Key
from mapper_survey.records import Record, RecordReader
from mapper_survey.scratch import scratch
from mapperd.config.tree import Config
from mapperd.errors import MapperdError
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.maintenance import packed, write_whole

__all__ = ["SpooledDive", "TileResult", "TileTask", "map_tile"]


class SpooledDive(Struct, frozen=True):
    """A dive's spool: names of the file and of its mark, and tables that its records refer to."""

    spool: str
    mark: str
    bearings: list[bytes]


class TileTask(Struct, frozen=True):
    """One tile to be mapped.

    Attributes:
        shard: name of the file that it becomes.
        key, edge: of the tile.
        config: the settings.
        dives: that the pings are of.
        pings: as bytes of an array of `PLACE`, in order.
        folder: the survey's, as `Folder` takes it.
        most_bytes: that its voxels may take.
    """

    shard: str
    key: Key
    edge: int
    config: Config
    dives: list[SpooledDive]
    pings: bytes
    folder: str
    most_bytes: int


class TileResult(Struct, frozen=True):
    """What became of a tile.

    Attributes:
        shard: as asked.
        too_large: its voxels take more memory than they may, and nothing was kept.
        pings: that it was made of.
        bricks: in its shard.
        cpu_s, read_bytes, written_bytes: of the task.
        voxel_bytes: that it took at the end.
        most_bytes: that it might have taken.
    """

    shard: str
    too_large: bool
    pings: int
    bricks: int
    cpu_s: float
    read_bytes: int
    written_bytes: int
    voxel_bytes: int
    most_bytes: int


def map_tile(task: TileTask) -> TileResult:
    """Map a tile into its shard: a map's file that holds the tile alone.

    Revisions are those of the map of all: every ping counts, wherever it lies.

    Raises:
        SurveyError: a spool is damaged, and has no mark any more.
        OSError: the survey's folder cannot be read or written.
    """
    began_s = time.process_time()
    folder = Folder(task.folder)
    places = np.frombuffer(task.pings, dtype=PLACE)
    sonar_map = SonarMap(_single_threaded(task.config))
    sonar_map.core.limit_to_tile(task.key, task.edge)
    bricks = written = 0
    whole = _integrate(sonar_map, folder, task.dives, places, task.most_bytes)
    voxel_bytes = sonar_map.memory_bytes
    if whole:
        with scratch() as work:
            revision, found = sonar_map.core.bricks_since(0)
            bricks = write_whole(work / "shard.db", task.config, revision, packed(found))
            written = (work / "shard.db").stat().st_size
            folder.put(work / "shard.db", task.shard)
    return TileResult(
        shard=task.shard,
        too_large=not whole,
        pings=len(places),
        bricks=bricks,
        cpu_s=time.process_time() - began_s,
        read_bytes=int(places["size"].sum()),
        written_bytes=written,
        voxel_bytes=voxel_bytes,
        most_bytes=task.most_bytes,
    )


def _single_threaded(config: Config) -> Config:
    """Workers are what runs side by side; the map does not depend on it."""
    mapping = msgspec.structs.replace(config.mapping, threads=1)
    return msgspec.structs.replace(config, mapping=mapping)


def _integrate(
    sonar_map: SonarMap,
    folder: Folder,
    dives: Sequence[SpooledDive],
    places: NDArray[np.void],
    most_bytes: int,
) -> bool:
    """Replay the pings; False as soon as the voxels take too much memory.

    It is looked after each: one may bring hundreds of megabytes, and a look takes less than a
    hundredth of it.
    """
    with contextlib.ExitStack() as opened:
        for ordinal, ping in _pings(folder, dives, places, opened):
            sonar_map.core.raise_revision(ordinal - 1)
            sonar_map.integrate(*ping)
            if sonar_map.memory_bytes > most_bytes:
                return False
    return True


def _pings(
    folder: Folder,
    dives: Sequence[SpooledDive],
    places: NDArray[np.void],
    opened: contextlib.ExitStack,
) -> Iterator[tuple[int, Record]]:
    files: dict[int, tuple[BinaryIO, RecordReader]] = {}
    for ordinal, dive, size, offset in places.tolist():
        if dive not in files:
            file = opened.enter_context(folder.open(dives[dive].spool))
            files[dive] = file, RecordReader(dives[dive].bearings)
        file, reader = files[dive]
        file.seek(offset)
        try:
            record = reader.unpack(file.read(size))
        except MapperdError as error:
            folder.remove(dives[dive].mark)
            raise SurveyError(
                f"{dives[dive].spool}: {error}; the same command makes it anew"
            ) from error
        yield ordinal, record
