"""From how high a part of the water a return may come.

The map spreads an echo over where half of its power is left after both ways: most echoes come from
there. A first return is the edge of what is nearest, and is heard beyond: localization reckons with
the one-way width, where a quarter is left after both ways. Down to there a beam falls off as a
Gauss curve does, of which that is sqrt 2 times as much.
"""

import math

from mapperd.config.tree import Sonar

__all__ = ["heard_aperture_rad"]


def heard_aperture_rad(sonar: Sonar) -> float:
    """Full vertical angle that a first return may come from: the beam's one-way width."""
    return math.sqrt(2.0) * math.radians(sonar.vertical_aperture)
