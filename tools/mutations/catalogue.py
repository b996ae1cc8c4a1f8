"""The mutations listed in the YAML files of `catalogue/`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

__all__ = ["CATALOGUE", "REPOSITORY", "Mutation", "load", "mutated"]

REPOSITORY = Path(__file__).resolve().parents[2]
CATALOGUE = Path(__file__).resolve().parent / "catalogue"


@dataclass(frozen=True, slots=True)
class Mutation:
    """A mutation of one formula.

    Attributes:
        name: unique, such as `localization/resample/comb-offset`: catalogue file, changed file,
            change.
        file: changed file, relative to the repository's root.
        old: text that occurs once in it.
        new: its replacement.
        breaks: the resulting error, in words.
        killed_by: tests of which one must fail, tried in order: `tests/....py::test` for pytest,
            `program: part of a case's name` for the C++ tests.
        survives: why no test can fail, if the change has no effect; otherwise empty.
        may: ways to end that count as failing, besides a check or the time limit: "crash".
    """

    name: str
    file: str
    old: str
    new: str
    breaks: str
    killed_by: tuple[str, ...]
    survives: str = ""
    may: tuple[str, ...] = ()

    @property
    def area(self) -> str:
        """The catalogue file that lists it."""
        return self.name.partition("/")[0]

    @property
    def is_cpp(self) -> bool:
        """Whether it needs a build."""
        return self.file.startswith("cpp/")


def load(folder: Path = CATALOGUE) -> list[Mutation]:
    """Return all mutations, in the order of the files that they change.

    Raises:
        ValueError: two have the same name.
    """
    found = [one for path in sorted(folder.glob("*.yaml")) for one in _of_file(path)]
    names = [one.name for one in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"mutations with one name: {', '.join(twice)}")
    return sorted(found, key=lambda one: one.file)


def _of_file(path: Path) -> Iterator[Mutation]:
    for file in yaml.safe_load(path.read_text()):
        for entry in file["mutations"]:
            tests = entry.get("killed_by", file.get("killed_by", ()))
            yield Mutation(
                name=f"{path.stem}/{Path(file['file']).stem}/{entry['name']}",
                file=file["file"],
                old=entry["old"],
                new=entry["new"],
                breaks=entry["breaks"],
                killed_by=(tests,) if isinstance(tests, str) else tuple(tests),
                survives=entry.get("survives", ""),
                may=tuple(entry.get("may", ())),
            )


def mutated(mutation: Mutation, text: str) -> str:
    """Return the file's text with the mutation.

    Raises:
        ValueError: the old text does not occur exactly once, or equals the new one.
    """
    times = text.count(mutation.old)
    if times != 1:
        raise ValueError(f"{mutation.name}: {times} times in {mutation.file}: {mutation.old!r}")
    if mutation.old == mutation.new:
        raise ValueError(f"{mutation.name} changes nothing")
    return text.replace(mutation.old, mutation.new)
