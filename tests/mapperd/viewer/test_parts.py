"""Colours, shapes, measuring and settings of the page."""

import math

import matplotlib as mpl
import numpy as np
import pytest

from mapperd.config.live import facts_of
from mapperd.config.tree import Config
from mapperd.viewer.chunks import Chunks, Filter, drawn_of
from mapperd.viewer.colours import Scale, colours_of, legend_of, shaded, values_of
from mapperd.viewer.panel import Span
from mapperd.viewer.settings import control_of, controls_of, value_from
from mapperd.viewer.shapes import cube, ellipse, fan_lines, strip, vehicle_parts
from mapperd.viewer.tools import Measuring, distance_text, pick
from mapperd.wire.messages import FanMessage
from tests.mapperd.viewer.view_fakes import blocks_of, mirror_of

SECOND = 1_000_000_000


def test_values_are_those_of_the_cells() -> None:
    mirror = mirror_of(blocks_of([[0, 0, 3]], 1.0, 9, age_ms=2000), 10 * SECOND)
    chunks = Chunks(10)
    chunks.touch(mirror.keys())
    drawn = drawn_of(mirror, chunks, (0, 0, 0), Filter())
    assert values_of(drawn, "height", 0) == pytest.approx([0.35])
    assert values_of(drawn, "probability", 0) == pytest.approx([1 / (1 + math.exp(-1))])
    assert values_of(drawn, "age", 15 * SECOND) == pytest.approx([7.0])
    assert values_of(drawn, "count", 0) == pytest.approx([8])  # the power of two below


def test_legend_and_colours_agree_at_every_tick() -> None:
    for scale in (Scale("height", -7, -3), Scale("age", 1, 1000), Scale("count", 1, 128)):
        legend = legend_of(scale)
        ends = colours_of(np.array([scale.low, scale.high]), scale)
        assert legend.colours[0] == "#{:02x}{:02x}{:02x}".format(*ends[0])
        assert legend.colours[-1] == "#{:02x}{:02x}{:02x}".format(*ends[1])
        outside = colours_of(np.array([scale.low - 50, scale.high + 5000]), scale)
        np.testing.assert_array_equal(outside, ends)
    assert legend_of(Scale("height", -7, -3)).ticks == ("-7.0", "-6.0", "-5.0", "-4.0", "-3.0")
    assert legend_of(Scale("count", 1, 16)).ticks == ("1", "2", "4", "8", "16")
    assert legend_of(Scale("age", 1, 10_000)).ticks == ("1 s", "10 s", "2 min", "17 min", "167 min")


@pytest.mark.parametrize(
    ("scale", "name"), [(Scale("height", -7, -3), "turbo"), (Scale("age", 1, 100), "plasma_r")]
)
def test_colours_are_those_of_the_published_maps_of_colours(scale: Scale, name: str) -> None:
    parts = np.linspace(0, 1, 50)
    values = 100**parts if scale.mode == "age" else -7 + 4 * parts
    published = mpl.colormaps[name]
    one_entry = np.abs(np.diff(published(np.arange(256)), axis=0)).max() * 255
    apart = np.abs(colours_of(values, scale) - published(parts)[:, :3] * 255)
    assert apart.max() < one_entry + 1


def test_shading_darkens_what_looks_away_from_the_light() -> None:
    white = np.full((2, 3), 200, np.uint8)
    up, down = shaded(white, np.array([[0, 0, 1], [0, 0, -1]], np.float32))
    assert (up > down).all()
    assert (up <= 200).all()


def test_a_ray_picks_the_first_cell_that_it_meets() -> None:
    mirror = mirror_of(blocks_of([[0, 0, 0], [20, 0, 0], [20, 1, 0]]))
    chunks = Chunks(10)
    chunks.touch(mirror.keys())
    drawn = [drawn_of(mirror, chunks, (0, 0, 0), Filter())]
    assert pick(drawn, (-5, 0.05, 0.05), (1, 0, 0)) == pytest.approx([0.05, 0.05, 0.05])
    assert pick(drawn, (5, 0.05, 0.05), (-2, 0, 0)) == pytest.approx([2.05, 0.05, 0.05])
    assert pick(drawn, (5, 0.15, 0.05), (-2, 0, 0)) == pytest.approx([2.05, 0.15, 0.05])
    assert pick(drawn, (-5, 0.25, 0.05), (1, 0, 0)) is None
    assert pick(drawn, (-5, 0.05, 0.05), (-1, 0, 0)) is None, "behind"
    slanted = np.array([2.05, 0.15, 0.05]) - (4.0, 3.0, 2.0)
    assert pick(drawn, slanted, (4, 3, 2)) == pytest.approx([2.05, 0.15, 0.05])
    assert pick([], (0, 0, 0), (1, 0, 0)) is None


def test_two_points_are_a_distance_and_a_third_starts_again() -> None:
    assert distance_text((1, 1, 1), (4, 5, 1)) == "5.00 m   dx +3.00  dy +4.00  dz +0.00"
    measuring = Measuring()
    assert "pick the other" in measuring.add(np.zeros(3))
    assert measuring.add(np.array([0.0, 0.0, -2.0])).startswith("2.00 m")
    measuring.add(np.ones(3))
    assert len(measuring.points_m) == 1


@pytest.mark.parametrize("part", [*range(5), "cube"])
def test_faces_look_outwards(part: int | str) -> None:
    if part == "cube":
        vertices, faces = cube()
    else:
        one = vehicle_parts(1.0)[int(part)]
        vertices, faces = one.vertices, one.faces
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    normals = np.cross(b - a, c - a)
    outwards = (a + b + c) / 3 - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    area = np.linalg.norm(normals, axis=1)
    assert (np.einsum("ij,ij->i", normals, outwards)[area > 1e-9] > 0).all()


def test_the_nose_is_in_front() -> None:
    parts = {part.name: part for part in vehicle_parts(0.7)}
    assert parts["nose"].vertices[:, 0].max() == pytest.approx(0.35)
    assert parts["hull"].vertices[:, 0].min() == pytest.approx(-0.35)
    assert parts["thruster_starboard"].vertices[:, 1].mean() < 0


def test_the_fan_lies_between_its_bearings_and_ranges() -> None:
    fan = FanMessage(
        bearings_rad=(-0.2, 1.0), vertical_aperture_rad=0.3, min_range_m=0.5, max_range_m=9.0
    )
    points = fan_lines(fan).reshape(-1, 3).astype(float)
    ranges = np.linalg.norm(points, axis=1)
    assert ranges.min() == pytest.approx(0.5)
    assert ranges.max() == pytest.approx(9.0)
    bearings = -np.arctan2(points[:, 1], points[:, 0])  # positive to starboard, y to port
    assert (bearings.min(), bearings.max()) == pytest.approx((-0.2, 1.0))
    up = np.arcsin(points[:, 2] / ranges)
    assert (up.min(), up.max()) == pytest.approx((-0.15, 0.15))


def test_the_ellipse_is_that_of_the_covariance() -> None:
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    covariance = turn @ np.diag([4.0, 0.25]) @ turn.T
    points = ellipse(covariance, 2.0)[:, 0, :2].astype(float)
    distance = np.einsum("ij,jk,ik->i", points, np.linalg.inv(covariance), points)
    np.testing.assert_allclose(distance, 4.0, rtol=1e-4)
    assert np.isfinite(ellipse(np.zeros((2, 2)), 2.0)).all()


def test_a_strip_joins_points_one_after_the_other() -> None:
    np.testing.assert_array_equal(
        strip([[0, 0, 0], [1, 0, 0], [1, 2, 0]]), [[[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [1, 2, 0]]]
    )


def test_the_span_of_heights_only_grows() -> None:
    span = Span()
    assert span.take(-6.9, -3.1)
    assert span.ends_m == (-7.0, -3.0)
    assert not span.take(-6.0, -4.0)
    assert span.take(-6.0, -1.2)
    assert span.ends_m == (-7.0, -1.0)


def test_all_settings_that_may_change_have_a_control_that_gives_their_value_back() -> None:
    facts = facts_of(Config(), lambda _: "default", [])
    controls = [one for part in controls_of(facts).values() for one in part]
    assert {one.name for one in controls} == {n for n, f in facts.items() if f["dynamic"]}
    for one in controls:
        assert value_from(one, one.value) == facts[one.name]["value"], one.name
        assert facts[one.name]["description"] in one.hint


def test_controls_are_of_the_setting_s_kind() -> None:
    facts = facts_of(Config(), lambda _: "default", [])
    radius = control_of("filtering.min_range", facts["filtering.min_range"])
    assert (radius.kind, radius.label, radius.low) == ("number", "min_range (m)", 0.0)
    skip = control_of("processing.frame_skip", facts["processing.frame_skip"])
    assert (skip.whole, skip.low, skip.high) == (True, 1, 1000)
    assert value_from(skip, 4.0) == 4
    model = control_of("amcl.laser_model_type", facts["amcl.laser_model_type"])
    assert model.choices == ("likelihood_field", "likelihood_field_prob", "beam")
    assert control_of("amcl.restore_defaults", facts["amcl.restore_defaults"]).kind == "switch"
    text = control_of("a.b", {"value": [1, 2], "dynamic": True})
    assert (text.kind, value_from(text, "[3]"), value_from(text, "x y")) == ("text", [3], "x y")


def test_settings_are_found_by_words_of_name_and_help() -> None:
    facts = facts_of(Config(), lambda _: "default", [])
    assert list(controls_of(facts, "FRAME_skip")) == ["processing"]
    found = controls_of(facts, "map every nth")
    assert [one.name for one in found["processing"]] == ["processing.frame_skip"]
    assert controls_of(facts, "no such thing") == {}
