"""Stamps of the inputs of results: while a stamp is unchanged, the result is valid."""

import hashlib
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from mutations.catalogue import Mutation

__all__ = ["stamp", "texts_of"]


CASE = re.compile(r'^TEST_CASE\(\s*"([^"]+)".*?^}\n', re.MULTILINE | re.DOTALL)


def stamp(mutation: Mutation, tests: Sequence[str], root: Path) -> str:
    """Return a digest of the mutation, its whole file, and some tests.

    Args:
        mutation: only its texts count; its description does not.
        tests: the test that killed it, or all that it survived.
        root: root of the tree.
    """
    digest = hashlib.sha256()
    texts = [text for test in tests for text in texts_of(test, root)]
    for text in (mutation.old, mutation.new, (root / mutation.file).read_text(), *tests, *texts):
        digest.update(f"{len(text)}:{text}".encode())
    return digest.hexdigest()[:16]


def texts_of(test: str, root: Path) -> Iterator[str]:
    """Return the texts of an entry of `killed_by`; of C++ files without other cases."""
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
