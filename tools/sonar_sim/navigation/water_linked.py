"""Odometry as a Water Linked DVL sends it: JSON and serial sentences.

Velocity is of the body in FRD. Dead reckoning begins where the first fix was: its frame lies level
there, x along the heading of that moment, z down. Times are mixed as the device mixes them: Unix
microseconds in velocity reports, Unix seconds in dead reckoning, milliseconds between reports.
"""

import json
import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sonar_sim.navigation.fix import Fix, RateLimiter, angles_rad

FORMAT = "json_v3.1"
RSSI_DBM, NSD_DBM = -35, -95
LEVELS = str(RSSI_DBM), str(NSD_DBM)
CRC8_POLYNOMIAL = 0x07
TOP_BIT = 0x80


@dataclass(frozen=True, slots=True, eq=False)
class VelocityReport:
    """A velocity report.

    Attributes:
        interval_ms: since the last one.
        valid: whether the bottom is seen; the rest means nothing if not.
        velocity_mps: FRD.
        fom_mps: figure of merit.
        altitude_m: -1 without bottom.
        beams_mps: velocity along each beam, away from the device.
        beams_m: distance along each beam.
        validity_us, transmission_us: Unix time.
    """

    interval_ms: float
    valid: bool
    velocity_mps: NDArray[np.float64]
    fom_mps: float
    altitude_m: float
    beams_mps: tuple[float, ...]
    beams_m: tuple[float, ...]
    validity_us: int
    transmission_us: int

    @property
    def covariance(self) -> list[list[float]]:
        """Covariance of the velocity, (m/s)², 3 x 3."""
        variance = self.fom_mps**2
        return [[variance if row == column else 0.0 for column in range(3)] for row in range(3)]


@dataclass(frozen=True, slots=True, eq=False)
class ReckonedPosition:
    """A dead-reckoning report; angles in degrees."""

    unix_s: float
    position_m: NDArray[np.float64]
    std_m: float
    roll_pitch_yaw_deg: tuple[float, float, float]


class JsonWords:
    """JSON lines."""

    def velocity(self, report: VelocityReport) -> list[bytes]:
        """A velocity report."""
        vx, vy, vz = (float(part) for part in report.velocity_mps)
        transducers = [
            {
                "id": number,
                "velocity": speed,
                "distance": distance,
                "rssi": RSSI_DBM,
                "nsd": NSD_DBM,
                "beam_valid": report.valid,
            }
            for number, (speed, distance) in enumerate(
                zip(report.beams_mps, report.beams_m, strict=True)
            )
        ]
        fields = {
            "time": report.interval_ms,
            "vx": vx,
            "vy": vy,
            "vz": vz,
            "fom": report.fom_mps,
            "covariance": report.covariance,
            "altitude": report.altitude_m,
            "transducers": transducers,
            "velocity_valid": report.valid,
            "status": 0,
            "format": FORMAT,
            "type": "velocity",
            "time_of_validity": report.validity_us,
            "time_of_transmission": report.transmission_us,
        }
        return [_line(fields)]

    def dead_reckoning(self, report: ReckonedPosition) -> bytes:
        """A dead-reckoning report."""
        x, y, z = (float(part) for part in report.position_m)
        roll, pitch, yaw = report.roll_pitch_yaw_deg
        return _line(
            {
                "ts": report.unix_s,
                "x": x,
                "y": y,
                "z": z,
                "std": report.std_m,
                "roll": roll,
                "pitch": pitch,
                "yaw": yaw,
                "type": "position_local",
                "status": 0,
                "format": FORMAT,
            }
        )


class SentenceWords:
    """Serial sentences."""

    def velocity(self, report: VelocityReport) -> list[bytes]:
        """A velocity report."""
        covariance = ";".join(f"{number:g}" for row in report.covariance for number in row)
        parts = [
            *(f"{float(part):.3f}" for part in report.velocity_mps),
            "y" if report.valid else "n",
            f"{report.altitude_m:.2f}",
            f"{report.fom_mps:.3f}",
            covariance,
            str(report.validity_us),
            str(report.transmission_us),
            f"{report.interval_ms:.2f}",
            "0",
        ]
        beams = enumerate(zip(report.beams_mps, report.beams_m, strict=True))
        return [
            *(
                sentence("wru", str(number), f"{speed:.3f}", f"{far:.2f}", *LEVELS)
                for number, (speed, far) in beams
            ),
            sentence("wrz", *parts),
        ]

    def dead_reckoning(self, report: ReckonedPosition) -> bytes:
        """A dead-reckoning report."""
        return sentence(
            "wrp",
            f"{report.unix_s:.3f}",
            *(f"{float(part):.2f}" for part in report.position_m),
            f"{report.std_m:.2f}",
            *(f"{angle:.1f}" for angle in report.roll_pitch_yaw_deg),
            "0",
        )


def sentence(word: str, *parts: str) -> bytes:
    """A sentence with its checksum in lower-case hexadecimals."""
    text = ",".join((word, *parts)).encode("ascii")
    return text + b"*%02x\r\n" % crc8(text)


def crc8(data: bytes) -> int:
    """CRC-8 with polynomial 0x07, start 0, nothing reflected, no final xor."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = ((crc << 1) ^ CRC8_POLYNOMIAL) & 0xFF if crc & TOP_BIT else crc << 1
    return crc


def _line(fields: dict[str, Any]) -> bytes:
    return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode("ascii") + b"\r\n"


DEAD_RECKONING_S = 0.2
MAX_ALTITUDE_M = 50.0
"""A DVL of this kind loses the bottom beyond."""

BEAM_TILT_RAD = math.radians(22.5)
BEAM_AZIMUTHS_RAD = tuple(math.radians(45.0 + 90.0 * beam) for beam in range(4))
"""Of the four beams: from down, and around it from ahead."""

UNKNOWN_FOM_MPS = 10.0


class _ReportFormat(Protocol):
    """How reports are written."""

    def velocity(self, report: VelocityReport) -> list[bytes]:
        """A velocity report."""

    def dead_reckoning(self, report: ReckonedPosition) -> bytes:
        """A dead-reckoning report."""


class _Dvl:
    """Makes reports of fixes."""

    def __init__(self, words: _ReportFormat) -> None:
        self._words = words
        self._dead_reckoning = RateLimiter(DEAD_RECKONING_S)
        self._last_s: float | None = None
        self._origin: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def encode(self, fix: Fix) -> list[bytes]:
        """Return a velocity report, and now and then one of dead reckoning."""
        sent = self._words.velocity(self._velocity(fix))
        if self._dead_reckoning.due(fix.boot_s):
            sent.append(self._words.dead_reckoning(self._reckoned(fix)))
        return sent

    def _velocity(self, fix: Fix) -> VelocityReport:
        interval_ms = 0.0 if self._last_s is None else 1e3 * (fix.boot_s - self._last_s)
        self._last_s = fix.boot_s
        validity_us, transmission_us = fix.valid_ns // 1000, fix.sent_ns // 1000
        if fix.altitude_m is None or fix.altitude_m > MAX_ALTITUDE_M:
            return VelocityReport(
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
        return VelocityReport(
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

    def _reckoned(self, fix: Fix) -> ReckonedPosition:
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
        return ReckonedPosition(
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
