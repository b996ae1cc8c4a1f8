"""The run's figures as Markdown."""

from collections.abc import Iterator, Sequence

from bench.contenders import CONTENDERS, GRID_FULL, Contender
from bench.results import CaseResult, DetailDifference, Measured, Results, figure
from bench.targets import TARGETS, Target, fine_cases, judge

Row = Sequence[str]
ABSENT = "–"  # noqa: RUF001 a dash
COLUMNS = (
    *("map and input", "ms median", "ms p95", "second pass", "first ping (by the median)"),
    *("voxels a ping", "ns a voxel", "bytes a voxel (held)", "peak RSS MB", "memory share"),
)


def markdown(results: Results) -> str:
    """All tables of a run."""
    fine = fine_cases(results.cases)
    asked = [target for target in TARGETS if target.asked]
    told = [target for target in TARGETS if not target.asked]
    parts = [_machine(results), "## Asked and found", _summary(asked, fine), _targets(asked, fine)]
    parts += ["For information:", _targets(told, fine)]
    for look in dict.fromkeys(case.look for case in results.cases):
        cases = [case for case in results.cases if case.look == look]
        parts += [f"## Looking {look}", _loud(cases), _overview(cases)]
    compared = [(case.name, case.detail) for case in results.cases if case.detail]
    if compared:
        parts += ["## Detail 1 against detail 8", _details(compared)]
    if results.open_water:
        parts += ["## Open water, 10 cm", _open_water(results.open_water)]
    return "\n\n".join([*parts, "## Everything measured", *_all_cases(results)])


def _table(head: Row, rows: Sequence[Row]) -> str:
    """The first column is text, the others are figures."""
    rule = ["---", *("---:" for _ in head[1:])]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, rule, *rows))


def _machine(results: Results) -> str:
    at = results.machine
    return (
        f"`{results.command}` at commit `{at.commit}`: up to {results.pings} pings a case, seed "
        f"{results.seed}. {at.cpu}, {at.cores} cores, load {at.load:.1f} before the run; "
        f"{at.compiler}. Streaming read-modify-write of one thread: "
        f"{at.bytes_a_second / 1e9:.1f} GB/s, read and written bytes together."
    )


def _summary(targets: Sequence[Target], cases: Sequence[CaseResult]) -> str:
    judged = [judge(target, case) for target in targets for case in cases]
    limited = [verdict for verdict in judged if verdict.limit is not None]
    return (
        f"Met: {sum(verdict.met for verdict in limited)} of {len(limited)}. Missed ones are bold."
    )


def _targets(targets: Sequence[Target], cases: Sequence[CaseResult]) -> str:
    """A row a target, a column a case, each figure with its limit."""
    head = ["5 cm, one thread", *(f"{case.look}, {case.range_m:g} m" for case in cases)]
    rows = [[target.wish, *(f"{judge(target, case)}" for case in cases)] for target in targets]
    return _table(head, rows)


def _loud(cases: Sequence[CaseResult]) -> str:
    shares = {case.range_m: case.loud_share for case in cases}
    text = ", ".join(f"{share:.1%} at {range_m:g} m" for range_m, share in shares.items())
    return f"Pixels above the threshold: {text}."


def _overview(cases: Sequence[CaseResult]) -> str:
    """Medians of both passes: a row a contender, a column a case; then the cost of motion."""
    head = ["ms a ping, median: first pass, second pass", *(case.size for case in cases)]
    rows = [
        [contender.label, *(_medians(case.runs.get(contender.name)) for case in cases)]
        for contender in CONTENDERS
        if any(contender.name in case.runs for case in cases)
    ]
    ratios = [_motion(case.runs.get(GRID_FULL.name)) for case in cases]
    return _table(head, [*rows, [f"{GRID_FULL.label}: moving against at rest", *ratios]])


def _medians(run: Measured | None) -> str:
    return f"{figure(run.median_ms)}, {figure(run.second_median_ms)}" if run else ABSENT


def _motion(run: Measured | None) -> str:
    ratio = run.motion_ratio if run else None
    return ABSENT if ratio is None else f"{figure(ratio)}x"


def _details(compared: Sequence[tuple[str, DetailDifference]]) -> str:
    head = ("case, full image", "other class (known to one only)", "mean difference", "pings")
    rows = [
        (
            name,
            f"{found.class_share:.3%} ({found.one_only_share:.3%})",
            f"{found.mean:.2g}",
            f"{found.pings}",
        )
        for name, found in compared
    ]
    return _table(head, rows)


def _open_water(times_ms: dict[str, float]) -> str:
    head = ("range", *(f"{range_m} m" for range_m in times_ms))
    return _table(head, [("evidence grid", *(f"{figure(ms)} ms" for ms in times_ms.values()))])


def _all_cases(results: Results) -> Iterator[str]:
    bytes_a_second = results.machine.bytes_a_second
    for case in results.cases:
        rows = [
            _run(contender, case.runs[contender.name], bytes_a_second, results.pings)
            for contender in CONTENDERS
            if contender.name in case.runs
        ]
        yield f"**{case.name}**, {case.loud_share:.1%} of the pixels above the threshold:"
        yield _table(COLUMNS, rows)


def _run(contender: Contender, run: Measured, bytes_a_second: float, pings: int) -> Row:
    done = len(run.ms)
    fewer = "" if done == pings else f" ({done} ping{'s' if done > 1 else ''})"
    held = run.bytes_a_held_voxel
    rss_mb, start_mb = run.peak_rss_bytes / 1e6, run.start_rss_bytes / 1e6
    return (
        contender.label,
        f"{figure(run.median_ms)}{fewer}",
        figure(run.p95_ms),
        figure(run.second_median_ms),
        f"{figure(run.ms[0])} ({figure(run.first_ping_ratio)}x)",
        f"{run.touched_a_ping / 1e3:,.0f} k",
        figure(run.ns_a_voxel),
        f"{run.bytes_a_voxel:.1f}{'' if held is None else f' ({held:.1f})'}",
        f"{rss_mb:.0f} ({rss_mb - start_mb:.0f})",
        f"{run.memory_share(bytes_a_second):.1%}",
    )
