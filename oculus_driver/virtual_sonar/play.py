"""A recording served as a sonar: status broadcasts on UDP, pings on TCP, fire messages obeyed."""

from __future__ import annotations

from ipaddress import IPv4Address
from typing import TYPE_CHECKING

from oculus_driver.virtual_sonar.broadcast import broadcast_of
from oculus_driver.virtual_sonar.counters import PlayCounters
from oculus_driver.virtual_sonar.device import LOCAL, Identity
from oculus_driver.virtual_sonar.faults import Faults
from oculus_driver.virtual_sonar.playback import PlayedDevice
from oculus_driver.virtual_sonar.server import ANY, ServedSonar
from oculus_driver.virtual_sonar.track import Track

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Sequence

__all__ = ["Faults", "Identity", "PlayCounters", "PlayedSonar", "broadcast_of"]


class PlayedSonar(ServedSonar[PlayedDevice]):
    """A recording as a sonar on this computer; `async with`.

    Args:
        source: path of a recording of any kind, or whole messages.
        speed: of the recorded time; None sends as fast as the client takes it.
        loops: how often the source is played, None for ever; then only signs of life follow.
        identity: who the sonar says it is; its address None means `host`.
        remade, standby: see `oculus_driver.virtual_sonar.playback.PlayedDevice`.
        host, port, status_to, status_period_s, dummy_period_s, faults, on_ping: see
            `oculus_driver.virtual_sonar.server.ServedSonar`.

    Raises:
        RecordingError: the source is no recording.
        OculusError: the address cannot be listened on; raised on entering.
    """

    def __init__(
        self,
        source: str | os.PathLike[str] | Sequence[bytes],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        speed: float | None = 1.0,
        loops: int | None = 1,
        status_to: Sequence[tuple[str, int]] = (),
        status_period_s: float = 1.0,
        dummy_period_s: float = 1.0,
        identity: Identity | None = None,
        remade: bool = False,
        standby: bool = False,
        faults: Faults | None = None,
        on_ping: Callable[[int, bool], None] | None = None,
    ) -> None:
        device = PlayedDevice(
            Track(source),
            identity or Identity(address=told_address(host)),
            remade=remade,
            standby=standby,
            loops=loops,
            deaf_to_version=None if faults is None else faults.deaf_to_version,
        )
        super().__init__(
            device,
            host=host,
            port=port,
            speed=speed,
            status_to=status_to,
            status_period_s=status_period_s,
            dummy_period_s=dummy_period_s,
            faults=faults,
            on_ping=on_ping,
        )


def told_address(host: str) -> IPv4Address:
    """Return the address that statuses tell of a sonar that listens at `host`."""
    address = IPv4Address(host)
    return LOCAL if address == ANY else address
