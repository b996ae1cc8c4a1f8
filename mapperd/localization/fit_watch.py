"""Whether scans lie on the map where the particles are: told by the scans' fit alone.

A cloud that is at one wrong place is as sure of itself as one at the right place, so weights do not
tell. Of returns at the right place most lie on a surface of the map: with a share h of them, the
fit, which is the mean likelihood of one beam, is hit^h miss^(1 - h).
"""

import math
from dataclasses import dataclass, replace

from mapperd.localization.particle_filter import HitModel

__all__ = ["FitWatch", "hit_share"]

GAIN = 0.1
"""Of a scan in the running mean: a few bad scans, as behind a hull, are none yet."""


def hit_share(fit: float, model: HitModel, max_distance_m: float) -> float:
    """The share of beams on the map, 0 to 1; a fit of 0 has none."""
    hit, miss = model.density(0.0), model.density(max_distance_m)
    if not fit > miss or not hit > miss:
        return 0.0
    return min(math.log(fit / miss) / math.log(hit / miss), 1.0)


@dataclass(frozen=True, slots=True)
class FitWatch:
    """A running mean of the share of hits.

    Attributes:
        share: None before the first scan.
    """

    share: float | None = None

    def after(self, share: float) -> "FitWatch":
        """With a scan's share."""
        mean = share if self.share is None else self.share + GAIN * (share - self.share)
        return replace(self, share=mean)

    def fits(self, least: float) -> bool:
        """Whether the map is met well enough, as far as is known."""
        return self.share is None or self.share >= least
