"""Long runs in short: ours stays near the oracle; and no single precision is left out."""

import os
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studies.numerics.growth import Curve, GrowthPanel
from studies.numerics.run import GROWTHS, PAGE, PICTURE, PLACES, growth_table, places_table
from studies.numerics.single_places import SingleError
from studies.numerics.sources import MEASURED, NOT_MEASURED

ROOT = Path(__file__).resolve().parents[3]
MAX_ERRORS = {
    "log-odds": 0.05,
    "rad; part": 1e-13,
    "m": 1e-10,
    "s": 2e-3,
    "part of the weight": 1e-10,
}


@pytest.mark.parametrize("grow", GROWTHS, ids=lambda grow: grow.__name__)
def test_ours_stays_near_the_oracle(grow: object) -> None:
    assert callable(grow)
    panel: GrowthPanel = grow(500)
    assert panel.updates[-1] == 500
    ours, *others = panel.curves
    assert ours.ours
    assert not any(curve.ours for curve in others)
    assert np.nanmax(ours.error) <= MAX_ERRORS.get(panel.unit, 1e-3)


def test_every_source_with_single_precision_is_measured_and_on_the_page() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert [place.where for place in PLACES] == list(MEASURED)
    for place in PLACES:
        assert f"| {place.where} | {place.what} |" in page
        assert f"in numpy: {place.numpy} |" in page or not place.numpy
    assert all(f"| {reason} |" in page for reason in NOT_MEASURED)


def test_each_source_with_single_precision_is_in_one_list_and_no_other_is() -> None:
    named = [name for names in (*MEASURED.values(), *NOT_MEASURED.values()) for name in names]
    twice = {name for name, times in Counter(named).items() if times > 1}
    assert not twice
    assert set(named) == {str(path.relative_to(ROOT)) for path in sources()}


def sources() -> set[Path]:
    """With single precision in Python, or float in C++, comments aside."""
    rooms = ("mapperd", "oculus_driver", "tools/sonar_sim", "tools/mapper_survey")
    folders = [ROOT / name for name in rooms]
    python = re.compile(r'np\.(float32|complex64)|"float32"|"<f4"')
    scripts = [path for folder in folders for path in folder.rglob("*.py")]
    found = {path for path in scripts if python.search(path.read_text(encoding="utf-8"))}
    for path in (ROOT / "cpp").rglob("*.[ch]pp"):
        text = re.sub(r"//.*", "", path.read_text(encoding="utf-8"))
        if not {"test", "bench"} & set(path.parts) and re.search(r"\bfloat\b", text):
            found.add(path)
    return found


def test_the_picture_is_on_the_page() -> None:
    assert PICTURE.is_file()
    assert f"({os.path.relpath(PICTURE, PAGE.parent)})" in PAGE.read_text(encoding="utf-8")


def test_tables_report_where_numbers_end() -> None:
    curves = (
        Curve("ours", np.array([0.0, 1e-9]), ours=True),
        Curve("plain", np.array([1, np.nan]), ours=False),
    )
    table = growth_table([GrowthPanel("sums", "m", np.array([1, 1000]), curves, "fractions")])
    assert "| sums | ours | m | 0 | 1.0e-09 | fractions |" in table
    assert "| sums | plain | m | 1.0e+00 | no number | fractions |" in table
    row = places_table([(PLACES[0], SingleError("1 m", "lost"))]).splitlines()[-1]
    assert row.endswith(f"| 1 m | lost | {PLACES[0].enough} | of the product |")
    row = places_table([(replace(PLACES[0], numpy="so"), SingleError("1 m", "lost"))])
    assert row.endswith("| in numpy: so |")
