"""Selects the scans that lead to an update: after enough motion, or on request.

Motion is the distance and the angle, in the odometry's frame, since the last update that motion
triggered; both limits are strict. As in Beluga AMCL, a requested update does not move that
reference. As in Nav2, the first scan after a new start sets the reference and earlier motion is
ignored.
"""

import math
from dataclasses import dataclass, replace

from mapperd.config.tree import AmclConfig
from mapperd.geometry.gaussian import wrapped

__all__ = ["PlanarPose", "UpdateDecision", "UpdateGate"]


@dataclass(frozen=True, slots=True)
class PlanarPose:
    """Planar pose of the base in the odometry's frame."""

    x_m: float
    y_m: float
    yaw_rad: float

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return all(map(math.isfinite, (self.x_m, self.y_m, self.yaw_rad)))

    def step_m(self, other: "PlanarPose") -> float:
        """Return the distance to another pose."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m)


@dataclass(frozen=True, slots=True)
class UpdateDecision:
    """Decision about a scan.

    Attributes:
        reason: `first`, `motion`, `time`, `forced` or `odometry_jumped`, which counts no motion;
            without an update `still`, `bad_odometry` or `odometry_jump`.
        before: odometry at the last update, where the motion of this one begins.
    """

    reason: str
    before: PlanarPose | None = None

    @property
    def is_update(self) -> bool:
        """Whether the scan leads to an update."""
        return self.before is not None


@dataclass(frozen=True, slots=True)
class UpdateGate:
    """State of the gate; immutable, methods return a new one.

    Attributes:
        triggered: odometry at the last update that motion triggered; None requests one.
        updated: odometry of the last update; None after a new start.
        updated_ns: time of the last update.
        forced: the next scan leads to an update.
        suspect: odometry of a step that was too large.
    """

    triggered: PlanarPose | None = None
    updated: PlanarPose | None = None
    updated_ns: int | None = None
    forced: bool = False
    suspect: PlanarPose | None = None

    def force(self) -> "UpdateGate":
        """Return a gate whose next scan leads to an update."""
        return replace(self, forced=True)

    def restarted(self) -> "UpdateGate":
        """Return the gate after a new start of the filter."""
        return UpdateGate(forced=True)

    def decide(
        self,
        odom: PlanarPose,
        stamp_ns: int,
        amcl: AmclConfig,
        *,
        max_interval_s: float = 0.0,
        max_step_m: float = math.inf,
    ) -> "tuple[UpdateGate, UpdateDecision]":
        """Decide about a scan.

        Args:
            odom: odometry at the time of the scan.
            stamp_ns: that time.
            amcl: `update_min_d`, `update_min_a`.
            max_interval_s: an update is due after this time in any case; 0 disables this.
            max_step_m: a larger step of odometry since the last update is a fault. The reference
                stays; if odometry continues from there, it jumped and becomes the reference.

        Returns:
            The new gate, and the decision.
        """
        if not odom.is_finite:
            return self, UpdateDecision("bad_odometry")
        if self.updated is not None and odom.step_m(self.updated) > max_step_m:
            if self.suspect is None or odom.step_m(self.suspect) > max_step_m:
                return replace(self, suspect=odom), UpdateDecision("odometry_jump")
            return UpdateGate(odom, odom, stamp_ns), UpdateDecision("odometry_jumped", odom)
        fired = self._trigger(odom, amcl)
        reason = fired or self._other_reason(stamp_ns, max_interval_s)
        if reason is None:
            return replace(self, suspect=None), UpdateDecision("still")
        reference = odom if fired else self.triggered
        return UpdateGate(reference, odom, stamp_ns), UpdateDecision(reason, self.updated or odom)

    def _trigger(self, odom: PlanarPose, amcl: AmclConfig) -> str | None:
        if self.triggered is None:
            return "first"
        turned = abs(wrapped(odom.yaw_rad - self.triggered.yaw_rad))
        moved = odom.step_m(self.triggered)
        return "motion" if moved > amcl.update_min_d or turned > amcl.update_min_a else None

    def _other_reason(self, stamp_ns: int, max_interval_s: float) -> str | None:
        if self.forced:
            return "forced"
        late = self.updated_ns is not None and stamp_ns - self.updated_ns >= max_interval_s * 1e9
        return "time" if max_interval_s > 0 and late else None
