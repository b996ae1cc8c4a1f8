"""A planar pose that is not sure: a mean and a covariance."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Belief", "PlanarGaussian", "wrapped"]

Floats = NDArray[np.float64]

ASYMMETRY = 1e-9
NEGATIVE_EIGENVALUE = 1e-9
"""Rounding, of the largest entry or eigenvalue: below it a covariance is mended, above refused."""

ELSEWHERE_M = 1.0
AMBIGUOUS_SHARE = 0.1
"""Particles of one mode are cut into clusters, so that their number alone means little; a tenth of
the weight a metre away indicates another mode."""


def wrapped(angle_rad: float) -> float:
    """The same angle in -pi to pi."""
    return math.remainder(angle_rad, math.tau)


class GaussianState(NamedTuple):
    """The fields of a `PlanarGaussian`."""

    x_m: float
    y_m: float
    yaw_rad: float
    covariance: Floats


class BeliefState(NamedTuple):
    """The fields of a `Belief`."""

    best: GaussianState
    overall: GaussianState
    masses: Floats
    elsewhere: float
    effective_size: float
    fits: bool
    confirmed: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class PlanarGaussian:
    """The vehicle's place and heading on a map.

    Attributes:
        x_m, y_m, yaw_rad: mean, map frame; the heading in -pi to pi.
        covariance: (3, 3) float64, read-only, of (x, y, yaw): symmetric, positive semi-definite.
            Asymmetry and negative eigenvalues that are rounding are mended.

    Raises:
        ValueError: not finite, or no covariance.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    covariance: Floats

    def __post_init__(self) -> None:
        """Check, mend and own the numbers."""
        mean = (float(self.x_m), float(self.y_m), float(self.yaw_rad))
        if not all(map(math.isfinite, mean)):
            raise ValueError("a pose is finite")
        for name, value in zip(("x_m", "y_m", "yaw_rad"), mean, strict=True):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "yaw_rad", wrapped(mean[2]))
        object.__setattr__(self, "covariance", _mended(np.array(self.covariance, np.float64)))

    def state(self) -> GaussianState:
        """Its numbers."""
        return GaussianState(self.x_m, self.y_m, self.yaw_rad, self.covariance)

    @classmethod
    def restored(cls, state: GaussianState) -> "PlanarGaussian":
        """The one of which `state` was taken: equal to the bit, so nothing is mended again."""
        made = object.__new__(cls)
        for name, value in state._asdict().items():
            object.__setattr__(made, name, value)
        return made


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Pose estimate of a particle cloud.

    Attributes:
        best: Gaussian of the heaviest cluster of at least two particles, or of all particles.
        overall: Gaussian of all particles. Its mean may lie between two modes: see `elsewhere`.
        masses: (clusters,) weight of each cluster, falling; their sum is 1.
        elsewhere: weight of the particles that the best cluster does not explain: farther from its
            mean than `ELSEWHERE_M` and than three of its standard deviations.
        effective_size: effective sample size.
        fits: recent scans lie on the map where the particles are. Where they do not, the vehicle
            is elsewhere, even if no particle is.
        confirmed: the pose was given, or verified against distant ones.
    """

    best: PlanarGaussian
    overall: PlanarGaussian
    masses: Floats
    elsewhere: float
    effective_size: float
    fits: bool = True
    confirmed: bool = True

    def state(self) -> BeliefState:
        """Its parts."""
        return BeliefState(
            self.best.state(),
            self.overall.state(),
            self.masses,
            self.elsewhere,
            self.effective_size,
            self.fits,
            self.confirmed,
        )

    @classmethod
    def restored(cls, state: BeliefState) -> "Belief":
        """The one of which `state` was taken."""
        return cls(
            PlanarGaussian.restored(state.best),
            PlanarGaussian.restored(state.overall),
            state.masses,
            state.elsewhere,
            state.effective_size,
            state.fits,
            state.confirmed,
        )

    @property
    def ambiguous(self) -> bool:
        """The vehicle may as well be somewhere else."""
        return self.elsewhere > AMBIGUOUS_SHARE or not (self.fits and self.confirmed)


def _mended(covariance: Floats) -> Floats:
    if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
        raise ValueError("a covariance has 3 x 3 finite numbers")
    largest = float(np.abs(covariance).max())
    if np.abs(covariance - covariance.T).max() > ASYMMETRY * largest:
        raise ValueError("the covariance is not symmetric")
    mended = (covariance + covariance.T) / 2
    eigenvalues, vectors = np.linalg.eigh(mended)
    if eigenvalues[0] < -NEGATIVE_EIGENVALUE * max(float(eigenvalues[-1]), 0.0):
        raise ValueError("the covariance is not positive semi-definite")
    if eigenvalues[0] < 0:
        mended = (vectors * np.maximum(eigenvalues, 0.0)) @ vectors.T
    mended.setflags(write=False)
    return mended
