"""How a Water Linked DVL writes its reports: JSON lines and serial sentences."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FORMAT = "json_v3.1"
RSSI_DBM, NSD_DBM = -35, -95
LEVELS = str(RSSI_DBM), str(NSD_DBM)
CRC8_POLYNOMIAL = 0x07
TOP_BIT = 0x80


@dataclass(frozen=True, slots=True, eq=False)
class Velocity:
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
        """Of the velocity, (m/s)², 3 x 3."""
        variance = self.fom_mps**2
        return [[variance if row == column else 0.0 for column in range(3)] for row in range(3)]


@dataclass(frozen=True, slots=True, eq=False)
class DeadReckoning:
    """A dead-reckoning report; angles in degrees."""

    unix_s: float
    position_m: NDArray[np.float64]
    std_m: float
    roll_pitch_yaw_deg: tuple[float, float, float]


class JsonWords:
    """JSON lines."""

    def velocity(self, report: Velocity) -> list[bytes]:
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

    def dead_reckoning(self, report: DeadReckoning) -> bytes:
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

    def velocity(self, report: Velocity) -> list[bytes]:
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

    def dead_reckoning(self, report: DeadReckoning) -> bytes:
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
