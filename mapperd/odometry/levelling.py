"""Levelling: the tilt of an odometry's world, from gravity while the vehicle stands still.

The rotation is the shortest one from the mean direction of the specific force, in the odometry's
world, to straight up. Applied as a rotation, not as negated angles, it is exact at any tilt and
does not change the heading of level vehicles.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd.config.odometry import WorldInitConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import quaternion_product, quaternion_to_matrix

__all__ = ["Levelling", "LevellingState"]

Floats = NDArray[np.float64]

GRAVITY_MPS2 = (9.0, 10.6)
"""Range of the specific force at rest, with a margin for errors of the accelerometer."""

OPPOSITE = 1e-9


class LevellingState(NamedTuple):
    """State of a `Levelling`: the forces (3,) so far, and the attributes."""

    forces: list[Floats]
    level_q_odometry: Floats | None
    refused: int


class Levelling:
    """Averages specific forces until the tilt is known.

    Attributes:
        level_q_odometry: (4,), from the odometry's world to the level one; None until known.
        refused: number of samples dropped because the vehicle moved.
    """

    def __init__(self, settings: WorldInitConfig) -> None:
        self._settings = settings
        self._forces: list[Floats] = []
        self.level_q_odometry: Floats | None = None
        self.refused = 0

    def state(self) -> LevellingState:
        """Return the state for `restore`."""
        return LevellingState(list(self._forces), self.level_q_odometry, self.refused)

    def restore(self, state: LevellingState) -> None:
        """Restore a state that `state` returned."""
        self._forces = list(state.forces)
        self.level_q_odometry, self.refused = state.level_q_odometry, state.refused

    @property
    def pending(self) -> Reject | None:
        """Return why mapping has to wait; None once level, or if levelling is off."""
        if not self._settings.enabled or self.level_q_odometry is not None:
            return None
        return Reject(
            "levelling",
            f"{len(self._forces)} of {self._settings.init_samples} accelerations of a vehicle "
            "that stands still; keep it still",
        )

    def add(
        self,
        specific_force_mps2: Floats,
        rate_radps: Floats | None,
        map_q_base: Floats,
        speed_mps: float | None = None,
    ) -> Reject | None:
        """Process an acceleration as an accelerometer measures it: (0, 0, 9.8) when level.

        Args:
            specific_force_mps2: (3,), base axes.
            rate_radps: (3,), about base axes; None if unknown.
            map_q_base: (4,), the odometry's attitude at that time.
            speed_mps: speed of the vehicle; None if unknown.

        Returns:
            Why it and all before were dropped; None if it was used.
        """
        if self.pending is None:
            return None
        force = quaternion_to_matrix(map_q_base) @ specific_force_mps2
        problem = self._driving(speed_mps) or self._moving(force, rate_radps)
        if problem is not None:
            self.refused += 1 + len(self._forces)
            self._forces.clear()
            return problem
        self._forces.append(force)
        if len(self._forces) >= self._settings.init_samples:
            self.level_q_odometry = _upright(np.mean(self._forces, axis=0))
        return None

    def status(self) -> dict[str, Any] | None:
        """Status for people: both frames and their rotation; None if levelling is off."""
        settings, level = self._settings, self.level_q_odometry
        if not settings.enabled:
            return None
        return {
            "parent_frame": settings.parent_frame,
            "child_frame": settings.child_frame,
            "parent_q_child": None if level is None else level.tolist(),
            "waits_for": None if self.pending is None else self.pending.detail,
            "refused": self.refused,
        }

    def _driving(self, speed_mps: float | None) -> Reject | None:
        limit = self._settings.max_speed
        if speed_mps is None or speed_mps <= limit:
            return None
        return Reject("moving", f"drives at {speed_mps:.2f} m/s; at most {limit:g}")

    def _moving(self, force: Floats, rate: Floats | None) -> Reject | None:
        settings = self._settings
        strength = float(np.linalg.norm(force))
        if not GRAVITY_MPS2[0] <= strength <= GRAVITY_MPS2[1]:
            return Reject("moving", f"an acceleration of {strength:.2f} m/s2 is not gravity alone")
        if rate is not None and np.linalg.norm(rate) > math.radians(settings.max_rate):
            turn_dps = math.degrees(float(np.linalg.norm(rate)))
            return Reject("moving", f"turns at {turn_dps:.1f} deg/s; at most {settings.max_rate:g}")
        if self._forces:
            # Compare in the world frame, where gravity is constant while the vehicle stands still.
            spread = float(np.linalg.norm(force - np.mean(self._forces, axis=0)))
            if spread > settings.max_spread:
                return Reject("moving", f"accelerations differ by {spread:.2f} m/s2")
        return None


def _upright(force: Floats) -> Floats:
    """Return the shortest rotation (4,) from a direction to +z (half-angle form of Rodrigues)."""
    x, y, z = force / np.linalg.norm(force)
    if z < OPPOSITE - 1.0:  # upside down: any horizontal axis works
        return np.array([0.0, 1.0, 0.0, 0.0])
    quaternion = np.array([1.0 + z, y, -x, 0.0])
    return np.asarray(quaternion / np.linalg.norm(quaternion), dtype=np.float64)


def levelled(level_q_odometry: Floats, map_q_base: Floats) -> Floats:
    """Return an attitude in the level world."""
    return quaternion_product(level_q_odometry, map_q_base)
