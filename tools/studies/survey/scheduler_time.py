"""What a task costs its scheduler: tasks that do nothing, handed out by Dask on this machine."""

import time

import msgspec
from mapper_survey.engine import Engine
from mapper_survey.memory import bytes_of

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
