"""What is to be told about an estimate and about the settings."""

import math
from dataclasses import dataclass
from typing import Literal

from mapperd.config.tree import Amcl
from mapperd.geometry.gaussian import PlanarGaussian

__all__ = ["Deviation", "Diagnosis", "diagnose", "weight_warning"]

WEIGHT_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Deviation:
    """One standard deviation and the level that it is warned of above."""

    name: Literal["std_x", "std_y", "std_yaw"]
    value: float
    warn_level: float

    @property
    def is_too_large(self) -> bool:
        """Strictly above; a number that is none is too large as well."""
        return not self.value <= self.warn_level


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """How sure the estimate is.

    Attributes:
        level: OK, also before the first estimate, or WARN.
        deviations: in metres and radians; none before the first estimate.
        text: one line for a person.
    """

    level: Literal["OK", "WARN"]
    deviations: tuple[Deviation, ...]
    text: str


def diagnose(estimate: PlanarGaussian | None, amcl: Amcl) -> Diagnosis:
    """Compare an estimate's standard deviations with `amcl.std_warn_level_*`."""
    if estimate is None:
        return Diagnosis("OK", (), "no estimate yet")
    x, y, yaw = (math.sqrt(max(float(estimate.covariance[k, k]), 0.0)) for k in range(3))
    deviations = (
        Deviation("std_x", x, amcl.std_warn_level_x),
        Deviation("std_y", y, amcl.std_warn_level_y),
        Deviation("std_yaw", yaw, amcl.std_warn_level_yaw),
    )
    large = [one for one in deviations if one.is_too_large]
    if not large:
        return Diagnosis("OK", deviations, "the estimate is within its levels")
    told = ", ".join(f"{one.name} {one.value:.3g} above {one.warn_level:g}" for one in large)
    return Diagnosis("WARN", deviations, told)


def weight_warning(amcl: Amcl) -> str | None:
    """What is to be said of observation weights that do not sum to 1; None where they do.

    Nothing makes them sum to 1: they are used as they are set.
    """
    names = ["laser_z_hit", "laser_z_rand"]
    if amcl.laser_model_type == "beam":
        names += ["laser_z_max", "laser_z_short"]
    total = sum(getattr(amcl, name) for name in names)
    if abs(total - 1) <= WEIGHT_TOLERANCE:
        return None
    return f"amcl: {' + '.join(names)} is {total:g}, not 1"
