"""Send the status of a played sonar again and again."""

from __future__ import annotations

import asyncio
from ipaddress import IPv4Address
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from oculus_driver.virtual_sonar.counters import PlayCounters
    from oculus_driver.virtual_sonar.faults import Dice


def broadcast_of(host: str) -> str:
    """Return where a sonar at this address broadcasts to: loopback stays on loopback."""
    return "127.255.255.255" if IPv4Address(host).is_loopback else "255.255.255.255"


class _Sender(asyncio.DatagramProtocol):
    """Counts what the network refuses; asyncio reports it after the call."""

    def __init__(self, counters: PlayCounters) -> None:
        self._counters = counters

    def error_received(self, _: Exception) -> None:
        self._counters.statuses_unsent += 1


async def broadcast(
    status: Callable[[], bytes],
    host: str,
    targets: Sequence[tuple[str, int]],
    period_s: float,
    *,
    dice: Dice,
    counters: PlayCounters,
) -> None:
    """Send statuses until cancelled, some of them late and the next one twice if the dice say so.

    Args:
        status: makes the datagram of this moment.
        host: address to send from.
        targets: addresses and ports.
        period_s: between statuses.
        dice: decide which statuses wait for the one after them.
        counters: get `statuses` and `statuses_unsent`.
    """
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _Sender(counters), local_addr=(host, 0), allow_broadcast=True
    )
    held: bytes | None = None
    try:
        while True:
            now = status()
            if held is None and dice.holds_status():
                held = now
            else:
                datagrams = (now,) if held is None else (now, held, now)
                held = None
                for target in targets:
                    for datagram in datagrams:
                        transport.sendto(datagram, target)
                        counters.statuses += 1
            await asyncio.sleep(period_s)
    finally:
        transport.close()
