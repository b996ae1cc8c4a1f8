"""The evidence of a dive's pings is written to a file as they come."""

import io
from typing import Any

import numpy as np
import pytest
from mapper_survey.spool import NO_TIME, PACKED, ROW, RowFile


@pytest.mark.parametrize("count", [0, 1, 12_345])
def test_rows_are_numpys_array(count: int) -> None:
    random = np.random.default_rng(count)
    expected = np.zeros(count, dtype=ROW)
    expected["t_ns"] = random.integers(NO_TIME, 2**62, count)
    expected["offset"] = np.cumsum(random.integers(0, 2**40, count))
    expected["size"] = random.integers(0, 2**31, count)
    for box in ("first", "last"):
        expected[box] = random.integers(-(2**31), 2**31, (count, 3))
    out = io.BytesIO()
    rows = RowFile(out)
    plain: Any = expected.tolist()
    for t_ns, offset, size, first, last in plain:
        rows.add((t_ns, offset, size, *first, *last))
    assert len(out.getvalue()) == len(rows._head()) + count * PACKED.size
    rows.close()
    out.seek(0)
    assert np.array_equal(np.load(out), expected)
    assert rows.count == count
