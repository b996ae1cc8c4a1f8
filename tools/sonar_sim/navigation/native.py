"""The native record: one MessagePack map a datagram."""

from sonar_sim.navigation.fix import Fix
from sonar_sim.odometry import odometry_record


class Native:
    """Every fix, stamped with Unix time."""

    def encode(self, fix: Fix) -> list[bytes]:
        """Return one record."""
        return [odometry_record(fix.sample, fix.valid_ns)]
