"""One link kept open: opened, read, and opened again when it is lost."""

import asyncio
from collections.abc import Callable
from typing import NoReturn, Protocol, TypeVar

from mapperd.config.link_address import LinkAddress
from mapperd.odometry.ports import listen_to
from mapperd.odometry.state import LinkState, LinkStatus

__all__ = ["Link"]

SECOND_NS = 1_000_000_000
LOOK_S = 1.0
"""So often the state is looked at where nothing is due: it may have been opened meanwhile."""

T = TypeVar("T")


class TakeBytes(Protocol):
    """Gets bytes, their arrival, and whether bytes before them are missing."""

    def __call__(self, data: bytes, arrival_ns: int, /, *, gap: bool) -> None:
        """Take them."""


class Link:
    """Keeps a link open until it is cancelled.

    Args:
        name: of the source.
        address: where it is.
        take: gets what comes.
        clock: the host's, nanoseconds.
        on_status: is told when it does something else.
    """

    def __init__(
        self,
        name: str,
        address: LinkAddress,
        take: TakeBytes,
        clock: Callable[[], int],
        on_status: Callable[[str, LinkStatus], None] | None = None,
    ) -> None:
        self.name = name
        self.address = address
        self._take = take
        self._clock = clock
        self._on_status = on_status
        self._state = LinkState(str(address), connects=address.kind == "tcp")
        self._broken = False

    @property
    def status(self) -> LinkStatus:
        """What it does now."""
        return self._state.status

    async def run(self) -> NoReturn:
        """Open, read, open again.

        Raises:
            ConfigError: a library that it needs is not installed: trying again would not help.
        """
        try:
            while True:
                await self._once()
        finally:
            self._change(self._state.closed)

    async def _once(self) -> None:
        self._change(self._state.opening)
        reading = asyncio.ensure_future(listen_to(self.address, self._opened, self._received))
        try:
            reason = await self._watch(reading)
        except OSError as error:
            reason = f"{self.address}: {error.strerror or error}"
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
        self._broken = True
        retry_ns = self._change(lambda now_ns: self._state.lost(reason, now_ns))
        await asyncio.sleep((retry_ns - self._clock()) / SECOND_NS)

    async def _watch(self, reading: "asyncio.Future[NoReturn]") -> str:
        """Wait until it is lost, which is raised, or so silent that it must be dead: says so."""
        while not self._change(self._state.tick):
            due_ns = self._state.overdue_ns
            wait_s = LOOK_S if due_ns is None else max(due_ns - self._clock(), 0) / SECOND_NS
            await asyncio.wait({reading}, timeout=wait_s)
            if reading.done():
                await reading
        return self._state.status.reason

    def _opened(self) -> None:
        self._change(self._state.opened)

    def _received(self, data: bytes) -> None:
        # What was under way when the link broke will not be completed.
        gap, self._broken = self._broken, False
        self._change(lambda now_ns: self._state.received(len(data), now_ns))
        self._take(data, self._clock(), gap=gap)

    def _change(self, change: "Callable[[int], T]") -> "T":
        """Change the state, and say so where it became another."""
        before = self._state.status.phase
        result = change(self._clock())
        status = self._state.status
        if status.phase != before and self._on_status is not None:
            self._on_status(self.name, status)
        return result
