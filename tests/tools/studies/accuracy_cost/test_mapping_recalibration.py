"""The fitted curve: against truths made up for it, and the shipped one as it stands in its file."""

from pathlib import Path

import numpy as np
import pytest
from studies.accuracy_cost.mapping.metrics import reliability
from studies.accuracy_cost.mapping.recalibration import FILE, fit, table, written

from mapperd.export.calibration import load_calibration


def overconfident(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Voxels whose log-odds are three times what their shares are."""
    random = np.random.default_rng(seed)
    true = random.normal(0.0, 1.5, count)
    return 3.0 * true, random.random(count) < 1.0 / (1.0 + np.exp(-true))


def test_overconfidence_is_found_out_on_other_voxels() -> None:
    curve = fit(*overconfident(60_000, 1))
    log_odds, solid = overconfident(60_000, 2)
    assert reliability(log_odds, solid).worst > 0.2
    mended = reliability(curve.log_odds_of(log_odds), solid)
    assert mended.worst < 0.03
    assert mended.expected < 0.02
    assert curve.log_odds_of(np.array([3.0])) == pytest.approx([1.0], abs=0.15)


def test_what_falls_is_pooled() -> None:
    log_odds = np.repeat([-3.0, 0.0, 3.0], 1000)
    solid = np.concatenate([np.arange(1000) < n for n in (100, 700, 500)])
    curve = fit(log_odds, solid)
    reported = 1.0 / (1.0 + np.exp(-curve.log_odds_of(np.array([-3.0, 0.0, 3.0]))))
    assert reported == pytest.approx([0.1, 0.6, 0.6], abs=2e-3)


def test_voxels_alike_stay_together() -> None:
    log_odds = np.concatenate([np.full(5000, -3.0), np.full(100, -2.9)])
    solid = np.concatenate([np.arange(5000) < 500, np.arange(100) < 40])
    reported = 1.0 / (1.0 + np.exp(-fit(log_odds, solid).log_odds_of(np.array([-3.0, -2.9]))))
    assert reported == pytest.approx([0.1, 0.4], abs=5e-3)


def test_file_holds_the_curve(tmp_path: Path) -> None:
    curve = fit(*overconfident(20_000, 3))
    path = tmp_path / "curve.yaml"
    path.write_text(written(curve, "# Of a test."))
    read = load_calibration(path)
    assert len(read.log_odds) < len(curve.log_odds)
    anywhere = np.linspace(-12.0, 12.0, 500)
    assert read.log_odds_of(anywhere) == pytest.approx(curve.log_odds_of(anywhere), abs=0.05)


def test_the_shipped_curve_trusts_the_map_less_than_it_trusts_itself() -> None:
    curve = load_calibration(FILE)
    reported = curve.probability_of(np.array([0.0, 0.001, 0.7, 0.99, 1.0]))
    assert 0.0 < reported[0] < reported[1] < 0.3
    assert 0.5 < reported[2] <= reported[3] == pytest.approx(reported[4], abs=0.02)
    assert reported[4] < 0.7


def test_table_reports_both_errors() -> None:
    log_odds, solid = overconfident(20_000, 4)
    text = table(log_odds, solid, fit(log_odds, solid))
    assert text.count("\n") == 13
    raw, mended = (float(part.split()[-1]) for part in text.splitlines()[-1].split(";"))
    assert mended < 0.1 < raw
