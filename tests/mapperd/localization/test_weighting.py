"""A prepared map under other settings: what is rebuilt, and what is not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec import structs

from mapperd.config.tree import SonarConfig
from mapperd.localization.models import filter_params
from mapperd.localization.particle_filter import ParticleFilter
from mapperd.localization.scan import decimated, heard_aperture_rad
from mapperd.localization.weighting import SEARCH_BEAMS, MapWeighing
from tests.mapperd.localization.filter_cases import filter_at
from tests.mapperd.localization.test_hypothesis import profile
from tests.mapperd.localization.test_map_filter import room, scan_from, solid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mapperd.config.tree import Config

SCAN = scan_from((4.0, 3.0, 0.2))


def changed(section: str, **values: float) -> Config:
    settings = profile()
    other = structs.replace(getattr(settings, section), **values)
    return structs.replace(settings, **{section: other})


def cloud(weighing: MapWeighing) -> NDArray[np.float64]:
    """Drawn from a scan and weighed by it."""
    particles = ParticleFilter(filter_params(profile()), 5)
    weighing.draw(particles, SCAN, 0.0)
    weighing.weigh(particles, SCAN, 0.0, 0.5)
    return np.column_stack([particles.poses, particles.weights])


@pytest.mark.parametrize(
    "other",
    [changed("localization", search_sigma=1.0), changed("amcl", laser_sigma_hit=0.4)],
    ids=["search", "hit"],
)
def test_settings_that_shape_fields_make_them_again(other: Config) -> None:
    """As if the map had been prepared by them from the beginning."""
    before = MapWeighing(room(), profile())
    after = before.with_settings(other)
    assert np.array_equal(cloud(after), cloud(MapWeighing(room(), other)))
    assert not np.array_equal(cloud(after), cloud(before))


def test_settings_of_rates_leave_the_fields() -> None:
    """They take up to seconds on large maps, in the thread that maps."""
    before = MapWeighing(room(), profile())
    assert before.with_settings(changed("amcl", save_pose_rate=2.0)).free is before.free
    assert before.with_settings(changed("amcl", laser_z_hit=0.6)).free is not before.free


def test_scans_that_the_settings_thin_are_searched_by() -> None:
    """Else a start anywhere would silently be blind where a weak computer weighs ten beams."""
    few = MapWeighing(room(), changed("amcl", max_beams=10))
    assert few.can_search(decimated(SCAN, 10))
    assert not few.can_search(decimated(SCAN, 9))
    many = MapWeighing(room(), profile())
    assert many.can_search(decimated(SCAN, 15))
    assert not many.can_search(decimated(SCAN, 14))


def test_returns_are_tried_over_the_height_that_is_heard() -> None:
    """Two elevations halve the aperture's halves; a wall is as far as in its lower one."""
    settings = structs.replace(
        changed("localization", elevations=2), sonar=SonarConfig(vertical_aperture=50.0)
    )
    weighing = MapWeighing(solid(), settings)
    ahead, at = len(SCAN) // 2, np.array([[4.0, 3.0, 0.2]])

    def evidence(aperture_rad: float) -> float:
        slant_m = SCAN.range_m[[ahead]] / np.cos(aperture_rad / 4.0)
        beam = replace(
            SCAN,
            bearing_rad=SCAN.bearing_rad[[ahead]],
            range_m=slant_m,
            points_m=SCAN.points_m[[ahead]],
            quality=SCAN.quality[[ahead]],
            beam=SCAN.beam[[ahead]],
        )
        return weighing.weigh(filter_at(at), beam, -1.0, 1.0).log_evidence

    heard_rad = heard_aperture_rad(settings.sonar)
    assert evidence(heard_rad) > evidence(0.7 * heard_rad) > evidence(0.0)


def test_a_search_by_few_beams_has_no_more_votes_than_these() -> None:
    assert len(SCAN) > SEARCH_BEAMS
    certain = MapWeighing(room(), changed("localization", tempering=1.0))
    particles = ParticleFilter(filter_params(profile()), 5)
    certain.draw(particles, SCAN, 0.0)
    assert np.isfinite(particles.poses).all()
