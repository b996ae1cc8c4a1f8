"""Lost bricks come back from the recordings that they were made of.

What a ping says does not depend on the map, and a brick on no other: mapping the same pings again
while keeping only the lost bricks gives them back as they were, to the bit.
"""

import weakref
from collections.abc import Callable

from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.bricks import Key
from mapperd.store.tile_store import TileStore

__all__ = ["rebuild_lost"]

MapAgain = Callable[[SonarMap], bool]
"""Maps the input again from its beginning up to the store's position; False if any is missing."""


def rebuild_lost(store: TileStore, sonar_map: SonarMap, map_again: MapAgain) -> int:
    """Rebuild what the store has lost, before anything is mapped into it.

    Takes as much memory as the lost bricks and one ping.

    Args:
        store: just opened.
        sonar_map: its map, for the settings.
        map_again: maps the recordings. Where they are not complete, what they give is kept, but
            the bricks stay on record as lost.

    Returns:
        bricks that were lost.

    Raises:
        StoreError: the file cannot be written.
    """
    lost = store.lost
    if not lost:
        return 0
    scratch = SonarMap(sonar_map.config)
    _keep_only(scratch, lost)
    whole = map_again(scratch)
    _, found = scratch.core.bricks_since(0)
    store.restore([(key, brick) for key, _, brick in found if key in lost], whole=whole)
    return len(lost)


def _keep_only(scratch: SonarMap, lost: frozenset[Key]) -> None:
    """Let a map forget, with every ping, what is not lost."""
    here: set[Key] = set()
    core = weakref.proxy(scratch.core)  # which keeps what it calls alive

    def fetch(tiles: list[Key]) -> None:
        core.drop_tiles([tile for tile in here if tile not in lost])
        here.intersection_update(lost)
        core.put_bricks([], tiles)
        here.update(tiles)

    core.cut_into_tiles(1, fetch)
