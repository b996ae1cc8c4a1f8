"""Results on disk: comma-separated rows that outlive a stop at any instant.

A file holds one study at one commit on one machine, which its first lines state, each after a `#`:
`pandas.read_csv(file, comment="#")` reads it. A row is written in one go when its setting is
measured. A last row that a stop has cut is dropped, and measured again.
"""

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from studies.accuracy_cost.study import Setting, Study, StudyDive

__all__ = [
    "Key",
    "StudyResults",
    "append",
    "key_of",
    "open_results",
    "read_results",
    "write_results",
]

KEYS = ("study", "dive", "seed", "setting")
IDENTITY = ("study", "commit", "machine")


class Key(NamedTuple):
    """Which row: a setting on a dive."""

    dive: str
    seed: int
    setting: str


def key_of(setting: Setting, dive: StudyDive) -> Key:
    """The row of a setting on a dive; the defaults have a name there."""
    return Key(dive.name, dive.seed, setting.key or "default")


@dataclass(slots=True)
class StudyResults:
    """Figures of a study.

    Attributes:
        head: of the first lines: study, commit, machine, command.
        columns: names of the figures.
        rows: figures by setting and dive; NaN where absent.
    """

    head: dict[str, str]
    columns: Sequence[str]
    rows: dict[Key, dict[str, float]] = field(default_factory=dict)

    def line(self, key: Key) -> str:
        """A row as it stands in the file."""
        figures = (_text(self.rows[key][name]) for name in self.columns)
        return _line(self.head["study"], *key, *figures)

    def text(self, order: Sequence[Key]) -> str:
        """The whole file, its rows in an order."""
        head = "".join(f"# {name}: {value}\n" for name, value in self.head.items())
        return head + _line(*KEYS, *self.columns) + "".join(self.line(key) for key in order)


def read_results(path: Path) -> StudyResults:
    """Read a file; what is no whole row is left out, so that it is measured again.

    Raises:
        OSError: it cannot be read.
    """
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("\n")]
    comments = [line[1:].strip() for line in whole if line.startswith("#")]
    head = {name: value for name, _, value in (line.partition(": ") for line in comments)}
    table = csv.reader(line for line in whole if not line.startswith("#"))
    titles = next(table, [])
    results = StudyResults(head, titles[len(KEYS) :])
    for cells in table:
        try:
            _, dive, seed, setting, *texts = cells
            figures = dict(zip(results.columns, map(float, texts), strict=True))
            results.rows[Key(dive, int(seed), setting)] = figures
        except ValueError:
            continue
    return results


def open_results(path: Path, study: Study, head: Mapping[str, str]) -> StudyResults:
    """Go on with a file, or begin it; one of another commit or machine is put aside, beside it.

    What a stop has cut is mended on disk too, so that rows can be appended.
    """
    fresh = StudyResults({"study": study.name, **head}, [column.name for column in study.columns])
    results = fresh
    if path.exists():
        found = read_results(path)
        same = all(found.head.get(name) == fresh.head[name] for name in IDENTITY)
        if same and list(found.columns) == list(fresh.columns):
            results = found
        else:
            path.rename(path.with_suffix(f".{found.head.get('commit', 'old')}.csv"))
    write_results(path, results, list(results.rows))
    return results


def write_results(path: Path, results: StudyResults, order: Sequence[Key]) -> None:
    """Replace a file; atomic."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(".new")
    beside.write_text(results.text(order), encoding="utf-8")
    beside.rename(path)


def append(path: Path, results: StudyResults, key: Key, figures: Mapping[str, float]) -> None:
    """Add a row to the results, and to their file.

    Raises:
        ValueError: the figures are not those of the columns.
    """
    if set(figures) != set(results.columns):
        odd = sorted(set(figures) ^ set(results.columns))
        raise ValueError(f"figures and columns differ: {', '.join(odd)}")
    results.rows[key] = {name: float(figures[name]) for name in results.columns}
    file = os.open(path, os.O_WRONLY | os.O_APPEND)
    try:
        os.write(file, results.line(key).encode())
    finally:
        os.close(file)


def _line(*cells: object) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def _text(figure: float) -> str:
    return "nan" if math.isnan(figure) else f"{figure:.6g}"
