"""All tiles are mapped, each once; one that proves too large for a worker's memory is cut in eight.

Which tiles there are changes nothing in the map.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapper_survey.engine import Engine
from mapper_survey.errors import SurveyError
from mapper_survey.fingerprint import digest_of, program_digest
from mapper_survey.folder import Folder
from mapper_survey.marks import mark, marked
from mapper_survey.order import PLACE, Tile, children_of, ordinals_of, tiles_of
from mapper_survey.planning import DivePlan, mark_name, spool_name
from mapper_survey.spool import Rows
from mapper_survey.tile_task import SpooledDive, TileResult, TileTask, map_tile
from mapperd.config.tree import Config

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
        self._there: dict[str, int] = {}
        self._done = self._asked = 0

    def run(self, engine: Engine, show: Show) -> list[str]:
        """Map what has to be; returns the shards that make the map.

        Raises:
            SurveyError: a task cannot be done, or a single brick is too large.
        """
        self._there = self._folder.sizes("shards")
        tiles = tiles_of(self._scope.rows, self._ordinals, self._edge)
        shards: list[str] = []
        largest_first = sorted(tiles, key=lambda tile: -len(tiles[tile]))
        for tile in largest_first:
            self._take(tile, tiles.pop(tile), engine, shards)
        for task, result in engine.done():
            mark(self._folder, shard_mark(task.shard), result)
            self._took(task, result, engine, shards)
            show(self._done / max(self._asked, 1), self._done)
        return sorted(shards)

    def _take(
        self, tile: Tile, places: NDArray[np.void], engine: Engine, shards: list[str]
    ) -> None:
        """Have a tile made if it is not there."""
        task = self._task(tile, places)
        self._asked += len(places)
        kept = self._kept(task)
        if kept is None:
            engine.submit(map_tile, task)
        else:
            self._took(task, kept, engine, shards)

    def _took(self, task: TileTask, result: TileResult, engine: Engine, shards: list[str]) -> None:
        self.results.append(result)
        self._done += result.pings
        if not result.too_large:
            shards.append(result.shard)
            return
        tile, places = Tile(task.key, task.edge), np.frombuffer(task.pings, dtype=PLACE)
        children = children_of(tile, places, self._scope.rows, self._ordinals)
        if not children:
            raise SurveyError(
                f"tile {tile.name} takes over {self._most_bytes >> 20} MiB and cannot be cut: "
                "allowed: a larger --memory-per-worker, or larger voxels"
            )
        for child, theirs in children.items():
            self._take(child, theirs, engine, shards)

    def _task(self, tile: Tile, places: NDArray[np.void]) -> TileTask:
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
