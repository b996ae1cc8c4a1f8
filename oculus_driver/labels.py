"""What is written beside a ping."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from oculus_driver.ping import Ping

_YEAR_2000_NS: Final = 946_684_800_000_000_000


def caption_of(ping: Ping) -> list[str]:
    """Return lines of ASCII: which ping, how it was made, and when, if its stamp is a date.

    Stamps of a live sonar count from the start of the host, which was less than thirty years ago.
    """
    what = [f"ping {ping.ping_id}", f"{ping.rows} rows x {ping.beams} beams"]
    what.append(f"{ping.bits_per_sample} bit")
    how = [f"range {ping.max_range_m:.2f} m", f"mode {ping.mode}"]
    if not math.isnan(ping.frequency_hz):
        how.append(f"{ping.frequency_hz / 1e6:.3f} MHz")
    if not math.isnan(ping.gain_percent):
        how.append(f"gain {ping.gain_percent:.0f} %")
    how.append(f"sound {ping.speed_of_sound_mps:.1f} m/s")
    lines = ["   ".join(what), "   ".join(how)]
    if ping.arrival_ns is not None and ping.arrival_ns >= _YEAR_2000_NS:
        lines.append(time_of(ping.arrival_ns))
    return lines


def time_of(unix_ns: int) -> str:
    """Return the time as text, UTC, to the millisecond; a plain number where no date has it."""
    try:
        moment = datetime.fromtimestamp(unix_ns // 1_000_000_000, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{unix_ns} ns"
    return f"{moment:%Y-%m-%d %H:%M:%S}.{unix_ns // 1_000_000 % 1000:03d} UTC"
