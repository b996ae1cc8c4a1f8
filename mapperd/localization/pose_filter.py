"""What localization needs of a filter."""

from typing import Protocol

from mapperd.config.tree import Config
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.maps import LocalizationMap
from mapperd.localization.scan import Scan
from mapperd.localization.update_gate import PlanarPose

__all__ = ["PoseFilter"]


class PoseFilter(Protocol):
    """Particles on a map."""

    def reconfigure(self, config: Config) -> None:
        """Take other settings; the particles are as they were."""

    def take_map(self, known: LocalizationMap) -> None:
        """Use another map from now on; the particles are as they were."""

    def start_at(self, pose: PlanarGaussian) -> None:
        """Draw all particles anew around a pose; averages and counters begin anew."""

    def start_anywhere(self) -> None:
        """Draw all particles anew on the map's free cells."""

    def update(
        self, before: PlanarPose, now: PlanarPose, scan: Scan, base_height_m: float
    ) -> Belief:
        """Move, weigh and, if it is due, resample the particles.

        Args:
            before: odometry at the last update.
            now: odometry at the scan.
            scan: what to weigh by; an empty one moves the particles only.
            base_height_m: of the base in the map, from the depth.

        Returns:
            Where the vehicle is.
        """
