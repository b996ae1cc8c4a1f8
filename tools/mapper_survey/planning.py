"""Plans the dives: recordings run through the usual pipeline, but into a spool instead of a map.

Each dive is planned once; unchanged plans are kept.
"""

import io
import math
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from mapper_survey.engine import Engine
from mapper_survey.errors import SurveyError
from mapper_survey.fingerprint import digest_of, facts_of, known_map_facts, program_digest
from mapper_survey.folder import Folder, mark, marked
from mapper_survey.request import DiveTransform, Request, SurveyDive
from mapper_survey.spool import Frame, RowFile, Rows, SpoolMap
from mapperd.config.tree import Config
from mapperd.errors import Reject, ReplayError
from mapperd.odometry.odometry_files import OdometryOptions
from mapperd.odometry.records import UNKNOWN_VARIANCE
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PosedPing
from mapperd.session.recordings import RecordedSession, files_in, sessions_of
from mapperd.session.replay import Window, as_asked, odometry_of, require_overlap
from oculus_driver.errors import RecordingError

__all__ = [
    "DivePlan",
    "Lost",
    "PlanTask",
    "index_name",
    "mark_name",
    "plan_all",
    "plan_dive",
    "rows_of",
    "spool_name",
]


PIECE_BYTES = 1 << 20


class PlanTask(Struct, frozen=True):
    """One dive to be planned.

    Attributes:
        name: name of the dive.
        recording: a file or a folder.
        config: the dive's settings.
        transform: into the survey's frame; None leaves poses unchanged.
        folder: the survey's folder, as for `Folder`.
        fingerprint: fingerprint of all inputs of the plan.
        odometry: files that replace the recorded odometry; None uses that.
    """

    name: str
    recording: str
    config: Config
    transform: DiveTransform | None
    folder: str
    fingerprint: str
    odometry: OdometryOptions | None = None


class Lost(Struct, frozen=True):
    """Unusable part of a recording.

    Attributes:
        recording: its file, or the first one of its session.
        reason: the reason, for people.
        truncated: the file ends early.
        bytes_read, size_bytes: bytes of its session.
        bytes_rejected: bytes read outside of messages.
    """

    recording: str
    reason: str
    truncated: bool = False
    bytes_read: int = 0
    size_bytes: int = 0
    bytes_rejected: int = 0


class DivePlan(Struct, frozen=True):
    """Plan of one dive.

    Attributes:
        name, fingerprint: of the task.
        pings: number of pings in the spool.
        pings_total: number of all pings.
        pings_dropped: number of dropped pings, by reason.
        pings_lost: number of missing ping numbers, damaged recording or not.
        dropped_details: explanation of the first case, by reason.
        first_ns, last_ns: of pings with a time; None without any.
        bearings: bearing tables of the records.
        lost: unusable parts.
        spool_bytes, index_crc: size and checksum of its files, to detect damage.
        cpu_s, read_bytes, written_bytes: cost of the task.
        deviation_mean_m, deviation_max_m: horizontal standard deviation of the poses at the pings,
            as the odometry or `odometry.position_std` states it: root of the sum of the variances
            of x and y; None if it is unknown.
    """

    name: str
    fingerprint: str
    pings: int
    pings_total: int
    pings_dropped: dict[str, int]
    pings_lost: int
    dropped_details: dict[str, str]
    first_ns: int | None
    last_ns: int | None
    bearings: list[bytes]
    lost: list[Lost]
    spool_bytes: int
    index_crc: int
    cpu_s: float
    read_bytes: int
    written_bytes: int
    deviation_mean_m: float | None = None
    deviation_max_m: float | None = None


class _Deviations:
    """Horizontal standard deviations of poses, as far as they are stated."""

    def __init__(self) -> None:
        self._stated_m: list[float] = []

    def add(self, posed: PosedPing) -> None:
        """Add a ping's."""
        if isinstance(posed.pose, Reject) or posed.pose.covariance is None:
            return
        variance_m2 = float(posed.pose.covariance[0, 0] + posed.pose.covariance[1, 1])
        if 0.0 < variance_m2 < UNKNOWN_VARIANCE:
            self._stated_m.append(math.sqrt(variance_m2))

    @property
    def mean_m(self) -> float | None:
        """Their mean; None without any."""
        stated_m = self._stated_m
        return math.fsum(stated_m) / len(stated_m) if stated_m else None

    @property
    def max_m(self) -> float | None:
        """The largest; None without any."""
        return max(self._stated_m, default=None)


def spool_name(plan: DivePlan | PlanTask) -> str:
    """Return the name of a dive's records in the survey's folder; it depends on the inputs."""
    return f"plan/{plan.name}.{plan.fingerprint}.spool"


def index_name(plan: DivePlan | PlanTask) -> str:
    """Return the name of the index of rows."""
    return f"plan/{plan.name}.{plan.fingerprint}.npy"


def mark_name(plan: DivePlan | PlanTask) -> str:
    """Return the name of the record of both."""
    return f"plan/{plan.name}.{plan.fingerprint}.json"


def plan_dive(task: PlanTask) -> DivePlan:
    """Read a dive's recording and spool the data for the integrators.

    Raises:
        ConfigError: localization cannot start with the settings.
        OSError: the recording cannot be read, or the survey's folder cannot be written.
        SurveyError: the recording does not exist.
    """
    began_s = time.process_time()
    folder = Folder(task.folder)
    with folder.workspace() as work:
        with (work / "spool").open("wb") as out, (work / "rows.npy").open("wb") as index:
            rows = RowFile(index)
            spool = SpoolMap(task.config, out, rows, Frame(task.transform))
            counters, deviations = PipelineCounters(), _Deviations()
            sessions, lost = _sessions(task)
            for session in sessions:
                lost += _spool(session, task.config, spool, counters, deviations)
            rows.close()
        index_crc, index_bytes = _crc_of(work / "rows.npy")
        folder.put(work / "spool", spool_name(task))
        folder.put(work / "rows.npy", index_name(task))
    return DivePlan(
        name=task.name,
        fingerprint=task.fingerprint,
        pings=rows.count,
        pings_total=counters.pings_total,
        pings_dropped=dict(sorted(counters.pings_dropped.items())),
        pings_lost=counters.pings_lost,
        dropped_details=dict(sorted(counters.first_drop.items())),
        first_ns=spool.first_ns,
        last_ns=spool.last_ns,
        bearings=spool.bearings,
        lost=lost,
        spool_bytes=spool.size_bytes,
        index_crc=index_crc,
        cpu_s=time.process_time() - began_s,
        read_bytes=sum(session.bytes_read for session in sessions),
        written_bytes=spool.size_bytes + index_bytes,
        deviation_mean_m=deviations.mean_m,
        deviation_max_m=deviations.max_m,
    )


def _crc_of(path: Path) -> tuple[int, int]:
    """Return checksum and size of a file, read in pieces."""
    crc = size = 0
    with path.open("rb") as file:
        while piece := file.read(PIECE_BYTES):
            crc, size = zlib.crc32(piece, crc), size + len(piece)
    return crc, size


def _sessions(task: PlanTask) -> tuple[list[RecordedSession], list[Lost]]:
    """Return the sessions of a dive; other files count as lost."""
    recording = Path(task.recording)
    if not recording.exists():
        raise SurveyError(f"{recording}: there is no such recording; allowed: a file or a folder")
    lost: list[Lost] = []
    usable: list[Path] = []
    for path in files_in([recording], begun=True):
        try:
            sessions_of([path])
        except RecordingError as error:
            _raise_if_of_disk(error)
            lost.append(Lost(str(path), str(error)))
        else:
            usable.append(path)
    if not usable and not lost:
        lost.append(Lost(str(recording), "there is no recording in it"))
    sessions = sessions_of(usable)
    if not sessions:
        return sessions, lost
    try:
        odometry = odometry_of(sessions, task.odometry, task.config)
        if odometry is not None:
            require_overlap(sessions, odometry)
            sessions = sessions_of(usable, odometry=odometry)
    except (RecordingError, ReplayError) as error:
        _raise_if_of_disk(error)
        raise SurveyError(f"dive {task.name}: {error}") from error
    return sessions, lost


def _raise_if_of_disk(error: Exception) -> None:
    """Raise errors of disks and networks: they are no damage, but are retried or end the run.

    Raises:
        OSError: the error is one of these.
    """
    if isinstance(error.__cause__, OSError):
        raise OSError(str(error)) from error


def _spool(
    session: RecordedSession,
    config: Config,
    spool: SpoolMap,
    counters: PipelineCounters,
    deviations: _Deviations,
) -> list[Lost]:
    """Process one session; return its damage."""
    before = counters.bytes_rejected
    replay = as_asked(session, None, config).replay(spool, Window(), counters)

    def note(posed: PosedPing) -> None:
        spool.t_ns = posed.t_ns
        deviations.add(posed)

    replay.on_posed = note
    stopped: str | None = None
    try:
        for _ in replay.run(session):
            pass
    except RecordingError as error:
        _raise_if_of_disk(error)
        stopped = str(error)
    if session.read_error is not None:
        raise session.read_error
    reason = stopped or session.damage or ("it was cut" if session.truncated else None)
    rejected = counters.bytes_rejected - before
    if reason is None and rejected:
        reason = f"{rejected} bytes of it are no sonar message"
    if reason is None:
        return []
    return [
        Lost(
            recording=str(session.paths[0]),
            reason=reason,
            truncated=session.truncated,
            bytes_read=session.bytes_read,
            size_bytes=session.size_bytes,
            bytes_rejected=rejected,
        )
    ]


Show = Callable[[float, int], None]


def plan_all(request: Request, folder: Folder, engine: Engine, show: Show) -> list[DivePlan]:
    """Plan dives without a valid plan; return the plans of all, in the survey's order.

    Raises:
        SurveyError: a task fails.
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
    """Return the index of a dive's spool."""
    data = folder.read(index_name(plan))
    assert data is not None  # noqa: S101 it was there, or has just been made
    rows: Rows = np.load(io.BytesIO(data))
    return rows


def _task(request: Request, dive: SurveyDive, folder: Folder) -> PlanTask:
    config, recording = request.config_of(dive), request.path_of(dive)
    at = dive.localization
    known = "" if at is None else known_map_facts(request.folder / at)
    odometry = request.odometry_of(dive)
    others = "" if odometry is None else f"{odometry.offset_s}\n{facts_of(*odometry.paths)}"
    fingerprint = digest_of(
        program_digest(),
        facts_of(recording),
        config,
        msgspec.json.encode(dive.transform),
        known,
        others,
    )
    return PlanTask(
        dive.name, str(recording), config, dive.transform, folder.url, fingerprint, odometry
    )


def _kept(folder: Folder, task: PlanTask, there: dict[str, int]) -> DivePlan | None:
    plan = marked(folder, mark_name(task), DivePlan) if mark_name(task) in there else None
    if plan is None or there.get(spool_name(task)) != plan.spool_bytes:
        return None
    index = folder.read(index_name(task))
    return plan if index is not None and zlib.crc32(index) == plan.index_crc else None
