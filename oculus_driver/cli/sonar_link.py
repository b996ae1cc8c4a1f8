"""Open the sonar that was meant."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oculus_driver.discovery.listener import Discovery
from oculus_driver.sonar import OculusSonar

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from oculus_driver.link.sonar_counters import SonarCounters
    from oculus_driver.link.state import LinkStatus
    from oculus_driver.settings import FireSettings


def sonar_of(
    said: argparse.Namespace,
    settings: FireSettings,
    *,
    keep_pinging: bool = False,
    on_bytes: Callable[[bytes, int], None] | None = None,
    on_state: Callable[[LinkStatus], None] | None = None,
) -> OculusSonar:
    """Return the sonar, for `async with`."""
    return OculusSonar(
        said.host,
        settings,
        serial=said.serial,
        port=said.port,
        version=said.version,
        keep_pinging=keep_pinging,
        on_bytes=on_bytes,
        on_state=on_state,
        discovery=lambda: Discovery(said.status_port, said.listen),
    )


def line_of(sonar: OculusSonar) -> str:
    """Return state and counts in one line."""
    counters, link = sonar.counters, sonar.link
    words = [
        f"{link.address or 'no sonar'}: {link.state} ({link.reason})",
        f"{counters.pings} pings",
        f"{counters.bytes_received / 1e6:.1f} MB",
    ]
    if counters.lost_pings:
        words.append(f"{counters.lost_pings} lost")
    if counters.dropped:
        words.append(f"{counters.dropped} dropped")
    if counters.bytes_rejected:
        words.append(f"{counters.bytes_rejected} bytes rejected")
    return ", ".join(words)


def facts_of(counters: SonarCounters) -> dict[str, object]:
    """Return what was counted, as JSON knows it."""
    facts = {name: getattr(counters, name) for name in counters.__slots__}
    facts["messages"] = {str(number): count for number, count in counters.messages.items()}
    facts["rejects"] = dict(counters.rejects)
    return facts
