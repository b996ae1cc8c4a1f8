"""The report of localization in plain values."""

import json
import math

import numpy as np
import pytest

from mapperd.config.loader import config_of
from mapperd.localization.models import filter_params
from mapperd.localization.particle_filter import ParticleFilter, clusters_of
from mapperd.localization.report import localization_report, localization_summary, state_of
from tests.mapperd.localization.believed import STAMP_NS, snapshot

CONFIG = config_of({"localization": {"mode": "global"}}, "")


@pytest.mark.parametrize(
    ("elsewhere", "state"),
    [(0.0, "localized"), (0.1, "localized"), (0.11, "ambiguous"), (0.5, "ambiguous"),
     (0.51, "lost"), (None, "waiting for a map")],
)  # fmt: skip
def test_state_reports_how_far_it_can_be_trusted(elsewhere: float | None, state: str) -> None:
    assert state_of(snapshot(elsewhere, state="waiting for a map")) == state


def test_report_has_all_there_is() -> None:
    stated = localization_report(snapshot(0.2), CONFIG, 50)
    assert json.loads(json.dumps(stated)) == stated  # plain values alone
    assert (stated["mode"], stated["state"], stated["map"]) == ("global", "ambiguous", "tank.yaml")
    pose = stated["pose"]
    assert pose["t_s"] == STAMP_NS / 1e9
    assert (pose["x_m"], pose["y_m"], pose["yaw_rad"]) == (1.0, 2.0, 0.5)
    assert (pose["frame"], pose["child_frame"]) == ("map", "base_footprint")
    assert np.diag(pose["covariance"]) == pytest.approx([0.01, 0.04, 0.0001])
    assert stated["overall"]["x_m"] == 1.5
    assert stated["clusters"][0]["mass"] == 0.8
    assert (stated["std_y_m"], stated["yaw_deg"]) == pytest.approx((0.2, math.degrees(0.5)))
    assert (stated["ambiguous"], stated["elsewhere"], stated["particles"]) == (True, 0.2, 5000)
    moved = stated["map_odom"]
    assert moved["t_s"] == STAMP_NS / 1e9 + 1
    assert moved["position_m"] == [3.0, -4.0, 0.0]
    assert moved["orientation_wxyz"] == pytest.approx([math.sqrt(0.5), 0, 0, math.sqrt(0.5)])
    assert (moved["frame"], moved["child_frame"]) == ("map", "odom")
    assert stated["diagnostics"]["std_y"] == {"value": 0.2, "warn_level": 0.2, "level": "OK"}
    assert stated["counts"] == {"moved": 3, "no_filter": 1}


def test_before_a_belief_nothing_is_made_up() -> None:
    stated = localization_report(snapshot(None, transform=None, known=None), CONFIG, 0)
    assert stated["pose"] is stated["overall"] is stated["map_odom"] is stated["t_s"] is None
    assert (stated["clusters"], stated["sample"], stated["map"]) == ([], [], "")
    assert localization_report(None, CONFIG, 9) == {"mode": "global", "state": "off"}
    assert localization_summary(None, CONFIG) is None


@pytest.mark.parametrize(("most", "count"), [(0, 0), (1, 1), (50, 50), (70, 67), (500, 200)])
def test_sample_is_bounded(most: int, count: int) -> None:
    assert len(localization_report(snapshot(), CONFIG, most)["sample"]) == count


def test_a_level_that_is_passed_is_reported() -> None:
    stated = localization_report(snapshot(std=0.15), CONFIG, 0)["diagnostics"]
    assert (stated["level"], stated["std_x"]["level"], stated["std_y"]["level"]) == (
        "WARN",
        "OK",
        "WARN",
    )


def test_clusters_have_their_own_means() -> None:
    particles = ParticleFilter(filter_params(CONFIG), 7, 1)
    rng = np.random.default_rng(2)
    at = np.repeat([[0.0, 0.0, 0.3], [9.0, 5.0, -2.0]], (300, 100), axis=0)
    particles.start_with(at + rng.normal(0, 0.02, at.shape), np.full(400, 1 / 400))
    first, second = clusters_of(particles)[:2]
    assert (first.mass, second.mass) == pytest.approx((0.75, 0.25), abs=0.03)
    assert (first.pose.x_m, first.pose.y_m) == pytest.approx((0, 0), abs=0.02)
    assert (second.pose.x_m, second.pose.y_m, second.pose.yaw_rad) == pytest.approx(
        (9, 5, -2), abs=0.02
    )
    assert len(clusters_of(particles, 1)) == 1
