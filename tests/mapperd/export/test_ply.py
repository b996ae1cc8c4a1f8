import io

import numpy as np
import pytest

from mapperd.export.clouds import VERTEX, write_ply
from mapperd.mapping.sonar_map import Voxels


def written(count: int) -> tuple[list[str], bytes]:
    voxels = Voxels(
        np.arange(3 * count, dtype=np.float64).reshape(count, 3) + 1e6,
        np.linspace(0.71, 0.99, count).astype(np.float32),
        np.arange(count, dtype=np.uint16),
    )
    file = io.BytesIO()
    write_ply(file, voxels, 0.1)
    header, _, body = file.getvalue().partition(b"end_header\n")
    return header.decode("ascii").splitlines(), body


def test_header_declares_what_the_body_holds() -> None:
    header, body = written(5)
    assert header[:2] == ["ply", "format binary_little_endian 1.0"]
    assert "element vertex 5" in header
    assert [line for line in header if line.startswith("property")] == [
        "property double x",
        "property double y",
        "property double z",
        "property float probability",
        "property ushort count",
    ]
    assert len(body) == 5 * 30


def test_points_are_read_back() -> None:
    _, body = written(5)
    points = np.frombuffer(body, dtype=VERTEX)
    assert points["x"][1] == 1e6 + 3
    assert points["z"][4] == 1e6 + 14
    assert points["probability"][0] == pytest.approx(0.71)
    assert list(points["count"]) == [0, 1, 2, 3, 4]


def test_empty_map_is_an_empty_cloud() -> None:
    header, body = written(0)
    assert "element vertex 0" in header
    assert body == b""
