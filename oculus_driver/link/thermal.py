"""Overheating protection: out of the water a sonar heats up within minutes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from oculus_driver.status import MAIN_TEMPERATURE

if TYPE_CHECKING:
    from oculus_driver.ping import Ping, PingHeader
    from oculus_driver.status import Status

HYSTERESIS_C: Final = 3.0
"""A hot sonar may ping again this far below the limit."""


class ThermalGuard:
    """Decides whether the sonar is too hot to ping, by its own status and an optional limit.

    In standby there are no pings: only the status shows that the sonar has cooled down.

    Args:
        limit_c: maximum temperature while pinging, of the water (pings) or of the sonar (status).
            None: only the sonar's own limit.

    Attributes:
        reason: human-readable, None while the sonar may ping.
    """

    def __init__(self, limit_c: float | None) -> None:
        self.reason: str | None = None
        self._limit_c = limit_c

    def ping(self, ping: Ping | PingHeader) -> None:
        """Update with the temperature of a ping, if it has one."""
        self._reading(ping.temperature_c)

    def status(self, status: Status) -> None:
        """Update with a status."""
        if status.temperature_state == "shut down":
            self.reason = "the sonar is too hot and has stopped pinging: is it under water?"
        elif self._limit_c is None:
            self.reason = None
        else:
            self._reading(status.temperatures_c[MAIN_TEMPERATURE])

    def _reading(self, temperature_c: float | None) -> None:
        if temperature_c is None or self._limit_c is None:
            return
        if temperature_c >= self._limit_c:
            limit = f"the limit is {self._limit_c:g}"
            self.reason = f"{temperature_c:.1f} °C, {limit}: is the sonar under water?"
        elif temperature_c <= self._limit_c - HYSTERESIS_C:
            self.reason = None
