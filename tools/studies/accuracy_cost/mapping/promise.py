"""What was promised beside the published settings, and what came of it.

"At equal error our default is at least 10 times cheaper than the published settings, and at equal
time its error is at least 2 times smaller." Equal error and equal time are reached by turning our
knobs: of all settings that were measured, the cheapest that errs no more than the published ones,
and the one that errs least in no more than their time.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from studies.accuracy_cost.mapping.knobs import PUBLISHED, PUBLISHED_FILE, PUBLISHED_SHIPPED
from studies.accuracy_cost.mapping.measuring import COST, ERROR

__all__ = ["CHEAPER", "MORE_EXACT", "EvidenceComparison", "Kept", "evidence", "kept", "sentences"]

CHEAPER, MORE_EXACT = 10.0, 2.0
RAYS = "mapping.integrator=rays"

Rows = Mapping[str, Mapping[str, float]]
"""Figures of one dive by the settings' keys."""


@dataclass(frozen=True, slots=True)
class Kept:
    """What came of the promise, on one dive and beside one published configuration.

    Attributes:
        error_m, cost_ms: of the published configuration.
        cheapest: key of our cheapest setting with no more error; None where all have more.
        times_cheaper: published time over its time; 0 without it.
        best: key of our setting of least error in no more time; None where all take more.
        times_more_exact: published error over its error; 0 without it.
        default_error_m, default_cost_ms: of our default, which stands at neither place.
    """

    error_m: float
    cost_ms: float
    cheapest: str | None
    times_cheaper: float
    best: str | None
    times_more_exact: float
    default_error_m: float
    default_cost_ms: float

    @property
    def is_kept(self) -> bool:
        """Both parts of it."""
        return self.times_cheaper >= CHEAPER and self.times_more_exact >= MORE_EXACT


@dataclass(frozen=True, slots=True)
class EvidenceComparison:
    """The same for the evidence of each voxel, on one dive: log-odds beside the converged map's.

    Attributes:
        rays_error, rays_ms: of sampled sub-rays, all else by default.
        default_error, default_ms: of our default.
    """

    rays_error: float
    rays_ms: float
    default_error: float
    default_ms: float

    @property
    def times_more_exact(self) -> float:
        """How much less the default errs."""
        return self.rays_error / self.default_error

    @property
    def times_dearer(self) -> float:
        """How much more time it takes."""
        return self.default_ms / self.rays_ms


def kept(rows: Rows, published: str = PUBLISHED.key, error: str = ERROR) -> Kept:
    """Look for our settings of equal error and of equal time.

    Args:
        rows: of one dive; the default and the published configuration are among them.
        published: key of the configuration to stand beside.
        error: the column that counts as error, less is better.
    """
    theirs, default = rows[published], rows[""]
    ours = {key: row for key, row in rows.items() if RAYS not in key}
    as_exact = {key: row[COST] for key, row in ours.items() if row[error] <= theirs[error]}
    as_cheap = {key: row[error] for key, row in ours.items() if row[COST] <= theirs[COST]}
    as_cheap = {key: value for key, value in as_cheap.items() if math.isfinite(value)}
    cheapest = min(as_exact, key=as_exact.__getitem__, default=None)
    best = min(as_cheap, key=as_cheap.__getitem__, default=None)
    return Kept(
        theirs[error],
        theirs[COST],
        cheapest,
        0.0 if cheapest is None else theirs[COST] / as_exact[cheapest],
        best,
        0.0 if best is None else theirs[error] / as_cheap[best],
        default[error],
        default[COST],
    )


def evidence(rows: Rows) -> EvidenceComparison:
    """Compare the default with sampled sub-rays in log-odds."""
    rays, default = rows[RAYS], rows[""]
    name = "log_odds_error"
    return EvidenceComparison(rays[name], rays[COST], default[name], default[COST])


def _at_equal_error(found: Kept) -> str:
    if found.cheapest is None:
        return "none errs so little"
    return f"{_times(found.times_cheaper, 'cheaper', 'dearer', '.2g')} (`{found.cheapest}`)"


def _at_equal_time(found: Kept) -> str:
    if found.best is None:
        return "none takes so little"
    return f"error {_times(found.times_more_exact, 'smaller', 'larger', '.2f')} (`{found.best}`)"


def _times(factor: float, more: str, less: str, form: str) -> str:
    return f"{factor:{form}} times {more}" if factor >= 1.0 else f"{1 / factor:{form}} times {less}"


def sentences(dives: Mapping[str, Rows]) -> str:
    """What came of it on each dive, as Markdown."""
    lines = [
        "| dive | beside | its error, its time | ours at equal error | ours at equal time | kept |",
        "|---|---|---|---|---|---|",
    ]
    for dive, rows in dives.items():
        for whole in (PUBLISHED, PUBLISHED_SHIPPED, PUBLISHED_FILE):
            found = kept(rows, whole.key)
            lines.append(
                f"| {dive} | {whole.label} | {found.error_m:.3f} m, {found.cost_ms:.1f} ms | "
                f"{_at_equal_error(found)} | {_at_equal_time(found)} | "
                f"{'yes' if found.is_kept else '**no**'} |"
            )
    lines += ["", "| dive | log-odds off, rays | ours | times more exact | time, rays | ours |"]
    lines += ["|---|---:|---:|---:|---:|---:|"]
    for dive, rows in dives.items():
        exact = evidence(rows)
        lines.append(
            f"| {dive} | {exact.rays_error:.3g} | {exact.default_error:.3g} | "
            f"{exact.times_more_exact:.0f} | {exact.rays_ms:.1f} ms | {exact.default_ms:.1f} ms |"
        )
    return "\n".join(lines)
