"""The mutation check's own judge: what counts as killed, and a catalogue that has not rotted."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from mutations.catalogue import CATALOGUE, REPOSITORY, Mutation, load, mutated
from mutations.judge import TEST_TIMEOUT_S, End, is_endless, judge_cpp, judge_pytest
from mutations.results import MutationResults, Result, table
from mutations.stamp import stamp, texts_of

MUTATIONS = load()


def one(**changes: str) -> Mutation:
    fields = {"name": "a/b/c", "file": "x.py", "old": "1", "new": "2", "breaks": "it is wrong"}
    return Mutation(**{**fields, **changes}, killed_by=("tests/x.py",))  # type: ignore[arg-type]


def result(outcome: str, stamp: str = "abc") -> Result:
    test = "tests/x.py" if outcome == "killed" else ""
    return Result("a/b/c", outcome, test, "", 1.0, "1234567", stamp)


def test_every_mutation_finds_its_text_once_and_leaves_python_that_compiles() -> None:
    texts = {file: (REPOSITORY / file).read_text() for file in {each.file for each in MUTATIONS}}
    for each in MUTATIONS:
        broken = mutated(each, texts[each.file])
        if not each.is_cpp:
            compile(broken, each.file, "exec")


def test_every_test_that_is_named_is_there() -> None:
    sources = (REPOSITORY / "cpp").rglob("test_*.cpp")
    found = [re.findall(r'TEST_CASE\(\s*"([^"]+)"', path.read_text()) for path in sources]
    cases = [case for each in found for case in each]
    for test in {test for each in MUTATIONS for test in each.killed_by}:
        if test.startswith("tests/"):
            path, _, name = test.partition("::")
            assert (REPOSITORY / path).exists(), test
            assert not name or f"def {name}(" in (REPOSITORY / path).read_text(), test
        else:
            assert any(test.partition(": ")[2] in case for case in cases), test


def test_the_catalogue_has_the_rooms_and_at_least_eighty_mutations() -> None:
    assert len(MUTATIONS) >= 80
    rooms = {each.file.partition("/")[0] for each in MUTATIONS}
    assert rooms == {"cpp", "mapperd", "oculus_driver", "tools"}
    assert all(path.suffix == ".yaml" for path in CATALOGUE.iterdir())


def test_a_text_that_is_not_there_or_twice_is_refused() -> None:
    for text in ("", "1 1"):
        with pytest.raises(ValueError, match="times in"):
            mutated(one(), text)
    with pytest.raises(ValueError, match="changes nothing"):
        mutated(one(new="1"), "1")
    assert mutated(one(), "x = 1\n") == "x = 2\n"


FAILED = "FAILED tests/x.py::test_a - {}\n1 failed in 0.1s\n"


@pytest.mark.parametrize(
    ("code", "out", "how"),
    [
        (0, "1 passed", "passed"),
        (1, FAILED.format("assert 1 == 2"), "failed"),
        (1, FAILED.format("NameError: name 'x' is not defined"), "broken"),
        (1, FAILED.format("ImportError: cannot import name 'x'"), "broken"),
        (1, FAILED.format("Failed: Timeout >300.0s"), "hang"),
        (1, "ERROR tests/x.py::test_a - fixture\n1 error in 0.1s\n", "broken"),
        (2, "ERROR tests/x.py\n", "broken"),
        (5, "no tests ran", "broken"),
        (-11, "", "crash"),
    ],
)
def test_pytest_counts_as_failed_only_where_a_test_failed(code: int, out: str, how: str) -> None:
    assert judge_pytest(code, out).how == how


@pytest.mark.parametrize(
    ("code", "out", "how"),
    [
        (0, "[doctest] test cases: 2 | 2 passed | 0 failed | 7 skipped\n", "passed"),
        (1, "a.cpp:7: ERROR: x == y\n[doctest] test cases:  1 | 0 passed | 1 failed |\n", "failed"),
        (0, "[doctest] test cases: 0 | 0 passed | 0 failed | 9 skipped\n", "broken"),
        (1, "something else\n", "broken"),
        (-6, "", "crash"),
    ],
)
def test_a_cpp_program_counts_as_failed_only_by_its_own_checks(
    code: int, out: str, how: str
) -> None:
    assert judge_cpp(code, out).how == how


def test_a_time_limit_counts_only_if_the_unbroken_test_is_far_below_it() -> None:
    assert is_endless(End("hang"), End("passed", seconds=0.1 * TEST_TIMEOUT_S))
    assert not is_endless(End("hang"), End("passed", seconds=0.5 * TEST_TIMEOUT_S))
    assert not is_endless(End("failed"), End("passed", seconds=1.0))


def test_the_newest_result_counts(tmp_path: Path) -> None:
    results = MutationResults(tmp_path / "deep" / "results.jsonl")
    assert results.of(one()) is None
    results.add(result("survived"))
    results.add(result("killed", "def"))
    assert MutationResults(tmp_path / "deep" / "results.jsonl").of(one()) == result("killed", "def")


def tree(folder: Path) -> Path:
    cases = folder / "cpp" / "map" / "test"
    cases.mkdir(parents=True)
    (folder / "tests").mkdir()
    (folder / "x.py").write_text("1\n")
    (folder / "tests" / "x.py").write_text("assert x\n")
    (folder / "tests" / "y.py").write_text("assert y\n")
    (cases / "test_one.cpp").write_text('int help;\nTEST_CASE("one") {\n  a;\n}\n')
    two = 'TEST_CASE("two") {\n  b;\n}\n\nint more;\n\nTEST_CASE(\n    "three") {\n  c;\n}\n'
    (cases / "test_two.cpp").write_text(two)
    return folder


def test_a_test_is_its_file_or_its_case_with_what_is_around_it(tmp_path: Path) -> None:
    root = tree(tmp_path)
    assert list(texts_of("tests/x.py::test_a", root)) == ["assert x\n"]
    assert list(texts_of("tests/", root)) == list(texts_of("tests/x.py tests/y.py", root))
    assert list(texts_of("program: one", root)) == ['int help;\nTEST_CASE("one") {\n  a;\n}\n']
    two = 'TEST_CASE("two") {\n  b;\n}\n\nint more;\n\n'
    assert list(texts_of("program: two", root)) == [two]
    assert list(texts_of("program: t", root)) == [two + 'TEST_CASE(\n    "three") {\n  c;\n}\n']


def test_a_result_is_of_the_mutation_its_file_and_its_killer(tmp_path: Path) -> None:
    root = tree(tmp_path)
    results = MutationResults(tmp_path / "results.jsonl")
    assert not results.is_done(one(), root)
    results.add(result("killed", stamp(one(), ("tests/x.py",), root)))
    assert results.is_done(one(), root)
    assert results.is_done(one(breaks="in other words"), root)
    two = ("tests/y.py", "tests/x.py")
    assert results.is_done(replace(one(), killed_by=two), root)  # a test more changes nothing
    assert not results.is_done(replace(one(), killed_by=("tests/y.py",)), root)
    assert not results.is_done(one(new="3"), root)
    for path in (root / "x.py", root / "tests" / "x.py"):
        text = path.read_text()
        path.write_text(text + "\n")
        assert not results.is_done(one(), root)
        path.write_text(text)
    results.add(result("broken", stamp(one(), ("tests/x.py",), root)))
    assert not results.is_done(one(), root)


def test_a_survivor_is_measured_again_when_any_of_its_tests_is_new(tmp_path: Path) -> None:
    root = tree(tmp_path)
    results = MutationResults(tmp_path / "results.jsonl")
    results.add(result("survived", stamp(one(), ("tests/x.py",), root)))
    assert results.is_done(one(), root)
    assert not results.is_done(replace(one(), killed_by=("tests/x.py", "tests/y.py")), root)


def test_the_page_counts_the_whole_catalogue(tmp_path: Path) -> None:
    page = (REPOSITORY / "docs" / "reports" / "mutations.md").read_text()
    measured = page.partition("<!-- mutations: begin")[2].partition("<!-- mutations: end")[0]
    rows = [line.strip("| ").split(" | ") for line in measured.splitlines() if line[:1] == "|"]
    counts = {row[0]: [int(number) for number in row[1:]] for row in rows[2:]}
    areas = {each.area for each in MUTATIONS}
    assert set(counts) == areas | {"all"}
    for area, (files, mutations, killed, survived, waiting) in counts.items():
        chosen = [each for each in MUTATIONS if area in (each.area, "all")]
        assert (files, mutations) == (len({each.file for each in chosen}), len(chosen))
        assert killed + survived + waiting == mutations
        assert survived <= sum(bool(each.survives) for each in chosen)
    # A new mutation is on the page before a run has measured it.
    assert counts["all"][4] < len(MUTATIONS) / 4
    assert "**not explained**" not in measured
    results = MutationResults(tmp_path / "results.jsonl")
    for each in MUTATIONS:
        ended = ("survived", "") if each.survives else ("killed", each.killed_by[0])
        results.add(Result(each.name, *ended, "", 1.0, "1234567", ""))
    survivors = {line for line in measured.splitlines() if line.startswith("- `")}
    assert survivors <= set(table(MUTATIONS, results).splitlines())
    assert len(survivors) == counts["all"][3]
