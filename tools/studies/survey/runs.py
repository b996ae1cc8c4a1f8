"""Runs of `mapper-survey`, watched: what they take, and with workers killed at random."""

import hashlib
import random
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import psutil
from mapper_survey.engine import Engine
from mapper_survey.memory import bytes_of

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.session.recordings import sessions_of
from mapperd.session.replay import Window, as_asked
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore

TASKS = 1000
PAYLOAD_BYTES = 10_000
"""As a tile's task brings places of 400 pings."""

WORKERS, MEMORY = 2, "1GiB"


class SchedulerTime(msgspec.Struct, frozen=True):
    """CPU time for which the process of scheduler and client was busy, a task."""

    ms: float


def scheduler_time() -> SchedulerTime:
    """Measure Dask's, with workers of our own."""
    from mapper_survey.engine_dask import local_pool  # noqa: PLC0415 Dask takes a second to import

    engine = local_pool(WORKERS, bytes_of(MEMORY))
    try:
        time_of(engine, TASKS // 10)  # what is done once
        return time_of(engine, TASKS)
    finally:
        engine.close()


def time_of(engine: Engine, tasks: int) -> SchedulerTime:
    """Measure an engine.

    Raises:
        RuntimeError: tasks were lost.
    """
    began_s = time.process_time()
    for number in range(tasks):
        engine.submit(_nothing, (number, bytes(PAYLOAD_BYTES)))
    ended = sum(1 for _ in engine.done())
    if ended != tasks:
        raise RuntimeError(f"{ended} of {tasks} tasks ended")
    return SchedulerTime(1e3 * (time.process_time() - began_s) / tasks)


def _nothing(_: tuple[int, bytes]) -> None:
    """Done at once."""


CACHE_TILES = 64
TILE_M = 12.8


class Fingerprint(msgspec.Struct, frozen=True):
    """Of the bricks in a map's file, in whatever order they stand in it.

    Attributes:
        bricks: how many.
        voxel_bytes: of all their voxels, unpacked.
        total: sum of the rows' digests, in hexadecimal.
    """

    bricks: int
    voxel_bytes: int
    total: str


def map_in_one_process(recordings: Sequence[Path], config: Config, path: Path) -> int:
    """Map recordings one after the other, with a bounded part of the map in memory.

    Returns:
        How many pings are in the map.
    """
    sonar_map, mapped = SonarMap(config), 0
    with TileStore(path, sonar_map, tile_size_m=TILE_M, cache_tiles=CACHE_TILES) as store:
        for recording in recordings:
            (session,) = sessions_of([recording])
            replay = as_asked(session, None, config).replay(sonar_map, Window())
            for _ in replay.run(session):
                store.advance(b"")
            store.advance(b"")  # what was pending at the recording's end
            mapped += replay.counters.pings_mapped
    return mapped


def fingerprint(path: Path) -> Fingerprint:
    """Of a map's file: keys, revisions and voxels, to the bit; memory for one brick."""
    bricks = voxel_bytes = total = 0
    with StoreReader(path) as reader:
        for row in reader.rows():
            words = f"{row.key} {row.revision} {row.size} {row.crc} ".encode()
            digest = hashlib.blake2b(words + row.data, digest_size=16).digest()
            total += int.from_bytes(digest, "little")
            bricks += 1
            voxel_bytes += row.size
    return Fingerprint(bricks, voxel_bytes, f"{total % (1 << 128):032x}")


POLL_INTERVAL_S = 0.1
ALONE_S = 120.0
WORKER = "spawn_main"
"""In the command line of a worker: Dask's nanny spawns it from the process of the command."""


class RunUsage(msgspec.Struct, frozen=True):
    """What a run took.

    Attributes:
        workers: that it had at a time.
        wall_s: from start to end of the command.
        cpu_s: of its processes, as far as they were seen; at most `POLL_INTERVAL_S` of each is
            missing.
        worker_peak_bytes: most memory that one worker ever took until its last look, as the kernel
            counts it (VmHWM): what a worker took in its last `POLL_INTERVAL_S` may be missing, no
            peak else.
        killed: workers that were killed.
    """

    workers: int
    wall_s: float
    cpu_s: float
    worker_peak_bytes: int
    killed: int


def watch(
    survey: Path,
    out: Path,
    workers: int,
    memory: str,
    *,
    kill_every_s: float | None = None,
    seed: int = 1,
) -> RunUsage:
    """Run a survey.

    Args:
        survey: the survey file.
        out: the survey's folder.
        workers: processes on this machine.
        memory: `--memory-per-worker`.
        kill_every_s: mean time between two kills of a worker; None kills none.
        seed: of when, and whom.

    Raises:
        RuntimeError: the command failed, or has no worker left and gets none.
    """
    program = Path(sys.executable).with_name("mapper-survey")
    words = [str(program), "run", str(survey), "--out", str(out)]
    words += ["--workers", str(workers), "--memory-per-worker", memory]
    chance, began_s = random.Random(seed), time.perf_counter()  # noqa: S311 no secret
    cpu_s: dict[int, float] = {}
    peak, killed = 0, 0
    seen_s = began_s
    next_s = began_s + chance.expovariate(1.0 / kill_every_s) if kill_every_s else None
    command = subprocess.Popen(words)  # noqa: S603 our own program
    try:
        while command.poll() is None:
            peaks = _look(command.pid, cpu_s)
            peak = max(peak, *peaks, 0)
            seen_s = time.perf_counter() if peaks or not workers else seen_s
            if time.perf_counter() - seen_s > ALONE_S:
                raise RuntimeError(f"mapper-survey has no worker for {ALONE_S:g} s, and waits")
            at_work = (out / "plan").exists()  # before, the pool has not begun
            if next_s is not None and kill_every_s and at_work and time.perf_counter() >= next_s:
                killed += _kill_one(command.pid, chance)
                next_s = time.perf_counter() + chance.expovariate(1.0 / kill_every_s)
            time.sleep(POLL_INTERVAL_S)
    finally:
        command.kill()
        code = command.wait()
    if code != 0:
        raise RuntimeError(f"mapper-survey ended with {code}")
    wall_s = time.perf_counter() - began_s
    return RunUsage(workers, wall_s, sum(cpu_s.values()), peak, killed)


def _look(command: int, cpu_s: dict[int, float]) -> list[int]:
    """Note the CPU time of all processes; returns the most memory that each worker ever took."""
    peaks = []
    for process in _family(command):
        try:
            times = process.cpu_times()
            cpu_s[process.pid] = times.user + times.system
            if WORKER in " ".join(process.cmdline()):
                peaks.append(peak_bytes(process.pid))
        except (psutil.Error, OSError):  # it ended meanwhile
            continue
    return peaks


def peak_bytes(pid: int) -> int:
    """Most memory that a process ever had resident; 0 of one that has ended.

    Raises:
        OSError: there is no such process.
    """
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    found = re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)
    return 1024 * int(found[1]) if found else 0


def _kill_one(command: int, chance: random.Random) -> int:
    workers = []
    for process in _family(command):
        try:
            if WORKER in " ".join(process.cmdline()):
                workers.append(process)
        except psutil.Error:
            continue
    if not workers:
        return 0
    try:
        chance.choice(workers).kill()
    except psutil.Error:
        return 0
    return 1


def _family(command: int) -> list[psutil.Process]:
    try:
        parent = psutil.Process(command)
        return [parent, *parent.children(recursive=True)]
    except psutil.Error:
        return []
