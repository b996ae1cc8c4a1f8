"""Figures, verdicts and the page, from made-up runs."""

import csv
import io
from pathlib import Path

import msgspec
import pytest
from bench.contenders import (
    BONXAI,
    CONTENDERS,
    GRID_FIRST,
    GRID_FULL,
    GRID_FULL_2,
    OCTOMAP,
    OPENVDB,
    RAYS_FULL,
    Contender,
)
from bench.inputs import AHEAD, DOWN
from bench.integrators import DETAILS
from bench.report import COLUMNS, details, markdown
from bench.results import (
    BenchResults,
    CaseResult,
    ContenderResult,
    DetailDifference,
    Machine,
    times_faster,
)
from bench.targets import CORNERS, TARGETS, TargetVerdict, judge
from studies.report import PAGES, write_section

RUN = ContenderResult(
    ms=[10.0, 30.0, 20.0],
    second_ms=[8.0, 9.0, 40.0],
    touched=[1000, None, 3000],
    memory_bytes=24_000,
    known_voxels=4000,
    held_voxels=8000,
    start_rss_bytes=10_000_000,
    peak_rss_bytes=25_000_000,
    resting_ms=[10.0, 20.0, 30.0],
    moving_ms=[22.0, 11.0, 33.0],
)
DETAIL = DetailDifference(pings=4, voxels=9, class_share=0.5, one_only_share=0.4, mean=0.1)


def run_of(ms: float) -> ContenderResult:
    return msgspec.structs.replace(RUN, ms=[ms] * 3, resting_ms=[ms] * 3, moving_ms=[ms] * 3)


def case_of(ours_ms: float = 1.0, rival_ms: float = 60.0, look: str = DOWN) -> CaseResult:
    """Our grid on anything takes the one time, everybody else the other."""
    runs = {c.name: run_of(ours_ms if c.name.startswith("grid") else rival_ms) for c in CONTENDERS}
    return CaseResult("10 m, 5 cm", look, 10.0, 0.05, 0.014, runs, DETAIL)


def results(case: CaseResult) -> BenchResults:
    machine = Machine("a CPU", 2, "a compiler", "abc", 0.5, 24e9)
    water_ms = {"5": 1.0, "10": 4.0}
    return BenchResults("a command", 3, 1, machine, [case], water_ms)


def verdict(word: str, case: CaseResult) -> TargetVerdict:
    """Of the first target with this word in its name."""
    return next(judge(target, case) for target in TARGETS if word in target.wish)


def test_figures_of_a_run() -> None:
    assert (RUN.median_ms, RUN.second_median_ms) == (20.0, 9.0)
    assert RUN.p95_ms == pytest.approx(29.0)
    assert RUN.first_ping_ratio == 0.5
    assert RUN.motion_ratio == pytest.approx(1.1)
    assert RUN.touched_a_ping == 2000
    assert RUN.ns_a_voxel == pytest.approx(30e6 / 4000)
    assert (RUN.bytes_a_voxel, RUN.bytes_a_held_voxel) == (6.0, 3.0)
    # 2000 voxels of 3 bytes, read and written, in 20 ms.
    assert RUN.memory_share(24e9) == pytest.approx(0.5e-6 / 20e-3)


def test_what_was_not_measured_has_no_figure() -> None:
    rival = msgspec.structs.replace(RUN, held_voxels=0, resting_ms=[], moving_ms=[])
    assert (rival.bytes_a_held_voxel, rival.motion_ratio) == (None, None)


def test_runs_of_unequal_length_are_compared_over_the_pings_of_both() -> None:
    slow = msgspec.structs.replace(RUN, ms=[100.0])
    assert times_faster(RUN, slow) == 10.0


@pytest.mark.parametrize(
    ("word", "limits"),
    [
        ("than our rays", (9, 13, 4.5, 3.5)),
        ("moonshot", (18, 26, 9, 7)),
        ("OpenVDB", (3, 3, 1.3, 1.3)),
        ("OctoMap", (35, 35, 35, 15)),
        ("at 40 Hz", (6.25, 6.25, None, None)),
        ("at 10 Hz", (None, None, 100, 100)),
        ("moving against", (1.15,) * 4),
        ("two threads", (1.7,) * 4),
        ("first ping", (2,) * 4),
        ("bytes", (4,) * 4),
        ("Bonxai", (None,) * 4),
    ],
)
def test_limits_by_case(word: str, limits: tuple[float | None, ...]) -> None:
    target = next(target for target in TARGETS if word in target.wish)
    assert tuple(target.limits.get(corner) for corner in CORNERS) == limits
    assert target.asked == (word not in ("moonshot", "Bonxai"))


def test_limits_depend_on_the_look() -> None:
    assert verdict("than our rays", case_of(1.0, 9.0)).met
    assert not verdict("than our rays", case_of(1.0, 12.9, look=AHEAD)).met
    assert verdict("than our rays", case_of(1.0, 13.0, look=AHEAD)).met


@pytest.mark.parametrize(
    ("word", "ours", "rival"),
    [
        ("than our rays", GRID_FULL, RAYS_FULL),
        ("OctoMap", GRID_FIRST, OCTOMAP),
        ("Bonxai", GRID_FIRST, BONXAI),
        ("OpenVDB", GRID_FIRST, OPENVDB[0]),
        ("OpenVDB", GRID_FIRST, OPENVDB[1]),
        ("two threads", GRID_FULL_2, GRID_FULL),
    ],
)
def test_speed_is_compared_on_the_same_input(word: str, ours: Contender, rival: Contender) -> None:
    case = case_of(1000.0, 1000.0)
    case.runs[ours.name], case.runs[rival.name] = run_of(2.0), run_of(14.0)
    assert verdict(word, case).found == 7.0


def test_the_time_between_pings_is_that_of_a_moving_sonar() -> None:
    case = case_of()
    slow = msgspec.structs.replace(RUN, moving_ms=[6.0, 6.2, 90.0])
    case.runs[GRID_FULL.name] = slow
    assert verdict("at 40 Hz", case).found == 6.2
    assert verdict("at 40 Hz", case).met
    assert verdict("at 10 Hz", case).found == pytest.approx(81.62)


def test_figures_of_the_full_image_come_from_one_thread() -> None:
    case = case_of()
    case.runs[GRID_FULL.name] = RUN
    assert verdict("moving against", case).found == pytest.approx(1.1)
    assert verdict("first ping", case).found == 0.5
    assert f"{verdict('bytes', case)}" == "3 (≤ 4)"


def test_a_missed_target_is_bold_and_not_counted_as_met() -> None:
    missed = verdict("OctoMap", case_of(1.0, 34.0))
    assert f"{missed}" == "**34x** (≥ 35)"
    assert not missed.met
    assert f"{verdict('OctoMap', case_of(1.0, 60.0))}" == "60x (≥ 35)"


def test_what_was_not_measured_is_reported_and_not_met() -> None:
    case = case_of()
    for rival in (*OPENVDB, BONXAI):
        del case.runs[rival.name]
    assert f"{verdict('OpenVDB', case)}" == "not measured"
    assert not verdict("OpenVDB", case).met
    page = markdown(results(case))
    assert "OpenVDB, each visit" not in page
    # Missed of the eight limits at 10 m: OpenVDB's, and that of two threads, as fast as one here.
    assert "Met: 6 of 8." in page


def test_a_part_of_the_run_has_no_other_tables() -> None:
    case = case_of()
    only = {name: case.runs[name] for name in (GRID_FULL.name, OCTOMAP.name)}
    part = results(msgspec.structs.replace(case, runs=only, detail=None))
    page = markdown(msgspec.structs.replace(part, open_water={}))
    assert "Open water" not in page
    assert "detail" not in page
    assert "not measured" in page


def test_tables_hold_both_passes_motion_and_details() -> None:
    case = case_of()
    case.runs[GRID_FULL.name] = RUN
    page = markdown(results(case))
    assert "Pixels above the threshold: 1.4% at 10 m." in page
    assert "| ours, evidence grid, full image | 20, 9 |" in page
    assert "| ours, evidence grid, full image: moving against at rest | 1.1x |" in page
    assert "| 10 m, 5 cm | 50.000% (40.000%) | 0.1 | 4 |" in page
    rows = list(csv.DictReader(io.StringIO(details(results(case)))))
    [row] = [row for row in rows if row["map and input"] == "ours, evidence grid, full image"]
    figures = ["20", "29", "9", "10 (0.5x)", "2 k", "7,500", "6.0 (3.0)", "25 (15)", "0.0%"]
    assert [row[column] for column in COLUMNS[1:]] == figures


def test_results_are_read_back_as_they_were_saved(tmp_path: Path) -> None:
    saved = results(case_of())
    saved.save(tmp_path / "results.json")
    assert msgspec.json.decode((tmp_path / "results.json").read_bytes(), type=BenchResults) == saved


def test_our_page_has_the_marks_and_explains_every_column(tmp_path: Path) -> None:
    copy = tmp_path / "performance.md"
    copy.write_text(PAGES["performance"].read_text(encoding="utf-8"), encoding="utf-8")
    write_section(copy, "integrators", "new")
    write_section(copy, "integrators", markdown(results(case_of())))
    explained = copy.read_text(encoding="utf-8").partition("<!-- integrators")[0].lower()
    for column in COLUMNS[3:]:
        assert column.partition(" (")[0].removesuffix(" MB").lower() in explained
    assert DETAILS.read_text(encoding="utf-8").startswith("case," + ",".join(COLUMNS))
    with pytest.raises(ValueError, match="no section"):
        write_section(copy, "another section", "text")
