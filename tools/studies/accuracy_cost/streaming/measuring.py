"""The map stream as a study: prepares its dives and measures settings on them."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from bench.inputs import Pings

from mapperd.mapping.sonar_map import SonarMap
from mapperd.wire.messages import MapInfo
from studies.accuracy_cost.streaming.clients import (
    MapReader,
    PlainClient,
    PlainSender,
    Sender,
    StreamClient,
    StreamSender,
)
from studies.accuracy_cost.streaming.dives import (
    DIVES,
    PING_S,
    PLANS,
    SimulatedLink,
    StreamPlan,
    load_dive,
    position_of,
    prepare_dive,
)
from studies.accuracy_cost.streaming.knobs import (
    KNOBS,
    WHOLES,
    StreamSetting,
    constants,
    stream_setting,
)
from studies.accuracy_cost.streaming.truth import EDGE, UNIT, Ages, Blocks, distances_m
from studies.accuracy_cost.study import Column, Knob, Setting, StudyDive

__all__ = [
    "COLUMNS",
    "COST",
    "ERROR",
    "NEAR_M",
    "MapDeviation",
    "StreamStudy",
    "moment",
    "summary",
    "watched",
]


NEAR_M = 10.0

ERROR, COST = "p_error_near", "kb_per_s"

COLUMNS = (
    Column(ERROR, "error of the probability at the client, within 10 m (mean)"),
    Column("p_error", "the same, of the whole map"),
    Column(
        "wrong_class_near", "occupied and free voxels within 10 m sent as something else, share"
    ),
    Column("log_odds_rms", "error of the log-odds of voxels that the client knows (rms)"),
    Column("near_age_median_s", "age of the oldest block within 10 m, median (s)"),
    Column("near_age_p95_s", "age of the oldest block within 10 m, 95 % (s)"),
    Column("far_age_median_s", "age of the oldest block beyond 10 m, median (s)"),
    Column("far_age_p95_s", "age of the oldest block beyond 10 m, 95 % (s)"),
    Column("bytes_per_voxel", "bytes a voxel that changed"),
    Column(COST, "sent to one client (kB/s)"),
    Column("cpu_ms_per_ping", "CPU time per ping, mean (ms)", repeatable=False),
    Column("cpu_median_ms", "CPU time per ping, median (ms)", repeatable=False),
    Column("cpu_p95_ms", "CPU time per ping, 95 % (ms)", repeatable=False),
    Column("memory_mb", "memory of index and client (MB)"),
)

MAX_LOG_ODDS = 20.0


@dataclass(frozen=True, slots=True)
class MapDeviation:
    """How a client's map differs from the daemon's at one time."""

    p_error_near: float
    p_error: float
    wrong_class_near: float
    square: float
    known: int


def moment(
    blocks: Blocks, client: MapReader, info: MapInfo, position_m: np.ndarray
) -> MapDeviation:
    """Compare all voxels that the daemon knows."""
    known = blocks.counts > 0
    held = client.probabilities(blocks.keys)
    true_log_odds = blocks.units * np.float32(UNIT)
    true = 1 / (1 + np.exp(-true_log_odds))
    missing = np.isnan(held)
    off = np.abs(np.where(missing, np.float32(0.5), held) - true)
    wide = blocks.keys.astype(np.int64)
    near = distances_m(wide, info.resolution_m * EDGE, position_m) <= NEAR_M
    both = known & ~missing
    with np.errstate(divide="ignore", invalid="ignore"):
        received = np.clip(np.log(held) - np.log1p(-held), -MAX_LOG_ODDS, MAX_LOG_ODDS)
    apart = received[both] - true_log_odds[both]
    at = known[near]
    return MapDeviation(
        float(off[near][at].mean()) if at.any() else 0.0,
        float(off[known].mean()) if known.any() else 0.0,
        _wrong_share(true_log_odds[near][at], received[near][at], info),
        float(np.square(apart, dtype=np.float64).sum()),
        int(both.sum()),
    )


def _wrong_share(true: np.ndarray, received: np.ndarray, info: MapInfo) -> float:
    """Of the voxels that are occupied or free; what is not known (NaN) is neither."""
    occupied, free = true > info.occupied_log_odds, true < info.free_log_odds
    wrong = (occupied & ~(received > info.occupied_log_odds)) | (
        free & ~(received < info.free_log_odds)
    )
    decided = occupied | free
    return float(wrong[decided].mean()) if decided.any() else 0.0


def summary(
    moments: Sequence[MapDeviation], ages_s: Sequence[tuple[float, float]]
) -> dict[str, float]:
    """Figures of all moments and ages."""
    near_s, far_s = np.array(ages_s).reshape(-1, 2).T
    known = max(sum(each.known for each in moments), 1)
    return {
        "p_error_near": float(np.mean([each.p_error_near for each in moments])),
        "p_error": float(np.mean([each.p_error for each in moments])),
        "wrong_class_near": float(np.mean([each.wrong_class_near for each in moments])),
        "log_odds_rms": float(np.sqrt(sum(each.square for each in moments) / known)),
        "near_age_median_s": float(np.quantile(near_s, 0.5)),
        "near_age_p95_s": float(np.quantile(near_s, 0.95)),
        "far_age_median_s": float(np.quantile(far_s, 0.5)),
        "far_age_p95_s": float(np.quantile(far_s, 0.95)),
    }


STEP_S = 0.02
POLL_INTERVAL_S = 0.07
"""After a ping: pings and looks do not wait for each other."""


@dataclass
class _WatchedClient:
    """One client, its link, and what is judged."""

    sender: Sender
    client: MapReader
    link: SimulatedLink
    ages: Ages
    made_s: deque[float] = field(default_factory=deque)
    changed: int = 0
    seen: dict[bytes, np.ndarray] = field(default_factory=dict)

    def step(self, now_s: float, position_m: np.ndarray) -> None:
        """Send what there is room for, and read what arrives."""
        for message, made_s in self.sender.messages(now_s, position_m):
            self.link.carry(message)
            self.made_s.append(made_s)
        for message in self.link.step(now_s):
            self.ages.sent(self.client.take(message), self.made_s.popleft())

    def count(self, blocks: Blocks) -> None:
        """Voxels that are otherwise than at the ping before."""
        for key, units in zip(blocks.keys, blocks.units, strict=True):
            name = key.tobytes()
            before = self.seen.get(name)
            self.changed += int(np.count_nonzero(units if before is None else units != before))
            self.seen[name] = units.copy()


def watched(pings: Pings, plan: StreamPlan, wanted: StreamSetting) -> dict[str, float]:
    """The figures of all columns."""
    sonar_map = SonarMap(wanted.config)
    for number in range(plan.joins):
        _map(sonar_map, pings, number)
    watch = _joined(sonar_map, plan, wanted)
    moments: list[MapDeviation] = []
    ages_s: list[tuple[float, float]] = []
    cpu_s: list[float] = []
    joined_s = plan.joins * PING_S
    now_s, next_look_s = joined_s, joined_s + POLL_INTERVAL_S
    for number in range(plan.joins, plan.pings):
        position_m = position_of(pings, number)
        _map(sonar_map, pings, number)
        blocks = Blocks(*sonar_map.core.blocks())
        watch.ages.changed(blocks, now_s)
        watch.count(blocks)
        until_s, before_s = (number + 1) * PING_S, watch.sender.cpu_s
        while now_s < until_s - STEP_S / 2:
            if now_s >= next_look_s:
                watch.sender.look(now_s, position_m)
                next_look_s += 1 / wanted.config.stream.rate
            watch.step(now_s, position_m)
            now_s += STEP_S
            ages_s.append(watch.ages.oldest_s(now_s, position_m, NEAR_M))
        cpu_s.append(watch.sender.cpu_s - before_s)
        if number % plan.judged_every == 0:
            moments.append(moment(blocks, watch.client, watch.sender.info(), position_m))
    return summary(moments, ages_s) | {
        "bytes_per_voxel": watch.link.carried / max(watch.changed, 1),
        "kb_per_s": watch.link.carried / (now_s - joined_s) / 1e3,
        "cpu_ms_per_ping": 1e3 * float(np.mean(cpu_s)),
        "cpu_median_ms": 1e3 * float(np.median(cpu_s)),
        "cpu_p95_ms": 1e3 * float(np.quantile(cpu_s, 0.95)),
        "memory_mb": watch.sender.memory_bytes / 1e6,
    }


def _joined(sonar_map: SonarMap, plan: StreamPlan, wanted: StreamSetting) -> _WatchedClient:
    sender: Sender
    client: MapReader
    if wanted.is_plain:
        sender, client = PlainSender(sonar_map), PlainClient()
    else:
        stream = wanted.config.stream
        step, limit = stream.log_odds_step, stream.bytes_per_s
        sender = StreamSender(sonar_map, wanted.interest, step, limit)
        client = StreamClient(sender.info(), wanted.interest)
    link = SimulatedLink(plan.link, sender.pacer)
    return _WatchedClient(sender, client, link, Ages(sender.info(), wanted.interest))


def _map(sonar_map: SonarMap, pings: Pings, number: int) -> None:
    sonar_map.integrate(pings.echo(number, first_returns_only=False), pings.map_T_sonar[number])


class StreamStudy:
    """The study; the defaults are the daemon's, and those of a client that asks for all."""

    name = "stream"
    knobs: tuple[Knob, ...] = KNOBS
    dives: tuple[StudyDive, ...] = DIVES
    wholes: tuple[Setting, ...] = WHOLES
    columns: tuple[Column, ...] = COLUMNS
    error = ERROR
    cost = COST

    def prepare(self, dive: StudyDive, folder: Path) -> None:
        """As of `Study`."""
        prepare_dive(dive, folder)

    def measure(self, setting: Setting, dive: StudyDive, folder: Path) -> dict[str, float]:
        """As of `Study`."""
        plan = PLANS[dive.name]
        wanted = stream_setting(setting.overrides, plan.voxel_m)
        with constants(wanted):
            return watched(load_dive(folder), plan, wanted)
