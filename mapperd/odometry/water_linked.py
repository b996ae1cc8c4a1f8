"""What a Water Linked DVL (A50, A125) reports, whichever way it comes, in our frames.

Fields, units and axes: the maker's protocol pages, "DVL A50/A125 TCP JSON API" and "serial
protocol". The reports are in the frame of the DVL or, once a mounting rotation offset is set in
it, of the vehicle: x forward, y to starboard, z down. Positions count from where and how the DVL
stood at its last reset. Of its times, those of a velocity are in microseconds, that of a
position in seconds; before the DVL is told the time they count from some zero of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.frames import BODY_TO_FLU, WORLD_TO_ENU, rotation_from_rpy
from mapperd.odometry.convert import (
    MAX_COVARIANCE,
    MAX_DISTANCE_M,
    MAX_SPEED_MPS,
    bad_number,
    bad_numbers,
    linear_covariance,
    orientation,
    turned,
    turned_covariance,
)
from mapperd.odometry.records import UNKNOWN_VARIANCE, Clock, Odometry
from mapperd.reject import Reject

__all__ = ["NO_CONFIDENCE_FOM_MPS", "OVERHEATING", "Position", "Velocity"]

Floats = NDArray[np.float64]

NO_CONFIDENCE_FOM_MPS = 0.4
"""Figure of merit at which the confidence is 0, as BlueOS's extension for this DVL has it."""

OVERHEATING = 1
"""Bit of a velocity report's status: about to switch itself off."""

SOURCE = "water_linked"
MAX_STAMP_S = 9e9
_UNIX_FROM_NS = 10**18
"""A stamp of the year 2001 or later tells the time; a smaller one that nobody told the DVL."""


@dataclass(frozen=True, slots=True)
class Velocity:
    """One velocity report over ground, as it stood on the wire.

    Attributes:
        velocity_mps: vx, vy, vz.
        valid: whether the DVL saw the bottom; else velocity and altitude mean nothing.
        altitude_m: along z; negative is none.
        fom_mps: figure of merit.
        covariance: 9 numbers, (m/s)^2, row by row.
        validity_us: when the sound met the bottom; None from old firmware.
        sent_us: when the report left.
    """

    velocity_mps: Sequence[float]
    valid: bool
    altitude_m: float
    fom_mps: float
    covariance: Sequence[float]
    validity_us: int | None
    sent_us: int | None

    def odometry(self) -> Odometry | Reject:
        """In our frames; a report without bottom is a record too, and not valid."""
        stamp_us = self.validity_us
        if stamp_us is not None and (
            bad := bad_number("time_of_validity", stamp_us, 0, MAX_STAMP_S * 1e6)
        ):
            return bad
        if self.sent_us is not None and (
            bad := bad_number("time_of_transmission", self.sent_us, 0, MAX_STAMP_S * 1e6)
        ):
            return bad
        stamp_ns = (stamp_us or 0) * 1000
        clock: Clock = "arrival" if stamp_us is None else _clock(stamp_ns)
        sent_ns = None if stamp_us is None or self.sent_us is None else self.sent_us * 1000
        if not self.valid:
            return Odometry(stamp_ns, clock, source=SOURCE, valid=False, sent_ns=sent_ns)
        bad = (
            bad_numbers("velocity", self.velocity_mps, MAX_SPEED_MPS)
            or bad_numbers("covariance", self.covariance, MAX_COVARIANCE)
            or bad_number("fom", self.fom_mps, 0, MAX_COVARIANCE)
            or bad_number("altitude", self.altitude_m, -MAX_DISTANCE_M, MAX_DISTANCE_M)
        )
        if bad:
            return bad
        return Odometry(
            stamp_ns,
            clock,
            velocity_mps=turned(BODY_TO_FLU["frd"], self.velocity_mps),
            twist_covariance=self._covariance(),
            source=SOURCE,
            altitude_m=None if self.altitude_m < 0 else self.altitude_m,
            confidence=max(0.0, 1.0 - self.fom_mps / NO_CONFIDENCE_FOM_MPS),
            sent_ns=sent_ns,
        )

    def _covariance(self) -> Floats | None:
        """(6, 6); from the figure of merit where the matrix is none."""
        matrix = np.array(self.covariance, dtype=np.float64)
        if matrix.size == 9 and np.diag(matrix.reshape(3, 3)).min() > 0:  # noqa: PLR2004 3 x 3
            matrix = matrix.reshape(3, 3)
        else:
            matrix = self.fom_mps**2 * np.eye(3)
        return turned_covariance(BODY_TO_FLU["frd"], linear_covariance(matrix))


@dataclass(frozen=True, slots=True)
class Position:
    """One dead reckoning report, as it stood on the wire.

    Attributes:
        stamp_s: time of the report.
        position_m: x, y, z from where it was reset.
        std_m: of the position.
        rpy_deg: roll, pitch, yaw; yaw from where it was reset.
        status: 0 when nothing is wrong.
    """

    stamp_s: float
    position_m: Sequence[float]
    std_m: float
    rpy_deg: Sequence[float]
    status: int

    def odometry(self) -> Odometry | Reject:
        """In our frames; a report of a DVL in trouble is a record too, and not valid."""
        bad = bad_number("ts", self.stamp_s, 0, MAX_STAMP_S)
        if bad:
            return bad
        stamp_ns = round(self.stamp_s * 1e9)
        clock = _clock(stamp_ns)
        if self.status != 0:
            return Odometry(stamp_ns, clock, source=SOURCE, valid=False, north_referenced=False)
        bad = (
            bad_numbers("position", self.position_m, MAX_DISTANCE_M)
            or bad_number("std", self.std_m, 0, MAX_DISTANCE_M)
            or bad_numbers("angles", self.rpy_deg, 360)
        )
        if bad:
            return bad
        variance = min(self.std_m**2, UNKNOWN_VARIANCE)
        roll, pitch, yaw = self.rpy_deg
        return Odometry(
            stamp_ns,
            clock,
            position_m=turned(WORLD_TO_ENU["local_frd"], self.position_m),
            map_q_base=orientation(rotation_from_rpy(roll, pitch, yaw), "local_frd", "frd"),
            pose_covariance=np.diag([variance] * 3 + [UNKNOWN_VARIANCE] * 3),
            source=SOURCE,
            north_referenced=False,
        )


def _clock(stamp_ns: int) -> Clock:
    return "unix" if stamp_ns >= _UNIX_FROM_NS else "boot"
