"""Measuring what is missing of the studies, in processes, so that a stop loses nothing."""

import fcntl
import hashlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext
from pathlib import Path

import numpy as np
from tqdm import tqdm

from studies.accuracy_cost.results import Key, StudyResults, append, key_of, open_results
from studies.accuracy_cost.study import (
    AccuracyCostError,
    Selection,
    Setting,
    Study,
    StudyDive,
    load,
)
from studies.report import ROOT, machine

__all__ = [
    "Job",
    "MeasurementTally",
    "Outcome",
    "commit",
    "outcomes",
    "perform",
    "run",
    "wanted_keys",
]


MEASURED = (
    *("cpp", "mapperd", "oculus_driver", "tools", "config", "pyproject.toml"),
    ":(exclude,glob)tools/studies/accuracy_cost/*.py",
)
"""What figures depend on: changes of texts, of tests, or of how they are drawn leave them valid."""


def commit(root: Path = ROOT) -> str:
    """The last commit that changed what is measured; `+` and a digest where it is changed since.

    Raises:
        AccuracyCostError: this is no checkout of git.
    """
    last = _git(root, "log", "-1", "--format=%h", "--abbrev=12", "--", *MEASURED).strip()
    if not _git(root, "status", "--porcelain", "--", *MEASURED):
        return last
    names = _git(root, "ls-files", "-co", "--exclude-standard", "-z", "--", *MEASURED)
    digest = hashlib.sha256()
    for name in sorted(filter(None, names.split("\0"))):
        file = root / name
        digest.update(name.encode() + b"\0" + (file.read_bytes() if file.is_file() else b""))
    return f"{last}+{digest.hexdigest()[:8]}"


def _git(root: Path, *words: str) -> str:
    command = ["git", "-C", str(root), *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    except (OSError, subprocess.CalledProcessError) as error:
        raise AccuracyCostError(f"{root} is no checkout of git: its commit is unknown") from error
    return done.stdout


JOBS_EACH = 20
"""After them a process is replaced: what a library keeps must not slow the next ones."""
JOB_TIMEOUT_S = 900.0


@dataclass(frozen=True, slots=True)
class Job:
    """What a process does: measure a setting on a dive, or prepare the dive for that.

    Attributes:
        module: of the study.
        setting: none prepares the dive.
        folder: of the dive's files.
    """

    module: str
    dive: StudyDive
    setting: Setting | None
    folder: Path


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a job: its figures, or why it has none."""

    job: Job
    figures: dict[str, float] | None = None
    failure: str = ""


def perform(job: Job) -> Outcome:
    """Do a job here; whatever a study raises is its failure, in one line."""
    try:
        study = load(job.module)
        if job.setting is None:
            job.folder.mkdir(parents=True, exist_ok=True)
            study.prepare(job.dive, job.folder)
            return Outcome(job, {})
        return Outcome(job, dict(study.measure(job.setting, job.dive, job.folder)))
    except Exception as error:  # noqa: BLE001 the other settings are measured all the same
        text = " ".join(str(error).split())
        return Outcome(job, failure=f"{type(error).__name__}: {text}")


def outcomes(
    jobs: Iterable[Job], workers: int, longest_s: float = JOB_TIMEOUT_S
) -> Generator[Outcome]:
    """Do jobs in processes, and yield what came of each as it comes."""
    context = multiprocessing.get_context("spawn")
    waiting, busy = deque(jobs), list[_StudyProcess]()
    idle = list[_StudyProcess]()
    try:
        while waiting or busy:
            while waiting and len(busy) < workers:
                worker = idle.pop() if idle else _StudyProcess(context)
                worker.begin(waiting.popleft())
                busy.append(worker)
            for worker in _ready(busy, longest_s):
                busy.remove(worker)
                outcome = worker.outcome(longest_s)
                if worker.jobs_left > 0:
                    idle.append(worker)
                else:
                    worker.end()
                yield outcome
    finally:
        for worker in (*busy, *idle):
            worker.end()


class _StudyProcess:
    """A process and the pipe to it."""

    def __init__(self, context: SpawnContext) -> None:
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,))
        self._process.start()
        theirs.close()
        self.jobs_left = JOBS_EACH

    def begin(self, job: Job) -> None:
        self._job, self.began_s = job, time.monotonic()
        self.pipe.send(job)

    def outcome(self, longest_s: float) -> Outcome:
        self.jobs_left -= 1
        try:
            if not self.pipe.poll():
                self.jobs_left = 0
                return Outcome(self._job, failure=f"not done after {longest_s:g} s")
            received: Outcome = self.pipe.recv()
        except (EOFError, OSError):
            self.jobs_left = 0
            self._process.join()
            return Outcome(self._job, failure=f"its process ended with {_ended(self._process)}")
        return received

    def end(self) -> None:
        self.pipe.close()
        self._process.kill()
        self._process.join()


def _ready(busy: list[_StudyProcess], longest_s: float) -> list[_StudyProcess]:
    """Wait for the workers that have an answer, or are dead, or have had their time."""
    last_s = min(worker.began_s for worker in busy) + longest_s
    answered = wait([worker.pipe for worker in busy], max(0.0, last_s - time.monotonic()))
    late_s = time.monotonic() - longest_s
    return [worker for worker in busy if worker.pipe in answered or worker.began_s <= late_s]


def _ended(process: multiprocessing.process.BaseProcess) -> str:
    code = process.exitcode or 0
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def _serve(pipe: "Connection[Outcome, Job]") -> None:
    """Do jobs until the pipe ends; Ctrl-C is the parent's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        while True:
            pipe.send(perform(pipe.recv()))
    except (EOFError, OSError):
        return


ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Threads that a library starts by itself would be counted in the CPU time of a ping."""


@dataclass(slots=True)
class MeasurementTally:
    """How many measurements there are, were there before, and failed."""

    total: int = 0
    kept: int = 0
    failed: int = 0


@dataclass(frozen=True, slots=True)
class _Log:
    """A study's results and their file."""

    study: Study
    path: Path
    results: StudyResults

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


def run(
    studies: Mapping[str, Study], selection: Selection, out: Path, jobs: int
) -> MeasurementTally:
    """Measure what `out` does not hold yet of a selection; failures are reported as they come.

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
        return _measure(
            logs, missing, jobs, MeasurementTally(len(wanted), len(wanted) - len(missing))
        )


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


def _measure(
    logs: Mapping[str, _Log], missing: list[Job], workers: int, tally: MeasurementTally
) -> MeasurementTally:
    """Prepare the dives, then measure on them, ordered for an estimate of the time left."""
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
                _log_failure(bar, logs, outcome.job, f"is not prepared: {outcome.failure}")
        order = np.random.default_rng(0).permutation(len(missing))
        shuffled = [missing[place] for place in order if missing[place].folder not in bad]
        for outcome in outcomes(shuffled, workers):
            bar.update()
            if failure := logs[outcome.job.module].take(outcome):
                tally.failed += 1
                _log_failure(bar, logs, outcome.job, failure)
    return tally


def _log_failure(bar: "tqdm[None]", logs: Mapping[str, _Log], job: Job, failure: str) -> None:
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
