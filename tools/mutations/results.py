"""Results of the mutations: stored between runs, and written as tables."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mutations.catalogue import Mutation
from mutations.stamp import stamp

__all__ = ["MutationResults", "Result", "is_well", "table"]


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a mutation.

    Attributes:
        outcome: "killed"; "survived"; "broken" if it did not compile, could not be imported, or a
            test fails without it.
        test: the test that failed.
        words: output of the test or of the error.
        commit: the commit that was broken.
        stamp: stamp of the measured texts, see `mutations.stamp`.
    """

    name: str
    outcome: str
    test: str
    words: str
    seconds: float
    commit: str
    stamp: str


class MutationResults:
    """A file with one line per measurement; the last one of a mutation counts."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._all: dict[str, Result] = {}
        if path.exists():
            for line in path.read_text().splitlines():
                one = Result(**json.loads(line))
                self._all[one.name] = one

    def add(self, result: Result) -> None:
        """Store a result at once."""
        self._all[result.name] = result
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a") as file:
            file.write(json.dumps(asdict(result)) + "\n")

    def of(self, mutation: Mutation) -> Result | None:
        """Return the newest result of a mutation, current or not."""
        return self._all.get(mutation.name)

    def is_done(self, mutation: Mutation, root: Path) -> bool:
        """Return whether a result is current: mutation, file and tests are those of a tree."""
        result = self.of(mutation)
        if result is None or result.outcome == "broken":
            return False
        tests = (result.test,) if result.test else mutation.killed_by
        return set(tests) <= set(mutation.killed_by) and result.stamp == stamp(
            mutation, tests, root
        )


def is_well(mutation: Mutation, result: Result | None) -> bool:
    """Return whether a mutation was killed, or survived as expected."""
    if result is None:
        return False
    return result.outcome == ("survived" if mutation.survives else "killed")


def table(mutations: Sequence[Mutation], results: MutationResults) -> str:
    """Return a Markdown table of results by area, and the survivors with reasons."""
    lines = [
        "| area | files | mutations | killed | survived | not measured |",
        "|---|---|---|---|---|---|",
    ]
    for area in sorted({one.area for one in mutations}):
        chosen = [one for one in mutations if one.area == area]
        lines.append(_row(area, chosen, results))
    lines += [_row("all", mutations, results), "", *_survivors(mutations, results)]
    return "\n".join(lines)


def _row(area: str, mutations: Sequence[Mutation], results: MutationResults) -> str:
    found = Counter(_outcome(results.of(one)) for one in mutations)
    counts = [
        len({one.file for one in mutations}),
        len(mutations),
        found["killed"],
        len(mutations) - found["killed"] - found["not measured"],
        found["not measured"],
    ]
    return f"| {area} | " + " | ".join(map(str, counts)) + " |"


def _survivors(mutations: Sequence[Mutation], results: MutationResults) -> Iterator[str]:
    measured = [one for one in mutations if results.of(one) is not None]
    survivors = [one for one in measured if _outcome(results.of(one)) != "killed"]
    if not survivors:
        yield "There are no survivors."
        return
    yield "Survivors, and why:"
    yield ""
    for one in survivors:
        yield f"- `{one.name}`, so that {one.breaks}: {one.survives or '**not explained**'}"


def _outcome(result: Result | None) -> str:
    return "not measured" if result is None else result.outcome
