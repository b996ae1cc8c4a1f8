"""Round and round through a scene that does not fit: nothing grows, nothing is left open.

`make store-soak` does it half a million times.
"""

import os
import struct
from pathlib import Path

from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import StoreReader
from tests.mapperd.store import dive
from tests.support.process import open_files, resident_bytes

PINGS = int(os.environ.get("STORE_PINGS", "330"))
ROUND = 300
LONG = 5_000
"""Pings from which on the process has taken all the memory that it will ever need."""


def test_nothing_grows_however_long_it_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "dive.map"
    echoes = [dive.echo_of(number) for number in range(ROUND)]
    sonar_map, store = dive.open_store(path)
    warm_files = warm_bytes = max_bytes = max_map = 0
    with store:
        for number in range(PINGS):
            at = number % ROUND
            sonar_map.integrate(echoes[at], dive.pose_of(at) @ sonar_map.base_T_sonar)
            store.advance(struct.pack("<Q", number + 1))
            if number % 50 == 0:
                store.save()
                max_map = max(max_map, sonar_map.memory_bytes)
            if number == PINGS // 5:
                warm_files, warm_bytes = open_files(), resident_bytes()
            if number % 50 == 0 and number > PINGS // 5:
                max_bytes = max(max_bytes, resident_bytes())
        assert open_files() == warm_files
        assert store.counters.tiles_loaded > PINGS / 30
    whole = SonarMap(dive.CONFIG)
    with StoreReader(path) as reader:
        reader.load(whole)
    assert max_map < whole.memory_bytes / 3
    print(f"RSS: {warm_bytes} bytes warm, {max_bytes} at most; {store.status()}")  # noqa: T201
    if PINGS >= LONG:
        assert max_bytes < 1.05 * warm_bytes
