"""A study that contradicts itself is refused before it takes an hour."""

from dataclasses import replace
from typing import Any

import pytest
from studies.accuracy_cost.study import AccuracyCostError, Setting, Study, load


def test_a_good_study_is_loaded(fake: Study) -> None:
    assert load("fake_study") is fake


@pytest.mark.parametrize(
    ("name", "value", "stated"),
    [
        ("own_error", "share", "share is no column of which less is better"),
        ("own_error", "cpu_ms", "differs from run to run"),
        ("error", "depth_m", "depth_m is no column"),
        ("error", "share", "share is no column of which less is better"),
        ("error", "cpu_ms", "differs from run to run"),
        ("settings", [Setting("1", {}), Setting("1", {"a": 1})], "two settings of one label"),
        ("settings", [Setting("1", {"a": 1})], "one setting of no overrides"),
        ("settings", [Setting("1", {}), Setting("2", {})], "one setting of no overrides"),
        ("published", "9", "size has no setting 9"),
    ],
)
def test_a_contradiction_is_reported(
    fake: Study, monkeypatch: pytest.MonkeyPatch, name: str, value: Any, stated: str
) -> None:
    if name == "own_error":
        name, value = "knobs", (replace(fake.knobs[0], error=value),)
    if name in ("settings", "published"):
        knob = replace(fake.knobs[0], **{"published": None, name: value})
        name, value = "knobs", (knob,)
    monkeypatch.setattr(type(fake), name, value)
    with pytest.raises(AccuracyCostError, match=stated):
        load("fake_study")
