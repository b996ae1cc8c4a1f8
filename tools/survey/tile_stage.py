"""All tiles are mapped, each once; one that proves too large for a worker's memory is cut in eight.

Which tiles there are changes nothing in the map.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config import Config
from survey.engine import Engine
from survey.errors import SurveyError
from survey.fingerprint import digest_of, program_digest
from survey.folder import Folder
from survey.marks import mark, marked
from survey.order import Tile, ordinals_of, tiles_of
from survey.planning import DivePlan, mark_name, spool_name
from survey.spool import Rows
from survey.tile_task import SpooledDive, TileResult, TileTask, map_tile

__all__ = ["Scope", "TileStage", "shard_mark"]

Show = Callable[[float, int], None]


@dataclass(frozen=True, slots=True)
class Scope:
    """Dives that make one map.

    Attributes:
        name: of it; empty for the map of all.
        plans: of its dives.
        rows: of them.
    """

    name: str
    plans: Sequence[DivePlan]
    rows: Sequence[Rows]

    @property
    def pings(self) -> int:
        """Of all its dives, which is the revision of their map."""
        return sum(len(rows) for rows in self.rows)


def shard_mark(shard: str) -> str:
    """Name of what is said of a shard."""
    return f"{shard.removesuffix('.db')}.json"


class TileStage:
    """Has the tiles of one map made.

    Args:
        scope: whose map it is.
        config: the settings.
        folder: the survey's.
        edge: of a tile, in bricks.
        most_bytes: that a tile's voxels may take.

    Attributes:
        results: of all tiles, those that were too large with them.
    """

    def __init__(
        self, scope: Scope, config: Config, folder: Folder, edge: int, most_bytes: int
    ) -> None:
        self.results: list[TileResult] = []
        self._scope = scope
        self._config = config
        self._folder = folder
        self._most_bytes = most_bytes
        self._edge = edge
        self._ordinals = ordinals_of(scope.rows)
        self._tiles: dict[int, dict[Tile, NDArray[np.void]]] = {}
        self._there: dict[str, int] = {}
        self._done = self._asked = 0

    def run(self, engine: Engine, show: Show) -> list[str]:
        """Map what has to be; returns the shards that make the map.

        Raises:
            SurveyError: a task cannot be done, or a single brick is too large.
        """
        self._there = self._folder.sizes("shards")
        tiles = self._tiles_of(self._edge)
        shards: list[str] = []
        largest_first = sorted(tiles, key=lambda tile: -len(tiles[tile]))
        self._take(largest_first, engine, shards)
        for task, result in engine.done():
            mark(self._folder, shard_mark(task.shard), result)
            self._took(Tile(task.key, task.edge), result, engine, shards)
            show(self._done / max(self._asked, 1), self._done)
        return sorted(shards)

    def _take(self, tiles: Sequence[Tile], engine: Engine, shards: list[str]) -> None:
        """Have tiles made that are not there."""
        for tile in tiles:
            task = self._task(tile)
            self._asked += len(self._tiles_of(tile.edge)[tile])
            kept = self._kept(task)
            if kept is None:
                engine.submit(map_tile, task)
            else:
                self._took(tile, kept, engine, shards)

    def _took(self, tile: Tile, result: TileResult, engine: Engine, shards: list[str]) -> None:
        self.results.append(result)
        self._done += result.pings
        if not result.too_large:
            shards.append(result.shard)
            return
        children = [child for child in tile.children() if child in self._tiles_of(child.edge)]
        if not children:
            raise SurveyError(
                f"tile {tile.name} takes over {self._most_bytes >> 20} MiB and cannot be cut: "
                "allowed: a larger --memory-per-worker, or larger voxels"
            )
        self._take(children, engine, shards)

    def _tiles_of(self, edge: int) -> dict[Tile, NDArray[np.void]]:
        if edge not in self._tiles:
            self._tiles[edge] = tiles_of(self._scope.rows, self._ordinals, edge)
        return self._tiles[edge]

    def _task(self, tile: Tile) -> TileTask:
        places = self._tiles_of(tile.edge)[tile]
        used = [self._scope.plans[dive].fingerprint for dive in np.unique(places["dive"])]
        key = digest_of(program_digest(), self._config, tile.name, *used, places.tobytes())
        scope = f"{self._scope.name}@" if self._scope.name else ""
        return TileTask(
            shard=f"shards/{scope}{tile.name}.{key}.db",
            key=tile.key,
            edge=tile.edge,
            config=self._config,
            dives=[
                SpooledDive(spool_name(plan), mark_name(plan), plan.bearings)
                for plan in self._scope.plans
            ],
            pings=places.tobytes(),
            folder=self._folder.url,
            most_bytes=self._most_bytes,
        )

    def _kept(self, task: TileTask) -> TileResult | None:
        if shard_mark(task.shard) not in self._there:
            return None
        result = marked(self._folder, shard_mark(task.shard), TileResult)
        if result is None:
            return None
        if result.too_large:
            return result if task.most_bytes <= result.most_bytes else None
        return result if self._there.get(task.shard) == result.written_bytes else None
