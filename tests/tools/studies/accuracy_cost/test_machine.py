"""A commit names exactly what was measured."""

import subprocess
from pathlib import Path

import pytest
from studies.accuracy_cost.running import commit
from studies.accuracy_cost.study import AccuracyCostError

TOOL = "tools/studies/accuracy_cost"


def git(root: Path, *words: str) -> None:
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run(["git", *who, "-C", str(root), *words], check=True, capture_output=True)  # noqa: S603, S607


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A checkout of sources and texts."""
    git(tmp_path, "init", "-q")
    for name in ("mapperd/a.py", "docs/page.md", f"{TOOL}/plots.py", f"{TOOL}/mapping/a.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "first")
    return tmp_path


@pytest.mark.parametrize("name", ["docs/page.md", f"{TOOL}/plots.py"])
def test_texts_and_drawing_leave_figures_valid(root: Path, name: str) -> None:
    first = commit(root)
    (root / name).write_text("2")
    assert commit(root) == first
    git(root, "commit", "-qam", "text")
    assert commit(root) == first


@pytest.mark.parametrize("name", ["mapperd/a.py", f"{TOOL}/mapping/a.py"])
def test_sources_do_not(root: Path, name: str) -> None:
    first = commit(root)
    (root / name).write_text("2")
    git(root, "commit", "-qam", "source")
    assert commit(root) != first
    assert "+" not in commit(root)


def test_what_is_not_committed_has_a_name_by_its_content(root: Path) -> None:
    first = commit(root)
    names = []
    for content in ("2", "3", "2"):
        (root / "mapperd/a.py").write_text(content)
        names.append(commit(root))
    assert names[0] == names[2] != names[1]
    assert all(name.startswith(f"{first}+") for name in names)
    (root / "mapperd/new.py").write_text("")
    assert commit(root) not in (first, *names)


def test_no_checkout_is_reported(tmp_path: Path) -> None:
    with pytest.raises(AccuracyCostError, match="no checkout of git"):
        commit(tmp_path)
