"""Count the hard cases in docs/reports/numerical-stability.md, and print them all."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from studies.report import PAGES, ROOT, write_section

CASES = ROOT / "tests" / "stability"

AREAS = ("mapping", "store", "stream", "filters", "fusion", "clock", "localization", "simulation")
"""In the order of the page; others follow by name."""

_FORM = re.compile(r"(?P<guard>[^\s].*?[.?!]) (?P<naive>Naively,? .+\.)")


@dataclass(frozen=True, slots=True)
class HardCase:
    """One hard case.

    Attributes:
        file: name of the test's file, `test_<area>_<rest>.py`.
        name: of the test.
        guard: what holds, and so which failure is guarded against.
        naive: what would happen without care; begins with "Naively".
    """

    file: str
    name: str
    guard: str
    naive: str

    @property
    def area(self) -> str:
        """What the case is of, by its file's name."""
        return self.file.removesuffix(".py").split("_")[1]


def case_of(file: str, name: str, docstring: str | None) -> HardCase:
    """A test's docstring taken apart.

    Raises:
        ValueError: it does not have the two parts.
    """
    match = _FORM.fullmatch(" ".join((docstring or "").split()))
    if match is None or match["naive"].count("Naively") > 1:
        raise ValueError(
            f"{file}: {name}: the docstring of a hard case states what it guards against, and "
            'then, in a sentence that begins with "Naively", what would happen without care'
        )
    return HardCase(file, name, match["guard"], match["naive"])


def cases(folder: Path = CASES) -> Iterator[HardCase]:
    """All hard cases, in the order of files and lines; without tests of catalogues.

    Raises:
        ValueError: one is not of the form.
    """
    for path in sorted(folder.glob("test_*.py")):
        if path.stem.endswith("catalogue"):
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                yield case_of(path.name, node.name, ast.get_docstring(node))


def catalogue(found: list[HardCase]) -> str:
    """Return a table with a row for each area."""
    rank = {area: (place, "") for place, area in enumerate(AREAS)}
    last = len(AREAS)
    ordered = sorted(found, key=lambda case: rank.get(case.area, (last, case.area)))
    rows = [f"| {a} | {len(list(c))} | `test_{a}_*.py` |" for a, c in groupby(ordered, _area_of)]
    total = f"| all | {len(found)} | |"
    return "\n".join(["| area | cases | tests |", "|---|---:|---|", *rows, total])


def listing(found: list[HardCase]) -> str:
    """Return each case with both parts of its docstring."""
    return "\n\n".join(f"{c.file}: {c.name}\n  {c.guard}\n  {c.naive}" for c in found)


def _area_of(case: HardCase) -> str:
    return case.area


def main() -> None:
    """Write the table into its page; print all cases."""
    found = list(cases())
    table, command = catalogue(found), "python -m studies hard-cases"
    write_section(PAGES["numerical-stability"], "catalogue", table, command)
    print(listing(found))


if __name__ == "__main__":
    main()
