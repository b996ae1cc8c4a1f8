"""Ping ids and device time that go on where a recording begins again."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

from oculus_driver.wire import MessageId, ping_layout

if TYPE_CHECKING:
    from oculus_driver.stream import Message

_U32: Final = struct.Struct("<I")
_F64: Final = struct.Struct("<d")
_WRAP: Final = 1 << 32

_FIRST_ID: Final = 1
_STEP_S: Final = 0.1
_STEP_TICKS: Final = 12_500_000
"""A tenth of a second, at 8 ns a tick."""


class Numbering:
    """Shifts ids and times by what `join` and `restart` ask for; by nothing in a first pass."""

    def __init__(self) -> None:
        self._anchor: str | None = None  # what the next ping shall do: join or restart
        self._id_shift = 0
        self._time_shift = 0.0
        self._boots = 0
        self._last: tuple[int, float] | None = None  # id and time

    def join(self) -> None:
        """Let the next ping follow the last one, if there was one."""
        if self._last is not None and self._anchor is None:
            self._anchor = "join"

    def restart(self) -> None:
        """Let the next ping be the first after power-up."""
        self._anchor = "restart"

    def apply(self, message: Message) -> tuple[bytes, int | None]:
        """Return the message as it is sent, and its ping id where it is a ping."""
        layout = ping_layout(message.version)
        if message.message_id != MessageId.PING_RESULT or layout is None:
            return message.data, None
        fields = layout.unpack(message.data)
        ticks = "start_ticks" in fields
        name = "start_ticks" if ticks else "start_time_s"
        self._settle_shift(fields["ping_id"], fields[name], _STEP_TICKS if ticks else _STEP_S)
        ping_id = (fields["ping_id"] + self._id_shift) % _WRAP
        time = fields[name] + self._time_shift
        self._last = ping_id, time
        if not self._id_shift and not self._time_shift:
            return message.data, ping_id
        data = bytearray(message.data)
        _U32.pack_into(data, layout.offset_of("ping_id"), ping_id)
        if ticks:
            _U32.pack_into(data, layout.offset_of(name), int(time) % _WRAP)
        else:
            _F64.pack_into(data, layout.offset_of(name), time)
        return bytes(data), ping_id

    def _settle_shift(self, ping_id: int, time: float, step: float) -> None:
        if self._anchor == "join" and self._last is not None:
            self._id_shift = self._last[0] + 1 - ping_id
            self._time_shift = self._last[1] + step - time
        elif self._anchor == "restart":
            # No two boots take the same time: their first pings are not one ping twice.
            self._boots += 1
            self._id_shift = _FIRST_ID - ping_id
            self._time_shift = step * (1 + self._boots / 1024) - time
        self._anchor = None
