"""The sonar that a recording pretends to be: what it was told, and what it sends next."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from oculus_driver.ping import Ping, decode_ping
from oculus_driver.stream import StreamParser
from oculus_driver.virtual_sonar.device import M750D_PART, Identity, ObedientDevice
from oculus_driver.virtual_sonar.numbering import Numbering
from oculus_driver.virtual_sonar.resample import remake
from oculus_driver.virtual_sonar.track import USUAL_WAIT_NS
from oculus_driver.wire import MessageId, PingRate

if TYPE_CHECKING:
    from collections.abc import Generator

    from oculus_driver.virtual_sonar.commands import FireDemand
    from oculus_driver.virtual_sonar.track import Step, Track

RATES_HZ: Final = {
    PingRate.NORMAL: 10.0,
    PingRate.HIGH: 15.0,
    PingRate.HIGHEST: 40.0,
    PingRate.LOW: 5.0,
    PingRate.LOWEST: 2.0,
}


class PlayedDevice(ObedientDevice):
    """Obeys fire messages and deals out what was recorded. No sockets, no clock.

    Until a fire message comes it pings as recorded, or is in standby: real sonars keep their last
    settings over power cycles. Of a fire message it obeys standby, ping rate (never faster than
    recorded) and network trigger; with `remade` also range, beams, samples, gain words, mode and
    version of the results, see `oculus_driver.virtual_sonar.resample`.

    Args:
        track: what is played.
        identity: of the sonar.
        remade: make pings anew as asked for, instead of sending them as recorded.
        standby: be silent until a fire message asks for pings.
        loops: how often the track is played, None for ever.
        deaf_to_version: version of fire messages that are not understood.
    """

    def __init__(
        self,
        track: Track,
        identity: Identity | None = None,
        *,
        remade: bool = False,
        standby: bool = False,
        loops: int | None = 1,
        deaf_to_version: int | None = None,
    ) -> None:
        identity = identity or Identity()
        self._track = track
        self._remade = remade
        self._standby = standby
        self._loops_left = loops
        self._numbering = Numbering()
        self._join_wait_ns = 0  # between the end of the track and its beginning
        self._steps: Generator[Step, None, None] | None = None
        self._upcoming: Step | None = None
        self._load()
        first = None if self._upcoming is None else self._upcoming.message
        device_id = identity.device_id or (first.source_id if first else 0) or 1
        known_part = first.part_number if first else 0
        part_number = identity.part_number or known_part or M750D_PART
        super().__init__(identity, device_id, part_number, deaf_to_version)

    @property
    def pinging(self) -> bool:
        """Whether it transmits by itself or on triggers."""
        if not self.able or self._upcoming is None:
            return False
        return not (self._standby if self.demand is None else self.demand.standby)

    @property
    def ended(self) -> bool:
        """Whether everything was played."""
        return self._upcoming is None

    @property
    def next_is_ping(self) -> bool:
        """Whether the next message is a ping."""
        step = self._upcoming
        return step is not None and step.message.message_id == MessageId.PING_RESULT

    async def prepare(self) -> None:
        """Do nothing: what was recorded is ready."""

    def wait_ns(self) -> int:
        """Return the time between the last message and the next one."""
        if self._upcoming is None or (self.triggered and self.next_is_ping):
            return 0
        recorded_ns = self._join_wait_ns or self._upcoming.wait_ns
        if self.demand is None or not self.next_is_ping:
            return recorded_ns
        rate_hz = RATES_HZ.get(PingRate(self.demand.ping_rate)) if self._rate_known() else None
        return max(recorded_ns, round(1e9 / rate_hz) if rate_hz else 0)

    def take(self) -> tuple[bytes, int | None]:
        """Return the next message and, of a ping, its id.

        Raises:
            LookupError: everything was played.
        """
        if self._upcoming is None:
            raise LookupError("everything was played")
        message = self._upcoming.message
        data, ping_id = self._numbering.apply(message)
        if ping_id is not None:
            self.triggers = max(0, self.triggers - 1)
            if self._remade and self.demand is not None:
                data = self._remake(data, self.demand)
        self._load()
        return data, ping_id

    def restart(self) -> None:
        """Begin ids and device time anew; settings stay."""
        self._numbering.restart()

    def close(self) -> None:
        """Close the recording."""
        if self._steps is not None:
            self._steps.close()

    def _rate_known(self) -> bool:
        return self.demand is not None and self.demand.ping_rate in RATES_HZ

    def _remake(self, data: bytes, demand: FireDemand) -> bytes:
        messages = StreamParser().feed(data)
        ping = decode_ping(messages[0]) if messages else None
        return remake(ping, demand, self._part_number) if isinstance(ping, Ping) else data

    def _load(self) -> None:
        """Fetch the next step; at the end of the track begin it again while loops are left."""
        last_wait_ns = USUAL_WAIT_NS if self._upcoming is None else self._upcoming.wait_ns
        self._join_wait_ns = 0
        self._upcoming = None if self._steps is None else next(self._steps, None)
        if self._upcoming is not None or self._loops_left == 0:
            return
        if self._loops_left is not None:
            self._loops_left -= 1
        if self._steps is not None:
            self._join_wait_ns = last_wait_ns or USUAL_WAIT_NS
        self._steps = iter(self._track)
        self._upcoming = next(self._steps, None)
        self._numbering.join()
