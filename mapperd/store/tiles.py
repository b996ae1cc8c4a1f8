"""Which tiles are in memory, and which of them go first."""

from collections import OrderedDict
from collections.abc import Collection, Iterable, Sequence

from mapperd.store.bricks import Key

__all__ = ["ResidentTiles"]


class ResidentTiles:
    """The tiles in memory, least recently used first.

    Args:
        limit: how many there should be; one ping may need more at once.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._used_at: OrderedDict[Key, int] = OrderedDict()

    def __len__(self) -> int:
        return len(self._used_at)

    def all(self) -> list[Key]:
        """All of them, least recently used first."""
        return list(self._used_at)

    def missing(self, tiles: Sequence[Key]) -> list[Key]:
        """Those that are not in memory."""
        return [tile for tile in tiles if tile not in self._used_at]

    def use(self, tiles: Iterable[Key], revision: int) -> None:
        """Note that tiles are in memory, and about to be changed at the next revision."""
        for tile in tiles:
            self._used_at[tile] = revision
            self._used_at.move_to_end(tile)

    def surplus(self, coming: int, needed: Collection[Key]) -> list[Key]:
        """Those that must go so that `coming` more fit in; none that is needed."""
        too_many = len(self._used_at) + coming - self._limit
        spare = [tile for tile in self._used_at if tile not in needed]
        return spare[: max(too_many, 0)]

    def changed_since(self, revision: int, tiles: Iterable[Key]) -> set[Key]:
        """Those that may have changed after a revision of the map."""
        return {tile for tile in tiles if self._used_at[tile] >= revision}

    def drop(self, tiles: Iterable[Key]) -> None:
        """Note that tiles are gone."""
        for tile in tiles:
            del self._used_at[tile]
