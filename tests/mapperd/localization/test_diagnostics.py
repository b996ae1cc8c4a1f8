import numpy as np
import pytest

from mapperd.config.tree import AmclConfig
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.status import Deviation, diagnose, model_warning


def estimate(*variances: float) -> PlanarGaussian:
    return PlanarGaussian(0, 0, 0, np.diag(variances))


def test_before_the_first_estimate_all_is_well() -> None:
    assert diagnose(None, AmclConfig()).level == "OK"


def test_levels_are_strict() -> None:
    amcl = AmclConfig(std_warn_level_x=0.5, std_warn_level_y=0.5, std_warn_level_yaw=0.5)
    assert diagnose(estimate(0.25, 0.25, 0.25), amcl).level == "OK"
    assert diagnose(estimate(0.25, 0.25, 0.2501), amcl).level == "WARN"


@pytest.mark.parametrize("which", range(3))
def test_any_of_the_three_warns_and_is_named(which: int) -> None:
    variances = [0.01] * 3
    variances[which] = 0.09
    reported = diagnose(estimate(*variances), AmclConfig())
    name = ("std_x", "std_y", "std_yaw")[which]
    assert reported.level == "WARN"
    assert reported.text == f"{name} 0.3 above 0.2"
    assert [one.value for one in reported.deviations] == pytest.approx(np.sqrt(variances))


def test_no_number_is_too_large() -> None:
    assert Deviation("std_yaw", np.nan, 0.2).is_too_large
    assert Deviation("std_yaw", np.inf, 0.2).is_too_large


def test_weights_that_do_not_sum_to_1_are_reported_for_the_model_in_use() -> None:
    assert model_warning(AmclConfig(), in_3d=True) is None
    beam = AmclConfig(laser_model_type="beam", laser_z_hit=0.45)
    assert model_warning(AmclConfig(laser_model_type="beam"), in_3d=False) == (
        "amcl: laser_z_hit + laser_z_rand + laser_z_short is 1.05, not 1"
    )
    assert model_warning(beam, in_3d=False) is None
    assert "is 0.9, not 1" in str(model_warning(AmclConfig(laser_z_hit=0.4), in_3d=False))


def test_rays_are_reported_to_compare_a_slice_of_a_3d_map() -> None:
    beam = AmclConfig(laser_model_type="beam", laser_z_hit=0.45)
    assert "beam compares the 3D map's slice" in str(model_warning(beam, in_3d=True))
