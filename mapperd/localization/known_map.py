"""A known map, and which one it is."""

from dataclasses import dataclass

from mapperd.localization.grid_map import GridMap
from mapperd.localization.maps import LocalizationMap, VolumeMap

__all__ = ["KnownMap"]


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """A map as it was loaded.

    Attributes:
        path: of its file.
        sha256: of what the file held: equal for equal maps.
        map: for the filter.
    """

    path: str
    sha256: str
    map: LocalizationMap

    @property
    def grid(self) -> GridMap:
        """The planar map, or the slice of it that the vehicle drives in; for pictures."""
        return self.map.grid if isinstance(self.map, VolumeMap) else self.map
