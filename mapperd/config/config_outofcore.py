"""Settings of the map on disk."""

from typing import Annotated

from msgspec import Struct

from mapperd.config.field import rule

__all__ = ["OutOfCore"]


class OutOfCore(Struct, frozen=True, forbid_unknown_fields=True):
    """Tiles in a file, of which only some are in memory."""

    use: Annotated[bool, rule("Keep the map on disk.")] = False
    map_path: Annotated[
        str,
        rule("Of the map's file; without one it lies in the state directory.", "a path or nothing"),
    ] = ""
    tile_size: Annotated[
        float, rule("Edge of a tile; at least eight voxels.", "m", ge=0.01, le=10000)
    ] = 10.0
    cache_size: Annotated[int, rule("Tiles in memory at most.", "tiles", ge=1, le=1000000)] = 16
