"""Calibration of probabilities for exports: a table of log-odds.

The rule of update is no Bayesian's: pings are not independent, and an echo may be anywhere in the
vertical aperture, so that a voxel's probability is a rank more than a share. A calibration turns it
into a share: that of voxels like it which held something, in scenes whose truth is known. It
changes numbers in files, never the map, nor which voxels are occupied.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mapperd.config.loader import YamlProblem, parse_yaml
from mapperd.errors import ConfigError, os_reason
from mapperd.mapping.probability import probabilities_of
from mapperd.mapping.queries import VoxelCloud
from mapperd.mapping.sonar_map import Voxels

__all__ = ["ProbabilityCalibration", "load_calibration"]

MAX_FILE_BYTES = 64 * 1024
MAX_LOG_ODDS = 30.0


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The document."""

    log_odds: tuple[float, ...]
    calibrated: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ProbabilityCalibration:
    """A curve that never falls, straight between its points and level beyond them.

    Attributes:
        log_odds: (N,) of the map, rising.
        calibrated: (N,) log-odds that stand for them, not falling.

    Raises:
        ValueError: the curve is invalid; the text states why.
    """

    log_odds: NDArray[np.float64]
    calibrated: NDArray[np.float64]

    def __post_init__(self) -> None:
        both = np.concatenate([self.log_odds, self.calibrated])
        if len(self.log_odds) != len(self.calibrated) or len(self.log_odds) == 0:
            raise ValueError(
                f"{len(self.log_odds)} log_odds and {len(self.calibrated)} calibrated; "
                "allowed: as many of both, at least one"
            )
        if not (np.abs(both) <= MAX_LOG_ODDS).all():
            raise ValueError(f"numbers must lie within ±{MAX_LOG_ODDS:g}")
        if not (np.diff(self.log_odds) > 0).all():
            raise ValueError("log_odds must rise")
        if not (np.diff(self.calibrated) >= 0).all():
            raise ValueError("calibrated must not fall")

    def log_odds_of(self, log_odds: NDArray[np.floating]) -> NDArray[np.float64]:
        """Calibrated log-odds of log-odds of any shape."""
        return np.asarray(np.interp(log_odds, self.log_odds, self.calibrated))

    def probability_of(self, probability: NDArray[np.floating]) -> NDArray[np.float64]:
        """Calibrated probabilities of probabilities of any shape, 0 and 1 among them."""
        wide = probability.astype(np.float64)
        with np.errstate(divide="ignore"):
            log_odds = np.log(wide) - np.log1p(-wide)
        return probabilities_of(self.log_odds_of(log_odds))

    def of(self, voxels: VoxelCloud) -> VoxelCloud:
        """The same voxels with calibrated probabilities."""
        return _CalibratedVoxels(voxels, self)


@dataclass(frozen=True, slots=True)
class _CalibratedVoxels:
    """Voxels whose probabilities are calibrated as they are read."""

    voxels: VoxelCloud
    calibration: ProbabilityCalibration

    def __len__(self) -> int:
        return len(self.voxels)

    @property
    def box_m(self) -> NDArray[np.float64]:
        """Box around the voxels, (2, 3)."""
        return self.voxels.box_m

    def batches(self) -> Iterator[Voxels]:
        """Yield the voxels."""
        for some in self.voxels.batches():
            calibrated = self.calibration.probability_of(some.probability)
            yield replace(some, probability=calibrated.astype(np.float32))


def load_calibration(path: Path) -> ProbabilityCalibration:
    """Read a calibration: YAML with the lists `log_odds` and `calibrated`.

    Raises:
        ConfigError: it cannot be read, or is invalid; one line.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        if len(data) > MAX_FILE_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_FILE_BYTES // 1024} KiB, no calibration")
        tree: Any = parse_yaml(data.decode())
        curve = msgspec.convert(tree, _File)
        return ProbabilityCalibration(np.array(curve.log_odds), np.array(curve.calibrated))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {os_reason(error)}") from error
    except (YamlProblem, msgspec.ValidationError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from error
