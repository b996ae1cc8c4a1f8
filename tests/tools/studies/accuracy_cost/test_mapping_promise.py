"""What was promised beside the published settings, on figures made up for it."""

import pytest
from studies.accuracy_cost.mapping.knobs import PUBLISHED, PUBLISHED_FILE, PUBLISHED_SHIPPED
from studies.accuracy_cost.mapping.promise import evidence, kept, sentences


def row(error_m: float, cpu_ms: float, log_odds: float = float("nan")) -> dict[str, float]:
    return {"surface_error_m": error_m, "ping_cpu_ms": cpu_ms, "log_odds_error": log_odds}


ROWS = {
    "": row(0.10, 80.0, 0.01),
    PUBLISHED.key: row(0.30, 20.0),
    PUBLISHED_SHIPPED.key: row(0.05, 100.0),
    PUBLISHED_FILE.key: row(0.31, 10.0),
    "mapping.integrator=rays": row(0.01, 1.0, 5.0),
    "octree.voxel_resolution=0.1": row(0.12, 20.0),
    "octree.voxel_resolution=0.2": row(0.30, 2.0),
    "octree.voxel_resolution=0.4": row(0.31, 1.0),
}


def test_the_cheapest_of_no_more_error_and_the_best_of_no_more_time() -> None:
    found = kept(ROWS)
    assert found.cheapest == "octree.voxel_resolution=0.2"
    assert found.times_cheaper == pytest.approx(10.0)
    assert found.best == "octree.voxel_resolution=0.1"
    assert found.times_more_exact == pytest.approx(2.5)
    assert (found.default_error_m, found.default_cost_ms) == (0.10, 80.0)
    assert found.is_kept


def test_where_nothing_of_ours_is_as_exact_the_promise_is_broken() -> None:
    found = kept(ROWS, PUBLISHED_SHIPPED.key)
    assert (found.cheapest, found.times_cheaper) == (None, 0.0)
    assert found.times_more_exact == pytest.approx(0.5)
    assert not found.is_kept


def test_evidence_is_compared_with_rays_alone() -> None:
    found = evidence(ROWS)
    assert found.times_more_exact == pytest.approx(500.0)
    assert found.times_dearer == pytest.approx(80.0)


def test_sentences_name_each_dive_and_what_was_not_kept() -> None:
    text = sentences({"pond": ROWS})
    assert "| pond | published | 0.300 m, 20.0 ms | 10 times cheaper" in text
    assert "| pond | published, its file at 0.2 m | 0.310 m, 10.0 ms | 10 times cheaper" in text
    assert "| error 2.00 times larger (`" in text
    assert text.count("**no**") == 2


def test_sentences_report_where_none_of_ours_comes_near() -> None:
    rows = {
        "": row(0.4, 80.0, 0.01),
        PUBLISHED.key: row(0.3, 1.0),
        PUBLISHED_SHIPPED.key: row(0, 1),
        PUBLISHED_FILE.key: row(0.2, 0.5),
    }
    text = sentences({"pond": rows | {"mapping.integrator=rays": row(0.01, 1.0, 5.0)}})
    assert "| none errs so little | none takes so little | **no** |" in text
    assert "None" not in text
