"""Processes that measure: one job at a time, each process for a few jobs, none can end the rest.

The pools of the standard library give up all jobs when a process dies. Here a job whose process
dies, or takes too long, has failed, and the next one gets a new process.
"""

import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext
from pathlib import Path

from studies.accuracy_cost.studies import load
from studies.accuracy_cost.study import Dive, Setting

__all__ = ["Job", "Outcome", "outcomes", "perform"]

JOBS_EACH = 20
"""After them a process is replaced: what a library keeps must not slow the next ones."""
LONGEST_S = 900.0


@dataclass(frozen=True, slots=True)
class Job:
    """What a process does: measure a setting on a dive, or prepare the dive for that.

    Attributes:
        module: of the study.
        setting: none prepares the dive.
        folder: of the dive's files.
    """

    module: str
    dive: Dive
    setting: Setting | None
    folder: Path


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a job: its figures, or why there are none."""

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


def outcomes(jobs: Iterable[Job], workers: int, longest_s: float = LONGEST_S) -> Generator[Outcome]:
    """Do jobs in processes, and yield what came of each as it comes."""
    context = multiprocessing.get_context("spawn")
    waiting, busy = deque(jobs), list[_Worker]()
    idle = list[_Worker]()
    try:
        while waiting or busy:
            while waiting and len(busy) < workers:
                worker = idle.pop() if idle else _Worker(context)
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


class _Worker:
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


def _ready(busy: list[_Worker], longest_s: float) -> list[_Worker]:
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
