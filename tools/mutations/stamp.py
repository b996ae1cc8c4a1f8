"""What a result is of: while that is as it was, the result need not be measured again."""

import hashlib
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from mutations.catalogue import Mutation

__all__ = ["stamp", "texts_of"]


CASE = re.compile(r'^TEST_CASE\(\s*"([^"]+)".*?^}\n', re.MULTILINE | re.DOTALL)


def stamp(mutation: Mutation, tests: Sequence[str], root: Path) -> str:
    """A digest of the mutation, the whole file that it breaks, and of what some tests are.

    Args:
        mutation: only its texts count, so that other words for what it breaks change nothing.
        tests: the one that killed it, or all that it survived.
        root: of the tree whose files count.
    """
    digest = hashlib.sha256()
    texts = [text for test in tests for text in texts_of(test, root)]
    for text in (mutation.old, mutation.new, (root / mutation.file).read_text(), *tests, *texts):
        digest.update(f"{len(text)}:{text}".encode())
    return digest.hexdigest()[:16]


def texts_of(test: str, root: Path) -> Iterator[str]:
    """What an entry of `killed_by` is: files of Python, and of C++ without the other cases."""
    if test.startswith("tests/"):
        for word in test.split():
            path = root / word.partition("::")[0]
            files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
            yield from (file.read_text() for file in files)
        return
    part = test.partition(": ")[2]
    for text in _cpp_tests(root):
        if any(part in case for case in CASE.findall(text)):
            yield CASE.sub(lambda case: case[0] if part in case[1] else "", text)


@cache
def _cpp_tests(root: Path) -> tuple[str, ...]:
    return tuple(path.read_text() for path in sorted((root / "cpp").rglob("test_*.cpp")))
