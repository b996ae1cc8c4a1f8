"""What a client's map is judged by."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapperd.wire.messages import MapFacts
from studies.accuracy_cost.streaming.clients import Client
from studies.accuracy_cost.streaming.truth import EDGE, UNIT, Blocks, distances_m
from studies.accuracy_cost.study import Column

__all__ = ["COLUMNS", "COST", "ERROR", "NEAR_M", "Moment", "moment", "summary"]

NEAR_M = 10.0

ERROR, COST = "p_error_near", "kb_per_s"

COLUMNS = (
    Column(ERROR, "error of the probability at the client, within 10 m (mean)"),
    Column("p_error", "the same, of the whole map"),
    Column(
        "wrong_class_near", "occupied and free voxels within 10 m told as something else, share"
    ),
    Column("log_odds_rms", "error of the log-odds of voxels that the client knows (rms)"),
    Column("near_age_median_s", "age of the oldest block within 10 m, median (s)"),
    Column("near_age_p95_s", "age of the oldest block within 10 m, 95 % (s)"),
    Column("far_age_median_s", "age of the oldest block beyond 10 m, median (s)"),
    Column("far_age_p95_s", "age of the oldest block beyond 10 m, 95 % (s)"),
    Column("bytes_per_voxel", "bytes a voxel that changed"),
    Column(COST, "told to one client (kB/s)"),
    Column("cpu_ms_per_ping", "CPU time per ping, mean (ms)", repeatable=False),
    Column("cpu_median_ms", "CPU time per ping, median (ms)", repeatable=False),
    Column("cpu_p95_ms", "CPU time per ping, 95 % (ms)", repeatable=False),
    Column("memory_mb", "memory of index and client (MB)"),
)

MOST_LOG_ODDS = 20.0


@dataclass(frozen=True, slots=True)
class Moment:
    """How a client's map differs from the daemon's at one time."""

    p_error_near: float
    p_error: float
    wrong_class_near: float
    square: float
    known: int


def moment(blocks: Blocks, client: Client, facts: MapFacts, position_m: np.ndarray) -> Moment:
    """Compare all voxels that the daemon knows."""
    known = blocks.counts > 0
    held = client.probabilities(blocks.keys)
    true_log_odds = blocks.units * np.float32(UNIT)
    true = 1 / (1 + np.exp(-true_log_odds))
    missing = np.isnan(held)
    off = np.abs(np.where(missing, np.float32(0.5), held) - true)
    wide = blocks.keys.astype(np.int64)
    near = distances_m(wide, facts.resolution_m * EDGE, position_m) <= NEAR_M
    both = known & ~missing
    with np.errstate(divide="ignore", invalid="ignore"):
        told = np.clip(np.log(held) - np.log1p(-held), -MOST_LOG_ODDS, MOST_LOG_ODDS)
    apart = told[both] - true_log_odds[both]
    at = known[near]
    return Moment(
        float(off[near][at].mean()) if at.any() else 0.0,
        float(off[known].mean()) if known.any() else 0.0,
        _wrong_share(true_log_odds[near][at], told[near][at], facts),
        float(np.square(apart, dtype=np.float64).sum()),
        int(both.sum()),
    )


def _wrong_share(true: np.ndarray, told: np.ndarray, facts: MapFacts) -> float:
    """Of the voxels that are occupied or free; what is not known (NaN) is neither."""
    occupied, free = true > facts.occupied_log_odds, true < facts.free_log_odds
    wrong = (occupied & ~(told > facts.occupied_log_odds)) | (free & ~(told < facts.free_log_odds))
    decided = occupied | free
    return float(wrong[decided].mean()) if decided.any() else 0.0


def summary(moments: Sequence[Moment], ages_s: Sequence[tuple[float, float]]) -> dict[str, float]:
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
