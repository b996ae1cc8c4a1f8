"""Merges shards to one map's file by copying their rows."""

import contextlib
import time
from collections.abc import Callable, Generator, Sequence

from msgspec import Struct

from mapper_survey.errors import SurveyError
from mapper_survey.folder import Folder, crc_of, scratch
from mapper_survey.tiles import shard_mark
from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.store.maintenance import write_whole
from mapperd.store.reader import StoreReader
from mapperd.store.tiles import BrickRow

__all__ = ["MergeResult", "MergeTask", "merge_shards"]

Show = Callable[[float, int], None]


class MergeTask(Struct, frozen=True):
    """Shards to be merged.

    Attributes:
        name: name of the map's file.
        shards: shards of disjoint tiles.
        config: the settings.
        revision: revision of the merged map.
        folder: the survey's folder, as for `Folder`.
    """

    name: str
    shards: list[str]
    config: Config
    revision: int
    folder: str


class MergeResult(Struct, frozen=True):
    """Result of a merge; `crc` is that of the file."""

    name: str
    bricks: int
    cpu_s: float
    read_bytes: int
    written_bytes: int
    crc: int


def merge_shards(task: MergeTask, show: Show) -> MergeResult:
    """Merge files to one; memory holds one brick.

    Args:
        task: the shards.
        show: receives the share of finished shards, and their number.

    Raises:
        SurveyError: a shard is damaged; its mark is removed.
        StoreError: two shards hold the same brick.
        OSError: the survey's folder cannot be read or written.
    """
    began_s = time.process_time()
    folder = Folder(task.folder)
    with scratch() as work:
        path = work / "map.db"
        rows = _rows(folder, task.shards, show)
        with contextlib.closing(rows):
            bricks = write_whole(path, task.config, task.revision, rows)
        written = path.stat().st_size
        with path.open("rb") as file:
            crc = crc_of(file)
        folder.put(path, task.name)
    return MergeResult(
        name=task.name,
        bricks=bricks,
        cpu_s=time.process_time() - began_s,
        read_bytes=sum(folder.size_of(shard) for shard in task.shards),
        written_bytes=written,
        crc=crc,
    )


def _rows(folder: Folder, shards: Sequence[str], show: Show) -> Generator[BrickRow]:
    for number, shard in enumerate(shards, 1):
        try:
            with folder.fetched(shard) as path, StoreReader(path, finished=True) as reader:
                yield from reader.rows()
        except StoreError as error:
            folder.remove(shard_mark(shard))
            raise SurveyError(f"{error}; the same command makes it again") from error
        show(number / len(shards), number)
