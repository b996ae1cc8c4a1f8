"""The one command from recordings to products: what `run` makes the others take."""

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from mapper_survey.command import main

from tests.tools.mapper_survey.dives import write_survey


@pytest.mark.slow
def test_a_survey_from_its_recordings_to_its_products(tmp_path: Path) -> None:
    origin = {"latitude": 54.36, "longitude": 10.16, "altitude": 1.5}
    survey, out = write_survey(tmp_path, origin=origin), tmp_path / "out"
    assert main(["run", str(survey), "--out", str(out), "--workers", "0", "--dives"]) == 0
    assert main(["export", str(out), "--products", "grid", "positions"]) == 0
    with rasterio.open(out / "exports/depth.tif") as grid:
        assert grid.crs.is_projected
        depths = grid.read(1, masked=True)
        assert depths.count() > 1000
        assert 1.5 < depths.min() < depths.max() < 7.5  # from 3 m under, down to the ping's range
    words = ["--products", "grid", "--altitude", "0", "--out", str(tmp_path / "from-zero")]
    assert main(["export", str(out), *words]) == 0
    with rasterio.open(tmp_path / "from-zero/depth.tif") as grid:
        below_zero = grid.read(1, masked=True)
    # The map's zero lies 1.5 m above what depths count from: they are smaller by that.
    assert np.ma.allclose(depths, below_zero - 1.5, atol=1e-5)
    assert (depths.mask == below_zero.mask).all()
    first = (out / "exports/positions.xyz").read_text("utf-8").split()[:2]
    assert {round(float(value)) for value in first} == {54, 10}
    assert main(["report", str(out)]) == 0
    report = json.loads((out / "report/report.json").read_text("utf-8"))
    assert report["coverage"]["overlap_m2"] > 1
    words = [f"1={out / 'survey.json'}", "--workers", "1", "10", "--out", str(tmp_path / "scaling")]
    assert main(["scaling", *words]) == 0
