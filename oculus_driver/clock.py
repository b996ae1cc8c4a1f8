"""When a ping left the sonar and when its sound met what each row shows, on the host's clock.

A ping arrives late: by the way of its sound, and by what sonar, network and host take. The first
is known. The second differs from ping to ping and only ever adds, so the sonar's own clock,
carried over by `oculus_driver.clock_fit`, tells the time of a ping better than its arrival does.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from oculus_driver.clock_fit import ClockFit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oculus_driver.ping import Ping

_WRAP: Final = 1 << 32
_MAX_START_S: Final = 1e9
"""Thirty years without a power cycle: no start time but left-over memory."""

_PERIODS: Final = 15
"""Ping periods of which the median counts: outlives single hiccups, follows new settings."""

_MAX_LOST: Final = 1000
"""Over a longer gap the period of the pings is not known to have been one and the same."""


@dataclass(frozen=True, slots=True)
class PingTime:
    """When a ping was, on the clock of its arrival.

    Attributes:
        ping_id: of the ping.
        transmit_ns: when it left the sonar.
        end_ns: when the echo of its last row came back. The image is of the time in between.
        lateness_ns: by how much it arrived later than the promptest pings do; 0 by "arrival".
        method: "device", from the sonar's clock, or "arrival", from that of this ping alone.
    """

    ping_id: int
    transmit_ns: int
    end_ns: int
    lateness_ns: int
    method: Literal["device", "arrival"]


class SonarClock:
    """Carries the times of one sonar's pings over to the host's clock. Pure: it asks no clock.

    Version-2 pings say when they started. Version-1 pings carry ticks of undocumented length
    (8 ns in the known captures): they are used only where `tick_ns` is given. Where the sonar's
    time is missing, jumps, or does not run like a clock, a ping's own arrival is used.

    Attributes:
        placed: pings by method.
        restarts: times that the sonar began anew, as after power-up.

    Args:
        latency_ns: the least time that sonar, network and host need between the last echo and the
            first byte; nothing in the stream tells it. 0: pings are placed that much late.
        tick_ns: length of a version-1 tick, None where not known.
    """

    def __init__(self, *, latency_ns: int = 0, tick_ns: float | None = None) -> None:
        self.placed: Counter[str] = Counter()
        self.restarts = 0
        self._latency_ns = latency_ns
        self._ticks = None if tick_ns is None else _Ticks(tick_ns)
        self._envelope = ClockFit()
        self._periods_ns: deque[float] = deque(maxlen=_PERIODS)
        self._last: tuple[int, int | None, int] | None = None  # id, device time, arrival

    @property
    def drift(self) -> float:
        """Seconds that the host's clock gains per second on the sonar's; 0 until it is known."""
        return self._envelope.drift

    @property
    def period_s(self) -> float | None:
        """Time between pings, lost ones counted, the median of the last few; None before two."""
        return median(self._periods_ns) * 1e-9 if self._periods_ns else None

    def place(self, ping: Ping) -> PingTime | None:
        """Return when the ping was; None where its arrival is not known.

        Args:
            ping: of one sonar, in order of arrival.
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
        """Return when the ping started on the sonar's own clock, None where it does not say."""
        if ping.start_time_s is not None:
            # No sonar pings at power-up: 0 is a field that was never filled.
            return round(ping.start_time_s * 1e9) if 0 < ping.start_time_s < _MAX_START_S else None
        if ping.start_ticks is None or self._ticks is None:
            return None
        if self._last is not None and _stepped_back(self._last[0], ping.ping_id):
            self._ticks.restart()
        return self._ticks.unwrapped_ns(ping.start_ticks, arrival_ns)

    def _learn(self, ping: Ping, device_ns: int | None, arrival_ns: int) -> None:
        """Learn restart and period from this ping and the one before."""
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
        self._envelope.restart()
        self._periods_ns.clear()

    def _prompt_arrival_ns(
        self, device_ns: int | None, flight_ns: int, arrival_ns: int
    ) -> int | None:
        """Return when the ping would have arrived without any delay, by the sonar's clock.

        The end of the echoes is fitted, not the start: a change of range is no change of delay.
        """
        if device_ns is None:
            return None
        prompt_ns = self._envelope.to_host_ns(device_ns + flight_ns, arrival_ns)
        return prompt_ns if self._envelope.is_valid else None


def row_times_ns(ping: Ping, transmit_ns: int) -> NDArray[np.int64]:
    """Return when sound met what each row shows: the poses that the echoes belong to.

    The middle of the row, one way; the echo is back at the sonar as much later again.

    Args:
        ping: for its rows and the speed of sound.
        transmit_ns: when it left the sonar, see `PingTime`.

    Returns:
        int64 (rows,), on the clock of `transmit_ns`, rising.
    """
    one_way_ns = (np.arange(ping.rows) + 0.5) * (ping.flight_ns(ping.max_range_m) / ping.rows)
    times: NDArray[np.int64] = transmit_ns + np.rint(one_way_ns).astype(np.int64)
    return times


def _stepped_back(last_id: int, ping_id: int) -> bool:
    return (ping_id - last_id) % _WRAP >= _WRAP // 2


class _Ticks:
    """A counter of 32 bit made to run on: how often it wrapped is told by the arrivals."""

    def __init__(self, tick_ns: float) -> None:
        self._tick_ns = tick_ns
        self._total = 0
        self._last: tuple[int, int] | None = None  # ticks, arrival

    def restart(self) -> None:
        self._total, self._last = 0, None

    def unwrapped_ns(self, ticks: int, arrival_ns: int) -> int:
        if self._last is None:
            self._total = ticks
        else:
            step = (ticks - self._last[0]) % _WRAP
            elapsed = (arrival_ns - self._last[1]) / self._tick_ns
            self._total += step + _WRAP * max(0, round((elapsed - step) / _WRAP))
        self._last = ticks, arrival_ns
        return round(self._total * self._tick_ns)
