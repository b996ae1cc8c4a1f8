"""What a result is of: while that is as it was, the result need not be measured again."""

import hashlib
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from mutations.catalogue import Mutation

__all__ = ["files_of", "stamp"]


def stamp(mutation: Mutation, tests: Sequence[str], root: Path) -> str:
    """A digest of the mutation, the whole file that it breaks, and the files of some tests.

    Args:
        mutation: only its texts count, so that other words for what it breaks change nothing.
        tests: the one that killed it, or all that it survived.
        root: of the tree whose files count.
    """
    told = hashlib.sha256()
    paths = [root / mutation.file, *(path for test in tests for path in files_of(test, root))]
    for text in (mutation.old, mutation.new, *tests, *(path.read_text() for path in paths)):
        told.update(f"{len(text)}:{text}".encode())
    return told.hexdigest()[:16]


def files_of(test: str, root: Path) -> Iterator[Path]:
    """The files that hold an entry of `killed_by`; none where it is nowhere."""
    if test.startswith("tests/"):
        yield from (root / word.partition("::")[0] for word in test.split())
        return
    part = test.partition(": ")[2]
    yield from (path for path, cases in _cases(root) if any(part in case for case in cases))


@cache
def _cases(root: Path) -> tuple[tuple[Path, tuple[str, ...]], ...]:
    """Each file of C++ tests with the names of its cases."""
    found = []
    for path in sorted((root / "cpp" / "test").rglob("test_*.cpp")):
        cases = re.findall(r'TEST_CASE\(\s*"([^"]+)"', path.read_text())
        found.append((path, tuple(cases)))
    return tuple(found)
