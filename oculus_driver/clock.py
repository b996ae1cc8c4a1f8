"""Transmit times of pings, and valid times of their rows, on the host's clock.

A ping arrives late by the travel time of its sound and by the latency of sonar, network and host.
The travel time is known. The latency differs from ping to ping and only ever adds. So the sonar's
own clock, converted to host time by `oculus_driver.clock_fit`, gives the time of a ping better
than its arrival does.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from oculus_driver.clock_fit import ClockFit, ClockFitState

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oculus_driver.ping import Ping

_WRAP: Final = 1 << 32
_MAX_START_S: Final = 1e9
"""Thirty years without a power cycle: a larger start time is uninitialised memory."""

_PERIODS: Final = 15
"""Number of ping periods in the median: robust to single delays, quick to follow new settings."""

_MAX_LOST: Final = 1000
"""Over a longer gap the ping period may have changed."""


@dataclass(frozen=True, slots=True)
class PingTime:
    """Times of a ping on the clock of its arrival.

    Attributes:
        ping_id: id of the ping.
        transmit_ns: transmit time.
        end_ns: arrival of the echo of its last row at the sonar. The image covers the time between.
        lateness_ns: delay in addition to that of the fastest pings; 0 for method "arrival".
        method: "device", from the sonar's clock, or "arrival", from the arrival of this ping alone.
    """

    ping_id: int
    transmit_ns: int
    end_ns: int
    lateness_ns: int
    method: Literal["device", "arrival"]


class SonarClockState(NamedTuple):
    """State of a `SonarClock`.

    Attributes:
        placed, restarts: the counts.
        ticks: total and (ticks, arrival) of the last ping; None if ticks are not used.
        fit: of the sonar's clock to the host's.
        periods_ns: the last ping periods.
        last: id, device time and arrival of the last ping.
    """

    placed: dict[str, int]
    restarts: int
    ticks: tuple[int, tuple[int, int] | None] | None
    fit: ClockFitState
    periods_ns: list[float]
    last: tuple[int, int | None, int] | None


class SonarClock:
    """Converts the times of one sonar's pings to the host's clock. Pure: it reads no clock.

    Version-2 pings contain their start time. Version-1 pings contain ticks of undocumented length
    (8 ns in the known captures), which are used only if `tick_ns` is given. If the sonar's time is
    missing, jumps, or does not advance like a clock, the ping's own arrival is used.

    Attributes:
        placed: pings by method.
        restarts: how often the sonar restarted, as after power-up.

    Args:
        latency_ns: minimum latency of sonar, network and host between the last echo and the first
            byte; it cannot be derived from the stream. With 0, times are late by that much.
        tick_ns: length of a version-1 tick, None if unknown.
    """

    def __init__(self, *, latency_ns: int = 0, tick_ns: float | None = None) -> None:
        self.placed: Counter[str] = Counter()
        self.restarts = 0
        self._latency_ns = latency_ns
        self._ticks = None if tick_ns is None else _Ticks(tick_ns)
        self._fit = ClockFit()
        self._periods_ns: deque[float] = deque(maxlen=_PERIODS)
        self._last: tuple[int, int | None, int] | None = None  # id, device time, arrival

    @property
    def drift(self) -> float:
        """Seconds that the host's clock gains per second on the sonar's; 0 until it is known."""
        return self._fit.drift

    @property
    def period_s(self) -> float | None:
        """Median time between the last pings, lost ones included; None before the second ping."""
        return median(self._periods_ns) * 1e-9 if self._periods_ns else None

    def state(self) -> SonarClockState:
        """Return everything that `restore` needs to continue exactly."""
        return SonarClockState(
            dict(self.placed),
            self.restarts,
            None if self._ticks is None else self._ticks.state(),
            self._fit.state(),
            list(self._periods_ns),
            self._last,
        )

    def restore(self, state: SonarClockState) -> None:
        """Continue as the clock of which `state` was taken; the arguments must be the same."""
        self.placed, self.restarts = Counter(state.placed), state.restarts
        if self._ticks is not None and state.ticks is not None:
            self._ticks.restore(*state.ticks)
        self._fit.restore(state.fit)
        self._periods_ns = deque(state.periods_ns, maxlen=_PERIODS)
        self._last = state.last

    def place(self, ping: Ping) -> PingTime | None:
        """Return the times of the ping; None if its arrival is unknown.

        Args:
            ping: a ping of one sonar, in order of arrival.
        """
        if ping.arrival_ns is None:
            return None
        device_ns = self._device_ns(ping, ping.arrival_ns)
        self._learn(ping, device_ns, ping.arrival_ns)
        flight_ns = ping.flight_ns(2.0 * ping.max_range_m)
        prompt_ns = self._prompt_arrival_ns(device_ns, flight_ns, ping.arrival_ns)
        method: Literal["device", "arrival"] = "arrival" if prompt_ns is None else "device"
        self.placed[method] += 1
        end_ns = (ping.arrival_ns if prompt_ns is None else prompt_ns) - self._latency_ns
        lateness_ns = 0 if prompt_ns is None else ping.arrival_ns - prompt_ns
        return PingTime(ping.ping_id, end_ns - flight_ns, end_ns, lateness_ns, method)

    def _device_ns(self, ping: Ping, arrival_ns: int) -> int | None:
        """Return the start of the ping on the sonar's own clock, None if it is not reported."""
        if ping.start_time_s is not None:
            # No sonar pings at power-up: 0 is a field that was never set.
            return round(ping.start_time_s * 1e9) if 0 < ping.start_time_s < _MAX_START_S else None
        if ping.start_ticks is None or self._ticks is None:
            return None
        if self._last is not None and _stepped_back(self._last[0], ping.ping_id):
            self._ticks.restart()
        return self._ticks.unwrapped_ns(ping.start_ticks, arrival_ns)

    def _learn(self, ping: Ping, device_ns: int | None, arrival_ns: int) -> None:
        """Detect restarts and update the period from this ping and the previous one."""
        before, self._last = self._last, (ping.ping_id, device_ns, arrival_ns)
        if before is None:
            return
        last_id, last_device_ns, last_arrival_ns = before
        if _stepped_back(last_id, ping.ping_id):
            if device_ns is None or last_device_ns is None or device_ns < last_device_ns:
                self._restart()
            return
        elapsed_ns = arrival_ns - last_arrival_ns
        if device_ns is not None and last_device_ns is not None:
            elapsed_ns = device_ns - last_device_ns
        pings = (ping.ping_id - last_id) % _WRAP
        if 0 < pings <= _MAX_LOST and elapsed_ns > 0:
            self._periods_ns.append(elapsed_ns / pings)

    def _restart(self) -> None:
        self.restarts += 1
        self._fit.restart()
        self._periods_ns.clear()

    def _prompt_arrival_ns(
        self, device_ns: int | None, flight_ns: int, arrival_ns: int
    ) -> int | None:
        """Return the arrival time without delay according to the sonar's clock.

        The end of the echoes is fitted, not the start: a change of range is not a change of delay.
        """
        if device_ns is None:
            return None
        prompt_ns = self._fit.to_host_ns(device_ns + flight_ns, arrival_ns)
        return prompt_ns if self._fit.is_valid else None


def row_times_ns(ping: Ping, transmit_ns: int) -> NDArray[np.int64]:
    """Return when the sound met the content of each row: the times of the poses to use.

    The time is one-way, to the middle of the row.

    Args:
        ping: gives the rows and the speed of sound.
        transmit_ns: transmit time, see `PingTime`.

    Returns:
        int64 (rows,), on the clock of `transmit_ns`, increasing.
    """
    one_way_ns = (np.arange(ping.rows) + 0.5) * (ping.flight_ns(ping.max_range_m) / ping.rows)
    times: NDArray[np.int64] = transmit_ns + np.rint(one_way_ns).astype(np.int64)
    return times


def _stepped_back(last_id: int, ping_id: int) -> bool:
    return (ping_id - last_id) % _WRAP >= _WRAP // 2


class _Ticks:
    """Unwraps a 32-bit counter; arrival times give the number of wraps."""

    def __init__(self, tick_ns: float) -> None:
        self._tick_ns = tick_ns
        self._total = 0
        self._last: tuple[int, int] | None = None  # ticks, arrival

    def restart(self) -> None:
        self._total, self._last = 0, None

    def state(self) -> tuple[int, tuple[int, int] | None]:
        return self._total, self._last

    def restore(self, total: int, last: tuple[int, int] | None) -> None:
        self._total, self._last = total, last

    def unwrapped_ns(self, ticks: int, arrival_ns: int) -> int:
        if self._last is None:
            self._total = ticks
        else:
            step = (ticks - self._last[0]) % _WRAP
            elapsed = (arrival_ns - self._last[1]) / self._tick_ns
            self._total += step + _WRAP * max(0, round((elapsed - step) / _WRAP))
        self._last = ticks, arrival_ns
        return round(self._total * self._tick_ns)
