"""Bins of probabilities, as they are drawn."""

from pathlib import Path

import numpy as np
from PIL import Image
from studies.accuracy_cost.plots import bins_of, draw_reliability, has_bins
from studies.accuracy_cost.results import StudyResults, key_of
from studies.accuracy_cost.study import DEFAULT, Study


def figures(voxels: int, solid: float = 0.5) -> dict[str, float]:
    """Ten bins; where the map has p, a share of p is occupied."""
    found: dict[str, float] = {}
    for i in range(10):
        p = i / 10 + 0.05
        found |= {f"bin{i}_said": p, f"bin{i}_solid": solid * p, f"bin{i}_voxels": voxels - 10 * i}
    return found


def test_a_bin_of_few_voxels_is_silent() -> None:
    bins = bins_of(figures(120))
    assert bins[:, 2].tolist() == [120, 110, 100]
    assert bins[2, :2].tolist() == [0.25, 0.125]


def test_a_diagram_has_a_line_for_each_configuration_that_is_measured(
    fake: Study, tmp_path: Path
) -> None:
    dive = fake.dives[0]
    results = StudyResults({}, list(figures(1000)), {key_of(DEFAULT, dive): figures(1000)})
    assert has_bins(results)
    draw_reliability(fake, results, tmp_path / "one.png")
    results.rows[key_of(fake.wholes[0], dive)] = figures(2000, 0.8)
    draw_reliability(fake, results, tmp_path / "two.png")
    assert colours(tmp_path / "one.png") == [True, False]
    assert colours(tmp_path / "two.png") == [True, True]


def colours(path: Path) -> list[bool]:
    """Whether there is the red of the default, and the violet of the published."""
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    wanted = ((214, 39, 40), (123, 50, 148))
    return [bool((np.abs(pixels - np.array(rgb)).max(axis=2) < 30).sum() > 50) for rgb in wanted]
