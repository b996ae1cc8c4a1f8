"""All dives are planned, each once: what did not change since stays as it is."""

import io
import zlib
from collections.abc import Callable

import msgspec
import numpy as np

from mapper_survey.engine import Engine
from mapper_survey.fingerprint import digest_of, facts_of, known_map_facts, program_digest
from mapper_survey.folder import Folder
from mapper_survey.marks import mark, marked
from mapper_survey.planning import DivePlan, PlanTask, index_name, mark_name, plan_dive, spool_name
from mapper_survey.request import Dive, Request
from mapper_survey.spool import Rows

__all__ = ["plan_all", "rows_of"]

Show = Callable[[float, int], None]


def plan_all(request: Request, folder: Folder, engine: Engine, show: Show) -> list[DivePlan]:
    """Plan what has to be; returns the plans of all dives, in the survey's order.

    Raises:
        SurveyError: a task cannot be done.
    """
    tasks = [_task(request, dive, folder) for dive in request.survey.dives]
    there = folder.sizes("plan")
    plans: dict[str, DivePlan] = {}
    for task in tasks:
        kept = _kept(folder, task, there)
        if kept is None:
            engine.submit(plan_dive, task)
        else:
            plans[task.name] = kept
    for task, plan in engine.done():
        mark(folder, mark_name(task), plan)
        plans[task.name] = plan
        show(len(plans) / len(tasks), sum(each.pings for each in plans.values()))
    return [plans[task.name] for task in tasks]


def rows_of(folder: Folder, plan: DivePlan) -> Rows:
    """The index of a dive's spool."""
    data = folder.read(index_name(plan))
    assert data is not None  # noqa: S101 it was there, or has just been made
    rows: Rows = np.load(io.BytesIO(data))
    return rows


def _task(request: Request, dive: Dive, folder: Folder) -> PlanTask:
    config, recording = request.config_of(dive), request.path_of(dive)
    at = dive.localization
    known = "" if at is None else known_map_facts(request.folder / at)
    fingerprint = digest_of(
        program_digest(), facts_of(recording), config, msgspec.json.encode(dive.transform), known
    )
    return PlanTask(dive.name, str(recording), config, dive.transform, folder.url, fingerprint)


def _kept(folder: Folder, task: PlanTask, there: dict[str, int]) -> DivePlan | None:
    plan = marked(folder, mark_name(task), DivePlan) if mark_name(task) in there else None
    if plan is None or there.get(spool_name(task)) != plan.spool_bytes:
        return None
    index = folder.read(index_name(task))
    return plan if index is not None and zlib.crc32(index) == plan.index_crc else None
