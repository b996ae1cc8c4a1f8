"""docs/reference/library.md runs as it stands, and names what there is."""

import re
from pathlib import Path
from typing import Any

import pytest

import mapperd
from mapperd import Localizer, SonarTo3DMapper
from mapperd.compat.flat_config import config_from_flat
from mapperd.config.tree import Config

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "library.md").read_text(
    encoding="utf-8"
)


def test_examples_run_and_find_something(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for example in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(example, names)  # noqa: S102 our own page
    assert (tmp_path / "map.bt").stat().st_size > 100
    assert (tmp_path / "octree.ot").stat().st_size > 100
    assert names["stats"]["num_occupied"] > 0
    assert len(names["cloud"]["free_points"]) > 0
    assert names["depth"][0] == pytest.approx(6.0, abs=0.2)
    assert names["field"].values.min() == 0
    assert len(names["walls"]) > 0
    assert names["updater"].get_observation_count((30, 10, 0)) == 1
    assert names["refused"] is None
    best = names["localized"].belief.best
    assert (best.x_m, best.y_m, best.yaw_rad) == pytest.approx((0.75, 0.5, 0.0), abs=0.1)
    transform = names["localized"].transform
    assert (transform.x_m, transform.y_m) == pytest.approx((-1.0, 0.5), abs=0.1)
    assert capsys.readouterr().out.count("\n") >= 3


def test_every_public_call_of_the_mapper_is_explained() -> None:
    for name in vars(SonarTo3DMapper):
        if not name.startswith("_"):
            assert f"`{name}`" in PAGE


def test_every_public_name_is_explained() -> None:
    for name in mapperd.__all__:
        assert f"`{name}`" in PAGE
        assert hasattr(mapperd, name)
    for name in vars(Localizer):
        if not name.startswith("_"):
            assert f"`{name}`" in PAGE


def test_keys_named_are_keys() -> None:
    keys = ("voxel_resolution", "min_range", "L_occ", "occupied_threshold")
    for key in (*keys, "adaptive_max_ratio", "adaptive_min_ratio"):
        assert f"`{key}`" in PAGE
    off = {"use_outofcore": False, "crosstalk_enabled": False, "use_cpp_backend": True}
    assert config_from_flat(off | {"dynamic_expansion": True, "frame_skip": 1}) == Config()
