"""When a sonar is too hot to ping: out of the water it heats up within minutes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from oculus_driver.ping import Ping
    from oculus_driver.status import Status

HYSTERESIS_C: Final = 3.0
"""How far below the limit a sonar must be before it may ping again."""

_MAIN_TEMPERATURE: Final = 6
"""Which of the eight sensors of a status others take for "the" temperature."""


class ThermalGuard:
    """Says why the sonar has to be quiet, from its own word and an optional limit.

    A quiet sonar sends no pings: only its status can tell that it has cooled.

    Args:
        limit_c: highest temperature to ping at, of the water by the pings or of the sonar by
            its status, None for the sonar's own limit alone.

    Attributes:
        reason: in words for a person, None while the sonar may ping.
    """

    def __init__(self, limit_c: float | None) -> None:
        self.reason: str | None = None
        self._limit_c = limit_c

    def ping(self, ping: Ping) -> None:
        """Take the temperature that a ping shows, if it does."""
        self._reading(ping.temperature_c)

    def status(self, status: Status) -> None:
        """Take what a status says."""
        if status.temperature_state == "shut down":
            self.reason = "the sonar is too hot and has stopped pinging: is it under water?"
        elif self._limit_c is None:
            self.reason = None
        else:
            self._reading(status.temperatures_c[_MAIN_TEMPERATURE])

    def _reading(self, temperature_c: float | None) -> None:
        if temperature_c is None or self._limit_c is None:
            return
        if temperature_c >= self._limit_c:
            limit = f"the limit is {self._limit_c:g}"
            self.reason = f"{temperature_c:.1f} °C, {limit}: is the sonar under water?"
        elif temperature_c <= self._limit_c - HYSTERESIS_C:
            self.reason = None
