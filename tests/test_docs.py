"""The site: links lead somewhere, shell blocks run, and mkdocs builds it without a warning."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import shell_blocks
from tests.support.shell_blocks import Block, blocks_of, follow
from tests.support.stages import STAGES

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
MANUALS = [page for page in PAGES if page.parent.name in ("getting-started", "guides")]
MAX_WORDS = 70_000
"""Of the written pages, which are the Markdown files of docs/. What mkdocstrings makes from
docstrings is not counted, nor are the bars of tables."""


def anchors(page: Path) -> set[str]:
    """The anchors that a page's headings get."""
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    plain = (re.sub(r"[^\w\s-]", "", title.lower()).strip() for title in titles)
    return {re.sub(r"[-\s]+", "-", title) for title in plain}


def words_of(text: str) -> int:
    """Number of words; a word has a letter or a digit."""
    return sum(any(map(str.isalnum, word)) for word in text.split())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", page.read_text("utf-8")):
        if "://" in target:
            continue
        file = (page.parent / target) if target else page
        assert file.is_file(), target
        assert file.resolve().is_relative_to(DOCS), f"{target} is not on the site"
        assert not anchor or anchor in anchors(file), f"{target}#{anchor}"


def test_the_site_is_short() -> None:
    assert sum(words_of(page.read_text("utf-8")) for page in PAGES) < MAX_WORDS


def test_words_have_a_letter_or_a_digit() -> None:
    assert words_of("| two words | - | 1.5 |\n|---|---:|\n") == 3


@pytest.mark.slow
def test_the_site_builds_strictly(tmp_path: Path) -> None:
    pytest.importorskip("mkdocstrings")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(  # noqa: S603 our own site
        command, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "index.html").is_file()


@pytest.mark.parametrize("page", MANUALS, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_every_block_of_commands_and_its_marker_are_found(page: Path) -> None:
    text, blocks = page.read_text("utf-8"), blocks_of(page)
    assert len(blocks) == len(re.findall(r"^\s*```(?:sh|bash|shell|console)\b", text, re.MULTILINE))
    assert text.count("<!--") == sum(block != Block(block.code) for block in blocks)


@pytest.mark.parametrize("page", MANUALS, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_tests_that_run_blocks_of_a_page_read_it(page: Path) -> None:
    for block in blocks_of(page):
        if block.tested:
            file, _, name = block.tested.partition("::")
            text = (ROOT / file).read_text("utf-8")
            assert f"def {name}(" in text, block.tested
            assert page.name in text, f"{file} does not read {page.name}"


def test_a_block_without_a_way_to_run_is_refused(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("<!-- not run: needs a sonar -->\n```sh\ntrue\n```\n")
    with pytest.raises(ValueError, match="unknown marker"):
        blocks_of(tmp_path / "page.md")


def test_a_block_that_fails_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("```sh\nfalse\ntrue\n```\n")
    with pytest.raises(AssertionError, match="false"):
        follow(tmp_path / "page.md", tmp_path)


def test_each_line_runs_until_a_command_succeeds(tmp_path: Path) -> None:
    lines = 'bash -c "trap exit\\ 0 INT; echo up | tee -a log; while :; do sleep 0.1; done"\n' * 2
    until = f"<!-- until: grep -q up $OUTPUT -->\n```sh\n{lines}```\n"
    text = f"{until}```sh\ntest $(grep -c up log) = 2\n```\n"
    (tmp_path / "page.md").write_text(text)
    follow(tmp_path / "page.md", tmp_path)


def test_a_block_runs_before_what_shows_its_effect(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("<!-- then: test -s log -->\n```sh\necho up > log\n```\n")
    follow(tmp_path / "page.md", tmp_path)


def test_a_block_without_effect_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell_blocks, "READY_TIMEOUT_S", 0.0)
    (tmp_path / "page.md").write_text("<!-- then: test -s log -->\n```sh\ntrue\n```\n")
    with pytest.raises(AssertionError, match="test -s log"):
        follow(tmp_path / "page.md", tmp_path)


def test_a_line_that_ends_by_itself_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("<!-- until: test -s log -->\n```sh\ntrue\n```\n")
    with pytest.raises(AssertionError, match="true"):
        follow(tmp_path / "page.md", tmp_path)


@pytest.mark.slow
def test_commands_of_the_installation_page_run(tmp_path: Path) -> None:
    follow(DOCS / "getting-started" / "install.md", tmp_path)


@pytest.mark.slow
@pytest.mark.net
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "page",
    [page for page in MANUALS if any(not block.tested for block in blocks_of(page))],
    ids=lambda page: page.relative_to(DOCS).as_posix(),
)
def test_shell_blocks_of_a_page_run(page: Path, tmp_path: Path) -> None:
    follow(page, tmp_path, stage=STAGES.get(page.stem))
