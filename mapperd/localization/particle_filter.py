"""What localization needs of a particle filter; the one that does it is in the core."""

from typing import Protocol

from mapperd.localization.estimate import PlanarGaussian
from mapperd.localization.grid_map import GridMap
from mapperd.localization.scan import Scan
from mapperd.localization.update_gate import PlanarPose

__all__ = ["ParticleFilter"]


class ParticleFilter(Protocol):
    """Particles on a map."""

    def take_map(self, grid: GridMap) -> None:
        """Use another map from now on; the particles are as they were."""

    def start_at(self, pose: PlanarGaussian) -> None:
        """Draw all particles anew around a pose; averages and counters begin anew."""

    def start_anywhere(self) -> None:
        """Draw all particles anew on the map's free cells."""

    def update(self, before: PlanarPose, now: PlanarPose, scan: Scan) -> PlanarGaussian:
        """Move, weigh and, if it is due, resample the particles.

        Args:
            before: odometry at the last update.
            now: odometry at the scan.
            scan: what to weigh by; an empty one moves the particles only.

        Returns:
            The estimate.
        """
