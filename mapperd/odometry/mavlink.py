"""MAVLink 1 and 2 from one vehicle: of all systems on the link, one is heard."""

from collections.abc import Iterator
from typing import Any

from mapperd.config.format_settings import FormatSettings
from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.mavlink_frames import MavlinkFrames
from mapperd.odometry.mavlink_messages import ORDER, READERS
from mapperd.odometry.mavlink_time import WRAP_MS, BootClock, stamp_of_us
from mapperd.odometry.precedence import Precedence
from mapperd.odometry.records import Clock, Odometry
from mapperd.reject import Reject

__all__ = ["MavlinkDecoder"]

RESETS = 256
"""The estimator's own counter has 8 bits; each reboot counts as a step above them."""


class MavlinkDecoder:
    """Reads one link, UDP or serial.

    Attributes:
        counters: what came in and what became of it.
    """

    def __init__(self, settings: FormatSettings, *, datagrams: bool = False) -> None:
        self.counters = DecoderCounters()
        self._settings = settings
        self._frames = MavlinkFrames(datagrams=datagrams)
        self._precedence = Precedence(ORDER)
        self._boot = BootClock()
        self._resets = 0

    def feed(self, data: bytes, arrival_ns: int | None) -> Iterator[Odometry | Reject]:
        """Take the next bytes."""
        self.counters.bytes_total += len(data)
        for message in self._frames.feed(data):
            result = message if isinstance(message, Reject) else self._read(message, arrival_ns)
            if result is not None:
                yield self.counters.out(result)
        self.counters.bytes_skipped = self._frames.skipped

    def restart(self) -> None:
        """Forget what is half received."""
        self._frames.restart()
        self.counters.bytes_skipped = self._frames.skipped

    def _read(self, message: Any, arrival_ns: int | None) -> Odometry | Reject | None:  # noqa: ANN401
        name = message.get_type()
        name = "unknown" if name.startswith("UNKNOWN") else name
        self.counters.heard(name, 0)
        if not self._is_ours(message):
            self.counters.ignore("other_system")
            return None
        reader = READERS.get(name)
        fields = None if reader is None else reader(message, self._settings)
        if fields is None:
            self.counters.ignore(name)
            return None
        if isinstance(fields, Reject):
            return fields
        odometry = self._stamped(name, message, fields)
        odometry_or_less = self._precedence.filtered(name, odometry, arrival_ns)
        if odometry_or_less is None:
            self.counters.ignore("superseded")
        return odometry_or_less

    def _is_ours(self, message: Any) -> bool:  # noqa: ANN401
        system, component = self._settings.mavlink_system_id, self._settings.mavlink_component_id
        return system in (0, message.get_srcSystem()) and component in (
            0,
            message.get_srcComponent(),
        )

    def _stamped(self, name: str, message: Any, fields: dict[str, Any]) -> Odometry:  # noqa: ANN401
        clock: Clock = "boot"
        if name == "ODOMETRY":
            stamp_ns, clock = stamp_of_us(message.time_usec)
            self._resets = message.reset_counter
            if clock == "boot":  # to notice a reboot
                self._boot.stamp_ns(message.time_usec // 1000 % WRAP_MS)
        else:
            stamp_ns = self._boot.stamp_ns(message.time_boot_ms)
        source = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        resets = self._boot.reboots * RESETS + self._resets
        return Odometry(stamp_ns, clock, reset_count=resets, source=source, **fields)
