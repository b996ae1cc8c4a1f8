"""Settings reach the core's models under their meaning."""

import math

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import AmclConfig
from mapperd.localization.maps import GridMap
from mapperd.localization.models import beam_model, field_of

SET = (
    "laser_z_hit: 0.6, laser_z_short: 0.1, laser_z_rand: 0.23, "
    "laser_sigma_hit: 0.3, laser_lambda_short: 0.2, laser_max_range: 30, "
    "laser_likelihood_max_dist: 1.5"
)


def amcl() -> AmclConfig:
    return config_from_text(f"amcl: {{{SET}}}").amcl


def test_beam_model_has_the_settings() -> None:
    """Hit, short and random readings where 12 m are expected, by the formula."""
    hit_norm = 2.0 / (math.erf(18 / (0.3 * math.sqrt(2))) + math.erf(12 / (0.3 * math.sqrt(2))))
    peak = 0.6 * hit_norm / (0.3 * math.sqrt(2 * math.pi))
    short = 0.1 * 0.2 / (1 - math.exp(-0.2 * 12))
    wanted = {
        12.0: peak + 0.23 / 30,
        12.3: peak * math.exp(-0.5) + 0.23 / 30,
        4.0: short * math.exp(-0.2 * 4) + 0.23 / 30,
    }
    readings = np.array(list(wanted))
    got = [beam_model(amcl()).density(np.array([r]), np.array([12.0]))[0] for r in readings]
    assert got == pytest.approx(list(wanted.values()), rel=1e-9)


def test_field_has_the_settings() -> None:
    """At an obstacle, a sigma off, and beyond the truncation; the range is `laser_max_range`."""
    cells = np.zeros((5, 60), dtype=np.int8)
    cells[:, 0] = 100
    field = field_of(GridMap(cells, 0.1, 0.0, 0.0), config_from_text(f"amcl: {{{SET}}}"))
    peak, rest = 0.6 / (0.3 * math.sqrt(2 * math.pi)), 0.23 / 30
    wanted = [peak + rest, peak * math.exp(-0.5) + rest, peak * math.exp(-12.5) + rest]
    assert field.values()[2, [0, 3, 40]] == pytest.approx(wanted, rel=1e-6)
