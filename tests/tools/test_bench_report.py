"""Figures, verdicts and the page, from made-up runs."""

from pathlib import Path

import msgspec
import pytest
from accuracy import Accuracy
from bench_input import AHEAD, DOWN
from bench_report import BEGIN, END, markdown, put_into
from bench_tables import per_voxel
from contenders import (
    CONTENDERS,
    DEFAULT_FIRST,
    DEFAULT_FULL,
    EXACT_FIRST,
    FIRST,
    FULL,
    OCTOMAP,
    OPENVDB,
)
from measured import Measured, times_faster
from results import CaseResult, Machine, Results, read_results
from targets import verdicts

PAGE = Path(__file__).resolve().parents[2] / "docs" / "performance.md"
RUN = Measured(
    ms=[10.0, 30.0, 20.0],
    touched=[1000, None, 3000],
    memory_bytes=24_000,
    known_voxels=4000,
    start_rss_bytes=10_000_000,
    peak_rss_bytes=25_000_000,
)
SAMPLED = Accuracy(
    pings=1, voxels=9, class_share=0.5, one_only_share=0.4, mean=1.0, p95=3.0, mean_of_shared=0.1
)


def run_of(ms: float) -> Measured:
    return msgspec.structs.replace(RUN, ms=[ms, ms, ms])


def results(exact_ms: float = 1.0, rival_ms: float = 60.0, look: str = DOWN) -> Results:
    runs = {c.name: run_of(exact_ms if c.name == EXACT_FIRST else rival_ms) for c in CONTENDERS}
    accuracy = {takes: {"rays": SAMPLED, "default": SAMPLED} for takes in (FIRST, FULL)}
    return Results(
        command="a command",
        pings=3,
        seed=1,
        error_bound=0.25,
        machine=Machine("a CPU", 2, "a compiler", "abc", 0.5, 24e9),
        cases=[CaseResult("10 m, 5 cm", look, 10.0, 0.05, 0.014, runs, accuracy)],
        open_water={
            "exact": {"5": 1.0, "10": 4.0, "20": 17.9},
            "default": {"5": 1.0, "10": 3.1, "20": 4.0},
        },
    )


def met(of: Results) -> dict[str, bool]:
    return {verdict.wish: verdict.met for verdict in verdicts(of)}


def test_figures_of_a_run() -> None:
    assert RUN.median_ms == 20.0
    assert RUN.p95_ms == pytest.approx(29.0)
    assert RUN.touched_a_ping == 2000
    assert RUN.touched_a_second == pytest.approx(4000 / 0.030)
    assert RUN.bytes_a_voxel == 6.0
    assert RUN.bound_ms(24e9) == pytest.approx(1e-3)  # 2000 voxels, 6 bytes, read and written


def test_runs_of_unequal_length_are_compared_over_the_pings_of_both() -> None:
    slow = msgspec.structs.replace(RUN, ms=[100.0])
    assert times_faster(RUN, slow) == 10.0


def test_speed_is_judged_against_each_rival() -> None:
    fast = met(results(exact_ms=1.0, rival_ms=60.0))
    assert fast["10 m, 5 cm: exact on first returns at least 50x faster than OctoMap"]
    slow = met(results(exact_ms=1.0, rival_ms=49.0))
    assert not slow["10 m, 5 cm: exact on first returns at least 50x faster than OctoMap"]
    assert slow["10 m, 5 cm: exact on first returns at least 2x faster than the faster OpenVDB"]


def test_the_faster_openvdb_counts() -> None:
    one_fast = results()
    one_fast.cases[0].runs[OPENVDB[1].name] = run_of(1.9)
    wish = "10 m, 5 cm: exact on first returns at least 2x faster than the faster OpenVDB"
    assert not met(one_fast)[wish]


def test_a_rival_that_is_missing_is_said_and_not_met() -> None:
    alone = results()
    for rival in OPENVDB:
        del alone.cases[0].runs[rival.name]
    judged = [v for v in verdicts(alone) if "OpenVDB" in v.wish]
    assert [(v.found, v.met, v.asked) for v in judged] == [
        ("not measured", False, True),
        ("not measured", False, False),
    ]
    assert "OpenVDB, each visit" not in markdown(alone)


def test_growth_is_judged_by_the_worst_doubling() -> None:
    judged = met(results())
    assert judged["open water, exact: each doubling of the range costs less than 4.5x"]
    assert not judged["open water, default: each doubling of the range costs less than 3x"]


def test_medians_are_judged_in_all_four_ways() -> None:
    judged = met(results(exact_ms=19.9, rival_ms=20.0))
    assert judged["10 m, 5 cm: one thread, exact, first returns: median under 20 ms"]
    vehicle = "default bound, full image (what a vehicle runs)"
    assert not judged[f"10 m, 5 cm: one thread, {vehicle}: median under 20 ms"]


def test_medians_are_asked_looking_down_and_told_looking_ahead() -> None:
    for look, name in ((DOWN, "10 m, 5 cm"), (AHEAD, "10 m, 5 cm (dense seabed)")):
        medians = [v for v in verdicts(results(look=look)) if "median" in v.wish]
        assert len(medians) == 4
        assert all(v.wish.startswith(f"{name}: ") for v in medians)
        assert {v.asked for v in medians} == {look == DOWN}


@pytest.mark.parametrize("look", [DOWN, AHEAD])
def test_ratios_are_asked_of_exact_and_told_of_the_default(look: str) -> None:
    run = results(exact_ms=1.0, rival_ms=60.0, look=look)
    run.cases[0].runs[DEFAULT_FIRST] = run_of(30.0)
    ratios = {v.wish.partition(": ")[2]: v for v in verdicts(run) if "faster than" in v.wish}
    exact = ratios["exact on first returns at least 50x faster than OctoMap"]
    assert (exact.asked, exact.met, exact.found) == (True, True, "60x")
    default = ratios["default bound on first returns at least 50x faster than OctoMap"]
    assert (default.asked, default.met, default.found) == (False, False, "2x")


def test_a_part_of_the_run_says_what_was_not_measured() -> None:
    whole = results()
    case = whole.cases[0]
    only = {name: case.runs[name] for name in (DEFAULT_FULL, OCTOMAP.name)}
    part = msgspec.structs.replace(
        whole,
        cases=[msgspec.structs.replace(case, runs=only, accuracy={})],
        open_water={},
    )
    found = {v.wish: v.found for v in verdicts(part)}
    assert len(found) == len(verdicts(whole))
    (measured,) = [wish for wish, said in found.items() if said != "not measured"]
    assert "default bound, full image" in measured
    assert "Open water" not in markdown(part)


def test_cost_of_a_voxel_is_compared_on_the_same_first_returns() -> None:
    run = results(exact_ms=1.0, rival_ms=60.0)
    twice = msgspec.structs.replace(run_of(4.0), touched=[4000, None, 4000])
    run.cases[0].runs[EXACT_FIRST] = twice
    run.cases[0].runs[OPENVDB[1].name] = run_of(2.0)
    *_, line = per_voxel(run.cases).splitlines()
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    # 60 ms for 2 k voxels; the faster OpenVDB; rays; exact; default; and the ratios.
    assert cells[1:4] == ["2 k, 30,000 ns", "2 k, 1,000 ns", "2 k, 30,000 ns"]
    assert cells[4:6] == ["4 k, 1,000 ns", "2 k, 30,000 ns"]
    assert cells[6:] == ["30x, 1x", "1x, 0.0333x"]


def test_a_look_says_how_many_pixels_are_loud() -> None:
    assert "Pixels above the threshold: 1.4% at 10 m." in markdown(results())


def test_results_are_read_back_as_they_were_saved(tmp_path: Path) -> None:
    results().save(tmp_path / "results.json")
    assert read_results(tmp_path / "results.json") == results()


def test_text_stands_between_the_marks_and_the_rest_stays(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    put_into(page, "new")
    put_into(page, "newer")
    assert page.read_text() == f"before\n{BEGIN}\n\nnewer\n\n{END}\nafter\n"


def test_a_page_without_marks_is_left_alone(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n")
    with pytest.raises(ValueError, match="no section"):
        put_into(page, "new")
    assert page.read_text() == "before\n"


def test_our_page_has_the_marks_and_explains_every_column(tmp_path: Path) -> None:
    copy = tmp_path / "performance.md"
    copy.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    put_into(copy, markdown(results()))
    explained = copy.read_text(encoding="utf-8").partition(BEGIN)[0].lower()
    for column in ("voxels a ping", "bytes a voxel", "peak rss", "times the bound"):
        assert column in explained
