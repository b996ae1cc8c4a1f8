"""A Water Linked DVL (A50, A125): JSON lines as over TCP, or its serial sentences.

Velocity is of the body in FRD. Dead reckoning begins where the first fix was: its frame lies level
there, x along the heading of that moment, z down. Times are mixed as the device mixes them: Unix
microseconds in velocity reports, Unix seconds in dead reckoning, milliseconds between reports.
"""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sonar_sim.navigation.fix import Fix, angles_rad
from sonar_sim.navigation.pace import Every
from sonar_sim.navigation.water_linked_words import (
    DeadReckoning,
    JsonWords,
    SentenceWords,
    Velocity,
)

DEAD_RECKONING_S = 0.2
FARTHEST_M = 50.0
"""A DVL of this kind loses the bottom beyond."""

BEAM_TILT_RAD = math.radians(22.5)
BEAM_AZIMUTHS_RAD = tuple(math.radians(45.0 + 90.0 * beam) for beam in range(4))
"""Of the four beams: from down, and around it from ahead."""

UNKNOWN_FOM_MPS = 10.0


class _Words(Protocol):
    """How reports are written."""

    def velocity(self, report: Velocity) -> list[bytes]:
        """A velocity report."""

    def dead_reckoning(self, report: DeadReckoning) -> bytes:
        """A dead-reckoning report."""


class _Dvl:
    """Makes reports of fixes."""

    def __init__(self, words: _Words) -> None:
        self._words = words
        self._dead_reckoning = Every(DEAD_RECKONING_S)
        self._last_s: float | None = None
        self._origin: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def encode(self, fix: Fix) -> list[bytes]:
        """Return a velocity report, and now and then one of dead reckoning."""
        sent = self._words.velocity(self._velocity(fix))
        if self._dead_reckoning.due(fix.boot_s):
            sent.append(self._words.dead_reckoning(self._reckoned(fix)))
        return sent

    def _velocity(self, fix: Fix) -> Velocity:
        interval_ms = 0.0 if self._last_s is None else 1e3 * (fix.boot_s - self._last_s)
        self._last_s = fix.boot_s
        validity_us, transmission_us = fix.valid_ns // 1000, fix.sent_ns // 1000
        if fix.altitude_m is None or fix.altitude_m > FARTHEST_M:
            return Velocity(
                interval_ms=interval_ms,
                valid=False,
                velocity_mps=np.zeros(3),
                fom_mps=UNKNOWN_FOM_MPS,
                altitude_m=-1.0,
                beams_mps=(0.0,) * len(BEAM_AZIMUTHS_RAD),
                beams_m=(-1.0,) * len(BEAM_AZIMUTHS_RAD),
                validity_us=validity_us,
                transmission_us=transmission_us,
            )
        velocity = fix.velocity_frd_mps
        slant_m = fix.altitude_m / math.cos(BEAM_TILT_RAD)
        return Velocity(
            interval_ms=interval_ms,
            valid=True,
            velocity_mps=velocity,
            fom_mps=fix.errors.velocity_noise_mps,
            altitude_m=fix.altitude_m,
            beams_mps=tuple(float(_beam(azimuth) @ velocity) for azimuth in BEAM_AZIMUTHS_RAD),
            beams_m=(slant_m,) * len(BEAM_AZIMUTHS_RAD),
            validity_us=validity_us,
            transmission_us=transmission_us,
        )

    def _reckoned(self, fix: Fix) -> DeadReckoning:
        if self._origin is None:
            yaw = fix.roll_pitch_yaw_rad[2]
            start_R_ned = np.array(  # noqa: N806 frames are named
                [
                    [math.cos(yaw), math.sin(yaw), 0.0],
                    [-math.sin(yaw), math.cos(yaw), 0.0],
                    [0.0, 0.0, 1.0],
                ]
            )
            self._origin = fix.position_ned_m, start_R_ned
        start_m, start_R_ned = self._origin  # noqa: N806 as above
        roll, pitch, yaw = angles_rad(start_R_ned @ fix.ned_R_frd)
        return DeadReckoning(
            fix.valid_ns / 1e9,
            start_R_ned @ (fix.position_ned_m - start_m),
            fix.errors.position_noise_m,
            (math.degrees(roll), math.degrees(pitch), math.degrees(yaw)),
        )


class WaterLinkedJson(_Dvl):
    """JSON lines that end in CR LF."""

    def __init__(self) -> None:
        super().__init__(JsonWords())


class WaterLinkedSerial(_Dvl):
    """Sentences with a CRC-8, protocol 2.6: wrz, wru, wrp."""

    def __init__(self) -> None:
        super().__init__(SentenceWords())


def _beam(azimuth_rad: float) -> NDArray[np.float64]:
    """Direction of a beam, FRD, (3,)."""
    across = math.sin(BEAM_TILT_RAD)
    return np.array(
        [
            across * math.cos(azimuth_rad),
            across * math.sin(azimuth_rad),
            math.cos(BEAM_TILT_RAD),
        ]
    )
