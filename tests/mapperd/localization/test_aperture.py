"""Where localization looks for a return, beside where the map has it."""

import math

import numpy as np
import pytest

from mapperd.config.tree import Config, SonarConfig
from mapperd.localization.scan import heard_aperture_rad


def test_a_return_may_come_from_the_data_sheet_s_one_way_width() -> None:
    assert math.degrees(heard_aperture_rad(Config().sonar)) == pytest.approx(20.0, abs=0.3)
    narrow = SonarConfig(vertical_aperture=12.0 / math.sqrt(2.0))
    assert math.degrees(heard_aperture_rad(narrow)) == pytest.approx(12.0)


def test_power_of_a_uniform_line_halves_both_ways_where_the_map_ends() -> None:
    """sinc^2 each way, -3 dB one way at half the data sheet's width (Urick, line array)."""

    def both_ways_db(elevation_deg: float) -> float:
        along = 0.442946 * math.sin(math.radians(elevation_deg)) / math.sin(math.radians(10.0))
        return 40.0 * math.log10(float(np.sinc(along)))

    assert both_ways_db(Config().sonar.vertical_aperture / 2.0) == pytest.approx(-3.0, abs=0.2)
    assert both_ways_db(10.0) == pytest.approx(-6.0, abs=0.1)
