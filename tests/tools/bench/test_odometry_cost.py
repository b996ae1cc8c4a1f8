from typing import get_args

import pytest
from bench.odometry_cost import formats, table

from mapperd.config.odometry import FormatName


@pytest.mark.slow
def test_every_format_gives_its_pings_poses() -> None:
    """The times are the machine's. That the work was done is not: `table` raises otherwise."""
    text = table(2.0)
    for name in formats():
        assert f"| `{name}` |" in text
    # The DVL's serial sentences are left out: they are 7 Hz at most.
    assert set(get_args(FormatName)) - set(formats()) == {"water_linked_serial"}
