"""A second cloud that is tried against the first: what if the vehicle is somewhere else?

Particles that are sure of a wrong place never find the right one, and random ones among them are
too few to be near it. So a cloud of its own is drawn anywhere on the map, from a scan, and both are
weighed by the same scans. Their odds follow Bayes' rule: the rival begins at long odds, so a
vehicle that is followed well is not thrown off, and where it becomes the likelier one the two
change places. Odds fade: scans of a minute ago tell less of where the vehicle is now.
"""

import math
from dataclasses import dataclass, replace

from mapperd.geometry.gaussian import wrapped
from mapperd.localization.particle_filter import Estimate, ParticleFilter

__all__ = ["LONG_ODDS", "Rival", "same_place", "spread_m"]

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
class Rival:
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

    def driven(self, way_m: float) -> "Rival":
        """After some way."""
        return replace(self, way_m=self.way_m + way_m)

    def weighed(self, fit: float, first_fit: float, votes: float) -> "Rival":
        """After a scan of so many independent beams, by both clouds' fit for a beam."""
        if not (fit > 0.0 and first_fit > 0.0):
            return self
        told = votes * math.log(fit / first_fit)
        odds = (1.0 - FADE) * self.log_odds + told
        return replace(self, log_odds=min(max(odds, -50.0), 50.0))

    def changed(self, first: ParticleFilter) -> "Rival":
        """The first cloud as the rival of this one."""
        return Rival(first, -self.log_odds, self.way_m)


def same_place(one: Estimate, other: Estimate) -> bool:
    """Whether two clouds have each one place, and it is the same."""
    x_m, y_m, yaw_rad = one.mean - other.mean
    near = math.hypot(x_m, y_m) < SAME_M and abs(wrapped(yaw_rad)) < SAME_RAD
    return near and all(spread_m(estimate) < TIGHT_M for estimate in (one, other))


def spread_m(estimate: Estimate) -> float:
    """Standard deviation of the place, in any direction."""
    return math.sqrt(estimate.covariance[0, 0] + estimate.covariance[1, 1])
