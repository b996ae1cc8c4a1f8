"""What became of the mutations: kept from run to run, and written as tables."""

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
    """What became of a mutation.

    Attributes:
        outcome: "killed"; "survived"; "broken", when it did not compile, could not be imported or
            a test fails without it.
        test: the one that failed.
        words: the test's own, or of what went wrong.
        commit: that was broken.
        stamp: of what was measured, see `mutations.stamp`.
    """

    name: str
    outcome: str
    test: str
    words: str
    seconds: float
    commit: str
    stamp: str


class MutationResults:
    """A file of one line a measurement; the last of a mutation counts."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._all: dict[str, Result] = {}
        if path.exists():
            for line in path.read_text().splitlines():
                one = Result(**json.loads(line))
                self._all[one.name] = one

    def add(self, result: Result) -> None:
        """Keep a result, at once."""
        self._all[result.name] = result
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a") as file:
            file.write(json.dumps(asdict(result)) + "\n")

    def of(self, mutation: Mutation) -> Result | None:
        """The newest result of a mutation, of whatever it was."""
        return self._all.get(mutation.name)

    def is_done(self, mutation: Mutation, root: Path) -> bool:
        """Whether the result is of the mutation, its file and its tests as they are in a tree."""
        result = self.of(mutation)
        if result is None or result.outcome == "broken":
            return False
        tests = (result.test,) if result.test else mutation.killed_by
        return set(tests) <= set(mutation.killed_by) and result.stamp == stamp(
            mutation, tests, root
        )


def is_well(mutation: Mutation, result: Result | None) -> bool:
    """Whether a mutation was killed, or survived as expected."""
    if result is None:
        return False
    return result.outcome == ("survived" if mutation.survives else "killed")


def table(mutations: Sequence[Mutation], results: MutationResults) -> str:
    """Markdown: what became of the mutations by area, and the survivors with their reasons."""
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
