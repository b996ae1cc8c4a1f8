"""An alternative hypothesis, and the watch on the fit that calls for one.

Particles that are sure of a wrong place never find the right one, and random ones among them are
too few to be near it. So a cloud of its own is drawn anywhere on the map, from a scan, and both are
weighed by the same scans. Their odds follow Bayes' rule: the rival begins at long odds, so a
vehicle that is followed well is not thrown off, and where it becomes the likelier one the two
change places. Odds fade: older scans contain less information about the present pose.

Whether scans fit the map at the particles is judged by the fit alone.

A cloud at one wrong place is as narrow as one at the right place, so weights do not show which it
is. Of returns at the right place most lie on a surface of the map: with a share h of them, the
fit, which is the mean likelihood of one beam, is hit^h miss^(1 - h).
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
"""Of a rival's beginning: about how often an estimate is wrong when a rival is tried."""

HOPELESS_ODDS = math.log(1e-5)
FADE = 0.01
"""Of the odds, at each scan."""

TRIAL_M = 1.0
"""Of way that a rival has at least."""

SAME_M, SAME_RAD = 0.7, 0.2
TIGHT_M = 1.0


@dataclass(frozen=True, slots=True)
class AlternativeHypothesis:
    """Another cloud and its odds.

    Attributes:
        particles: the cloud.
        log_odds: of being right, against the first cloud.
        way_m: driven since it began.
    """

    particles: ParticleFilter
    log_odds: float = LONG_ODDS
    way_m: float = 0.0

    @property
    def share(self) -> float:
        """Its weight beside the first cloud, 0 to 1."""
        return 1.0 / (1.0 + math.exp(-self.log_odds))

    @property
    def leads(self) -> bool:
        """It is the likelier one."""
        return self.log_odds > 0.0

    @property
    def hopeless(self) -> bool:
        """It has had its trial, and lost."""
        return self.log_odds < HOPELESS_ODDS and self.way_m > TRIAL_M

    def driven(self, way_m: float) -> "AlternativeHypothesis":
        """After some way."""
        return replace(self, way_m=self.way_m + way_m)

    def weighed(self, fit: float, first_fit: float, votes: float) -> "AlternativeHypothesis":
        """After a scan of so many independent beams, by both clouds' fit for a beam.

        Args:
            fit: of this cloud.
            first_fit: of the first cloud.
            votes: independent beams of the scan.
        """
        if not (fit > 0.0 and first_fit > 0.0):
            return self
        evidence = votes * math.log(fit / first_fit)
        odds = (1.0 - FADE) * self.log_odds + evidence
        return replace(self, log_odds=min(max(odds, -50.0), 50.0))

    def changed(self, first: ParticleFilter) -> "AlternativeHypothesis":
        """The first cloud as the rival of this one."""
        return AlternativeHypothesis(first, -self.log_odds, self.way_m)


def same_place(one: Estimate, other: Estimate) -> bool:
    """Whether two clouds have each one place, and it is the same."""
    x_m, y_m, yaw_rad = one.mean - other.mean
    near = math.hypot(x_m, y_m) < SAME_M and abs(wrapped(yaw_rad)) < SAME_RAD
    return near and has_one_place(one) and has_one_place(other)


def has_one_place(estimate: Estimate) -> bool:
    """Whether a cloud is not spread over several places."""
    return spread_m(estimate) < TIGHT_M


def spread_m(estimate: Estimate) -> float:
    """Standard deviation of the place, in any direction."""
    return math.sqrt(estimate.covariance[0, 0] + estimate.covariance[1, 1])


def hit_share(fit: float, model: HitModel, max_distance_m: float) -> float:
    """The share of beams on the map, 0 to 1; a fit of 0 has none."""
    hit, miss = model.density(0.0), model.density(max_distance_m)
    if not fit > miss or not hit > miss:
        return 0.0
    return min(math.log(fit / miss) / math.log(hit / miss), 1.0)


GAIN = 0.1
"""Weight of a scan in the running mean: a few bad scans, as behind a hull, do not count."""

RECOVERY = 0.3
"""Weight of a better scan in the recent share, which a worse scan lowers at once."""

RECENT_FACTOR = 1.25
"""A single scan has to meet the map better than the mean of many."""

MIN_RETURNS, MIN_HITS = 4, 3.0
"""A scan of fewer returns does not contradict a pose; one of fewer returns on the map does not
support it."""

MAX_UNSUPPORTED = 8
"""Updates in succession without a scan that supports the pose: about a metre of way."""


@dataclass(frozen=True, slots=True)
class FitWatch:
    """How well scans lie on the map.

    Attributes:
        share: running mean of the share of hits; None before the first scan.
        recent: falls to a worse scan's share at once, recovers within a few scans.
        unsupported: updates since a scan supported the pose.
        scans: in the mean; those of a cloud that is still spread meet the map badly.
    """

    share: float | None = None
    recent: float | None = None
    unsupported: int = 0
    scans: int = 0

    def after(self, share: float | None, returns: int = 60) -> "FitWatch":
        """After an update.

        Args:
            share: of the scan; None if the scan contains no information.
            returns: of the scan.
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
        """Whether the map is met well enough, as far as is known."""
        return self.share is None or self.share >= min_share

    def denies(self, min_share: float) -> bool:
        """Whether a mean of enough scans misses the map."""
        return not self.fits(min_share) and self.scans * GAIN >= 1.0

    def dropped(self, by: float) -> bool:
        """Whether the last scans meet the map worse than the mean, by so large a share."""
        if self.share is None or self.recent is None:
            return False
        return self.recent < self.share - by

    def supports(self, min_share: float) -> bool:
        """Whether the map is met well enough by the mean and by the last scans."""
        least = min(RECENT_FACTOR * min_share, 1.0)
        recent = self.recent is None or self.recent >= least
        return self.fits(min_share) and recent and self.unsupported <= MAX_UNSUPPORTED
