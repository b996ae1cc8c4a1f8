"""Whether scans lie on the map."""

import math

import pytest

from mapperd.localization.hypothesis import FitWatch, hit_share
from tests.mapperd.localization.filter_cases import HIT

FAR_M = 2.0


@pytest.mark.parametrize("share", [0.0, 0.25, 0.7, 1.0])
def test_share_of_hits_is_found_in_the_fit(share: float) -> None:
    beams = 40
    hits = round(share * beams)
    log_fit = hits * math.log(HIT.density(0.0)) + (beams - hits) * math.log(HIT.density(FAR_M))
    assert hit_share(math.exp(log_fit / beams), HIT, FAR_M) == pytest.approx(share, abs=1e-9)


@pytest.mark.parametrize("fit", [0.0, -1.0, math.nan, 1e-300])
def test_no_fit_is_no_hit(fit: float) -> None:
    assert hit_share(fit, HIT, FAR_M) == 0.0


def test_few_bad_scans_are_invalid_and_many_are() -> None:
    watch = FitWatch()
    assert watch.fits(0.4)
    for _ in range(20):
        watch = watch.after(0.7)
    for _ in range(4):
        watch = watch.after(0.0)
    assert watch.fits(0.4)
    for _ in range(4):
        watch = watch.after(0.0)
    assert not watch.fits(0.4)
