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
    """The base in the odometry's frame, in the plane."""

    x_m: float
    y_m: float
    yaw_rad: float

    @property
    def is_finite(self) -> bool:
        """Whether it is a pose at all."""
        return all(map(math.isfinite, (self.x_m, self.y_m, self.yaw_rad)))

    def step_m(self, other: "PlanarPose") -> float:
        """Distance to another one."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m)


@dataclass(frozen=True, slots=True)
class UpdateDecision:
    """What becomes of a scan.

    Attributes:
        reason: `first`, `motion`, `time`, `forced` or `odometry_jumped`, which counts no motion;
            without an update `still`, `bad_odometry` or `odometry_jump`.
        before: where the motion of the update begins: the odometry at the last one.
    """

    reason: str
    before: PlanarPose | None = None

    @property
    def is_update(self) -> bool:
        """Whether the filter is to take the scan."""
        return self.before is not None


@dataclass(frozen=True, slots=True)
class UpdateGate:
    """The state of the gate; it changes by making another one.

    Attributes:
        triggered: odometry where motion last called for an update; None asks for one.
        updated: odometry of the last update; None after a new start.
        updated_ns: its time.
        forced: the next scan leads to an update.
        suspect: odometry that stepped too far the last time.
    """

    triggered: PlanarPose | None = None
    updated: PlanarPose | None = None
    updated_ns: int | None = None
    forced: bool = False
    suspect: PlanarPose | None = None

    def force(self) -> "UpdateGate":
        """Have the next scan lead to an update."""
        return replace(self, forced=True)

    def restarted(self) -> "UpdateGate":
        """After a new start of the filter: the next scan is the first one."""
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
            odom: at the scan's time.
            stamp_ns: that time.
            amcl: `update_min_d`, `update_min_a`.
            max_interval_s: an update is due after so long in any case; 0 is never.
            max_step_m: a larger step of odometry since the last update is a fault. The reference is
                held; if odometry continues from there it has jumped and is the new reference.

        Returns:
            The gate after it, and the decision.
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
