"""The map that one process makes of all dives by the ordinary replay, and how maps are compared."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import msgspec

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.session.recordings import sessions_of
from mapperd.session.replay import Window, as_asked
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore

CACHE_TILES = 64
TILE_M = 12.8


class Fingerprint(msgspec.Struct, frozen=True):
    """Of the bricks in a map's file, in whatever order they stand in it.

    Attributes:
        bricks: how many.
        voxel_bytes: of all their voxels, unpacked.
        total: sum of the rows' digests, in hexadecimal.
    """

    bricks: int
    voxel_bytes: int
    total: str


def map_in_one_process(recordings: Sequence[Path], config: Config, path: Path) -> int:
    """Map recordings one after the other, with a bounded part of the map in memory.

    Returns:
        How many pings are in the map.
    """
    sonar_map, mapped = SonarMap(config), 0
    with TileStore(path, sonar_map, tile_size_m=TILE_M, cache_tiles=CACHE_TILES) as store:
        for recording in recordings:
            (session,) = sessions_of([recording])
            replay = as_asked(session, None, config).replay(sonar_map, Window())
            for _ in replay.run(session):
                store.advance(b"")
            store.advance(b"")  # what was pending at the recording's end
            mapped += replay.counters.pings_mapped
    return mapped


def fingerprint(path: Path) -> Fingerprint:
    """Of a map's file: keys, revisions and voxels, to the bit; memory for one brick."""
    bricks = voxel_bytes = total = 0
    with StoreReader(path) as reader:
        for row in reader.rows():
            words = f"{row.key} {row.revision} {row.size} {row.crc} ".encode()
            digest = hashlib.blake2b(words + row.data, digest_size=16).digest()
            total += int.from_bytes(digest, "little")
            bricks += 1
            voxel_bytes += row.size
    return Fingerprint(bricks, voxel_bytes, f"{total % (1 << 128):032x}")
