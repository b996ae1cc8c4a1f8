"""A fake Water Linked DVL: TCP JSON reports and serial sentences."""

import json
from typing import Any


def crc8(data: bytes) -> int:
    """Compute it bit by bit, as the manual describes it: polynomial 0x07, start 0."""
    crc = 0
    for byte in data:
        for bit in range(7, -1, -1):
            carry = (crc >> 7) ^ ((byte >> bit) & 1)
            crc = ((crc << 1) & 0xFF) ^ (0x07 if carry else 0)
    return crc


def sentence(body: str) -> bytes:
    data = body.encode()
    return data + b"*%02x\r\n" % crc8(data)


class Dvl:
    """One DVL; every method returns the bytes of one report.

    Args:
        unix_us: its clock; set it to let time pass or jump.
        latency_us: between the echo and the report.
    """

    def __init__(self, unix_us: int = 1_700_000_000_000_000, latency_us: int = 147_000) -> None:
        self.unix_us = unix_us
        self.latency_us = latency_us

    def velocity(self, frd_mps: tuple[float, ...] = (0.1, 0.2, 0.3), **changes: Any) -> bytes:
        vx, vy, vz = frd_mps
        report: dict[str, Any] = {
            "time": 106.39,
            "vx": vx,
            "vy": vy,
            "vz": vz,
            "fom": 0.02,
            "covariance": [[1e-4, 1e-5, 2e-5], [1e-5, 2e-4, 3e-5], [2e-5, 3e-5, 3e-4]],
            "altitude": 2.5,
            "transducers": [
                {
                    "id": beam,
                    "velocity": 0.1,
                    "distance": 2.6,
                    "rssi": -30.0,
                    "nsd": -88.0,
                    "beam_valid": True,
                }
                for beam in range(4)
            ],
            "velocity_valid": True,
            "status": 0,
            "format": "json_v3.1",
            "type": "velocity",
            "time_of_validity": self.unix_us,
            "time_of_transmission": self.unix_us + self.latency_us,
        }
        return self._line(report | changes)

    def position(self, frd_m: tuple[float, ...] = (1.0, 2.0, 3.0), **changes: Any) -> bytes:
        x, y, z = frd_m
        report: dict[str, Any] = {
            "ts": self.unix_us / 1e6,
            "x": x,
            "y": y,
            "z": z,
            "std": 0.1,
            "roll": 0.0,
            "pitch": 0.0,
            "yaw": 0.0,
            "type": "position_local",
            "status": 0,
            "format": "json_v3.1",
        }
        return self._line(report | changes)

    def response(self, command: str = "reset_dead_reckoning") -> bytes:
        return self._line(
            {
                "response_to": command,
                "success": True,
                "error_message": "",
                "result": None,
                "format": "json_v3.1",
                "type": "response",
            }
        )

    def velocity_sentence(
        self, frd_mps: tuple[float, ...] = (0.1, 0.2, 0.3), *, valid: bool = True, status: int = 0
    ) -> bytes:
        numbers = ",".join(f"{number:.3f}" for number in frd_mps)
        covariance = "0.0001;1e-05;2e-05;1e-05;0.0002;3e-05;2e-05;3e-05;0.0003"
        letter = "y" if valid else "n"
        times = f"{self.unix_us},{self.unix_us + self.latency_us},106.39"
        return sentence(f"wrz,{numbers},{letter},2.50,0.020,{covariance},{times},{status}")

    def position_sentence(
        self,
        frd_m: tuple[float, ...] = (1.0, 2.0, 3.0),
        rpy_deg: tuple[float, ...] = (0, 0, 0),
        status: int = 0,
    ) -> bytes:
        place = ",".join(f"{number:.2f}" for number in frd_m)
        angles = ",".join(f"{number:.1f}" for number in rpy_deg)
        return sentence(f"wrp,{self.unix_us / 1e6:.3f},{place},0.100,{angles},{status}")

    @staticmethod
    def _line(report: dict[str, Any]) -> bytes:
        return json.dumps(report).encode() + b"\r\n"
