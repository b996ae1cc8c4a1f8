"""Measuring what is missing of the studies, in processes, so that a stop loses nothing."""

import fcntl
import os
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from studies.accuracy_cost.errors import AccuracyCostError
from studies.accuracy_cost.machine import commit
from studies.accuracy_cost.pool import Job, Outcome, outcomes
from studies.accuracy_cost.results import Key, Results, append, key_of, open_results
from studies.accuracy_cost.studies import Selection
from studies.accuracy_cost.study import Study
from studies.report import machine

__all__ = ["Tally", "run", "wanted_keys"]

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Threads that a library starts by itself would be counted in the CPU time of a ping."""


@dataclass(slots=True)
class Tally:
    """How many measurements there are, were there before, and failed."""

    total: int = 0
    kept: int = 0
    failed: int = 0


@dataclass(frozen=True, slots=True)
class _Log:
    """A study's results and their file."""

    study: Study
    path: Path
    results: Results

    def take(self, outcome: Outcome) -> str:
        """Write what a measurement gave; returns why it has failed, or nothing."""
        job = outcome.job
        if outcome.figures is None or job.setting is None:
            return outcome.failure
        try:
            append(self.path, self.results, key_of(job.setting, job.dive), outcome.figures)
        except ValueError as error:
            return str(error)
        return ""


def wanted_keys(study: Study, selection: Selection) -> list[Key]:
    """The rows of a selection, in the order of the study."""
    settings = selection.settings_of(study)
    return [key_of(setting, dive) for dive in selection.dives_of(study) for setting in settings]


def run(studies: Mapping[str, Study], selection: Selection, out: Path, jobs: int) -> Tally:
    """Measure what `out` does not hold yet of a selection; failures are told as they come.

    Raises:
        AccuracyCostError: another run is at work there, or the commit is unknown.
    """
    head = {"commit": commit(), "machine": machine()}
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    with _alone(out):
        logs = {
            module: _Log(study, path, open_results(path, study, head | _command(study)))
            for module, study in studies.items()
            for path in [out / f"{study.name}.csv"]
        }
        wanted = [
            job
            for module, study in studies.items()
            for job in _jobs(module, study, selection, out / "dives" / head["commit"])
        ]
        missing = [job for job in wanted if _key(job) not in logs[job.module].results.rows]
        return _measure(logs, missing, jobs, Tally(len(wanted), len(wanted) - len(missing)))


def _command(study: Study) -> dict[str, str]:
    return {"command": f"accuracy-cost run --only {study.name}"}


def _key(job: Job) -> Key | None:
    return key_of(job.setting, job.dive) if job.setting else None


def _jobs(module: str, study: Study, selection: Selection, folder: Path) -> list[Job]:
    settings = selection.settings_of(study)
    return [
        Job(module, dive, setting, folder / study.name / f"{dive.name}-{dive.seed}")
        for dive in selection.dives_of(study)
        for setting in settings
    ]


def _measure(logs: Mapping[str, _Log], missing: list[Job], workers: int, tally: Tally) -> Tally:
    """Prepare the dives, then measure on them, in an order that lets the time left be told."""
    preparing = {job.folder: Job(job.module, job.dive, None, job.folder) for job in missing}
    on_dive = Counter(job.folder for job in missing)
    bad = set()
    everything = tally.total + len(preparing)
    with tqdm(total=everything, initial=tally.kept, unit="setting", disable=None) as bar:
        for outcome in outcomes(preparing.values(), workers):
            bar.update()
            if outcome.figures is None:
                folder = outcome.job.folder
                bad.add(folder)
                tally.failed += on_dive[folder]
                bar.update(on_dive[folder])
                _tell(bar, logs, outcome.job, f"is not prepared: {outcome.failure}")
        order = np.random.default_rng(0).permutation(len(missing))
        shuffled = [missing[place] for place in order if missing[place].folder not in bad]
        for outcome in outcomes(shuffled, workers):
            bar.update()
            if failure := logs[outcome.job.module].take(outcome):
                tally.failed += 1
                _tell(bar, logs, outcome.job, failure)
    return tally


def _tell(bar: "tqdm[None]", logs: Mapping[str, _Log], job: Job, failure: str) -> None:
    setting = f" ({job.setting.key or 'default'})" if job.setting else ""
    bar.write(f"{logs[job.module].study.name}: {job.dive.name}{setting} {failure}", file=sys.stderr)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Hold the folder: rows of two runs must not mix."""
    out.mkdir(parents=True, exist_ok=True)
    with (out / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise AccuracyCostError(f"another run writes to {out}") from error
        yield
