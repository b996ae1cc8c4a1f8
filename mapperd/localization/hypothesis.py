"""An alternative hypothesis, and the watch on the fit that calls for one.

Particles that converged at a wrong place do not find the right one, and a few random particles are
unlikely to land near it. Therefore a second cloud is drawn from a scan, anywhere on the map, and
the same scans weigh both clouds. Their odds follow Bayes' rule. The alternative starts at long
odds, so a well-tracked vehicle is not thrown off; when it becomes the likelier one, the clouds
swap. The odds fade, because older scans say less about the present pose.

The fit alone decides whether scans match the map at the particles: a cloud at a wrong place is as
narrow as one at the right place, so the weights do not tell them apart. At the right place most
returns lie on a surface of the map. With a share h of them, the fit (the mean likelihood of one
beam) is hit^h miss^(1 - h).
"""

import math
from dataclasses import dataclass, replace

from mapperd.geometry.gaussian import wrapped
from mapperd.localization.particle_filter import Estimate, HitModel, ParticleFilter

__all__ = [
    "LONG_ODDS",
    "AlternativeHypothesis",
    "FitWatch",
    "has_one_place",
    "hit_share",
    "same_place",
    "spread_m",
]

LONG_ODDS = math.log(1e-3)
"""Initial log-odds of an alternative: about how often an estimate is wrong when one is tried."""

HOPELESS_ODDS = math.log(1e-5)
FADE = 0.01
"""Share of the log-odds lost at each scan."""

TRIAL_M = 1.0
"""Minimum distance travelled before an alternative is dropped."""

SAME_M, SAME_RAD = 0.7, 0.2
TIGHT_M = 1.0


@dataclass(frozen=True, slots=True)
class AlternativeHypothesis:
    """A second cloud and its odds.

    Attributes:
        particles: the cloud.
        log_odds: of being right, against the first cloud.
        way_m: distance travelled since it started.
    """

    particles: ParticleFilter
    log_odds: float = LONG_ODDS
    way_m: float = 0.0

    @property
    def share(self) -> float:
        """Probability of this cloud against the first one, 0 to 1."""
        return 1.0 / (1.0 + math.exp(-self.log_odds))

    @property
    def leads(self) -> bool:
        """Whether it is the likelier cloud."""
        return self.log_odds > 0.0

    @property
    def hopeless(self) -> bool:
        """Whether it lost its trial."""
        return self.log_odds < HOPELESS_ODDS and self.way_m > TRIAL_M

    def driven(self, way_m: float) -> "AlternativeHypothesis":
        """Return the hypothesis after a distance travelled."""
        return replace(self, way_m=self.way_m + way_m)

    def weighed(self, fit: float, first_fit: float, votes: float) -> "AlternativeHypothesis":
        """Return the hypothesis after a scan that weighed both clouds.

        Args:
            fit: mean likelihood of a beam for this cloud.
            first_fit: the same for the first cloud.
            votes: number of independent beams of the scan.
        """
        if not (fit > 0.0 and first_fit > 0.0):
            return self
        evidence = votes * math.log(fit / first_fit)
        odds = (1.0 - FADE) * self.log_odds + evidence
        return replace(self, log_odds=min(max(odds, -50.0), 50.0))

    def changed(self, first: ParticleFilter) -> "AlternativeHypothesis":
        """Return the first cloud as the alternative to this one."""
        return AlternativeHypothesis(first, -self.log_odds, self.way_m)


def same_place(one: Estimate, other: Estimate) -> bool:
    """Whether both clouds are compact and at the same place."""
    x_m, y_m, yaw_rad = one.mean - other.mean
    near = math.hypot(x_m, y_m) < SAME_M and abs(wrapped(yaw_rad)) < SAME_RAD
    return near and has_one_place(one) and has_one_place(other)


def has_one_place(estimate: Estimate) -> bool:
    """Whether a cloud is compact."""
    return spread_m(estimate) < TIGHT_M


def spread_m(estimate: Estimate) -> float:
    """Standard deviation of the position, both axes together."""
    return math.sqrt(estimate.covariance[0, 0] + estimate.covariance[1, 1])


def hit_share(fit: float, model: HitModel, max_distance_m: float) -> float:
    """Share of beams that hit the map, 0 to 1; a fit of 0 gives 0."""
    hit, miss = model.density(0.0), model.density(max_distance_m)
    if not fit > miss or not hit > miss:
        return 0.0
    return min(math.log(fit / miss) / math.log(hit / miss), 1.0)


GAIN = 0.1
"""Weight of a scan in the running mean: a few bad scans, as behind a hull, hardly change it."""

RECOVERY = 0.3
"""Weight of a better scan in the recent share; a worse scan lowers the share at once."""

RECENT_FACTOR = 1.25
"""Factor by which the recent share must exceed the minimum, because a single scan varies more."""

MIN_RETURNS, MIN_HITS = 4, 3.0
"""Returns that a scan needs to contradict a pose, and hits that it needs to support one."""

MAX_UNSUPPORTED = 8
"""Consecutive updates without a supporting scan that are allowed: about a metre of travel."""


@dataclass(frozen=True, slots=True)
class FitWatch:
    """How well scans fit the map.

    Attributes:
        share: running mean of the share of hits; None before the first scan.
        recent: share of recent scans; falls at once and recovers within a few scans.
        unsupported: updates since a scan supported the pose.
        scans: number of scans in the mean; scans of a cloud that is still spread fit badly.
    """

    share: float | None = None
    recent: float | None = None
    unsupported: int = 0
    scans: int = 0

    def after(self, share: float | None, returns: int = 60) -> "FitWatch":
        """Return the watch after an update.

        Args:
            share: share of hits of the scan; None if the scan contains no information.
            returns: number of returns of the scan.
        """
        if share is None:
            return replace(self, unsupported=self.unsupported + 1)
        mean = share if self.share is None else self.share + GAIN * (share - self.share)
        recent = self.recent
        if returns >= MIN_RETURNS:
            recent = share if recent is None else recent + RECOVERY * (share - recent)
            recent = min(share, recent)
        supports = share * returns >= MIN_HITS
        unsupported = 0 if supports else self.unsupported + 1
        return FitWatch(mean, recent, unsupported, self.scans + 1)

    def fits(self, min_share: float) -> bool:
        """Whether the mean fits the map well enough; true while unknown."""
        return self.share is None or self.share >= min_share

    def denies(self, min_share: float) -> bool:
        """Whether the mean of enough scans contradicts the map."""
        return not self.fits(min_share) and self.scans * GAIN >= 1.0

    def dropped(self, by: float) -> bool:
        """Whether the recent share lies below the mean by more than `by`."""
        if self.share is None or self.recent is None:
            return False
        return self.recent < self.share - by

    def supports(self, min_share: float) -> bool:
        """Whether the mean and the recent scans fit the map well enough."""
        minimum = min(RECENT_FACTOR * min_share, 1.0)
        recent = self.recent is None or self.recent >= minimum
        return self.fits(min_share) and recent and self.unsupported <= MAX_UNSUPPORTED
