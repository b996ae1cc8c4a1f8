"""What is done with a map on disk takes the same memory, however large the map is."""

from pathlib import Path

import pytest
from bench.map_size import peak_mb, write_map_of

pytestmark = pytest.mark.slow

SMALL_MB, LARGE_MB = 50.0, 200.0


@pytest.mark.parametrize("way", ["save", ".pgm"])  # the others fill buffers of fixed size first
def test_memory_does_not_grow_with_the_map(way: str, tmp_path: Path) -> None:
    peaks_mb = []
    for size_mb in (SMALL_MB, LARGE_MB):
        path = tmp_path / f"{size_mb:g}.map"
        write_map_of(path, size_mb)
        peaks_mb.append(peak_mb(way, path, tmp_path)[0])
    assert peaks_mb[1] - peaks_mb[0] < 0.3 * (LARGE_MB - SMALL_MB)
