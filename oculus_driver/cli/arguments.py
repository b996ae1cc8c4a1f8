"""Command-line arguments: value types, arguments shared by subcommands, and the selected sonar."""

from __future__ import annotations

import argparse
import math
from ipaddress import IPv4Address
from typing import TYPE_CHECKING, Final

from oculus_driver.discovery.listener import ANY_HOST, Discovery
from oculus_driver.settings import FireSettings, Mode, PingRate
from oculus_driver.wire import STATUS_PORT, TCP_PORT

if TYPE_CHECKING:
    from collections.abc import Callable

    from oculus_driver.link.state import LinkStatus, SonarCounters
    from oculus_driver.sonar import OculusSonar
    from oculus_driver.stream import MessageBounds


_LAST_PORT = 65_535


def positive(text: str) -> float:
    """Return a number greater than 0."""
    value = _number(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not greater than 0")
    return value


def non_negative(text: str) -> float:
    """Return a number of at least 0."""
    value = _number(text)
    if not value >= 0.0:
        raise argparse.ArgumentTypeError(f"{text} is less than 0")
    return value


def share(text: str) -> float:
    """Return a number from 0 to 1."""
    value = _number(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 1")
    return value


def count(text: str) -> int:
    """Return an integer greater than 0."""
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a positive integer")
    return int(text)


def non_negative_int(text: str) -> int:
    """Return an integer of at least 0."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text} is not a non-negative integer")
    return int(text)


def port(text: str) -> int:
    """Return a port; 0 stands for any free one."""
    if not text.isascii() or not text.isdigit() or int(text) > _LAST_PORT:
        raise argparse.ArgumentTypeError(f"{text} is not a port (0 to {_LAST_PORT})")
    return int(text)


def address(text: str) -> str:
    """Return an IPv4 address."""
    try:
        return str(IPv4Address(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} is not an IPv4 address") from error


def endpoint(text: str) -> tuple[str, int | None]:
    """Return an address and an optional port: `192.168.2.3` or `127.0.0.1:52100`."""
    host, colon, number = text.partition(":")
    return address(host), port(number) if colon else None


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} is not a number") from error
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


RATES: Final = {rate.name.lower(): rate for rate in PingRate}
_RATE_HELP: Final = (
    "maximum ping rate: highest 40, high 15, normal 10, low 5, lowest 2 Hz, or standby"
)


def add_status_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for receiving statuses."""
    add = parser.add_argument
    add(
        "--status-port",
        metavar="PORT",
        type=port,
        default=STATUS_PORT,
        help="UDP port of the status broadcasts (default: %(default)s)",
    )
    add(
        "--listen",
        metavar="ADDRESS",
        type=address,
        default=ANY_HOST,
        help="local address to listen on",
    )


def add_sonar_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that select the sonar."""
    add = parser.add_argument
    add(
        "host",
        metavar="ADDRESS",
        nargs="?",
        type=address,
        help="address of the sonar (default: discover it)",
    )
    add("--serial", metavar="ID", type=count, help="serial number of the sonar to use")
    add("--port", type=port, default=TCP_PORT, help="TCP port (default: %(default)s)")
    add(
        "--version",
        type=int,
        choices=(1, 2),
        help="version of the fire messages (default: 2 with fallback to 1)",
    )
    add_status_arguments(parser)


def add_settings_arguments(parser: argparse.ArgumentParser, *, rate: str = "normal") -> None:
    """Add the settings of a fire message; `FireSettings` checks the values."""
    group = parser.add_argument_group("settings of the sonar")
    add = group.add_argument
    add(
        "--mode",
        type=int,
        choices=[int(mode) for mode in Mode],
        default=1,
        help="frequency mode: 1 is wide and looks far, 2 is narrow and sharp",
    )
    add("--rate", choices=RATES, default=rate, help=f"{_RATE_HELP} (default: {rate})")
    reach = group.add_mutually_exclusive_group()
    reach.add_argument(
        "--range",
        metavar="M",
        type=float,
        dest="range_m",
        default=10.0,
        help="range of the pings in metres",
    )
    reach.add_argument(
        "--range-percent", metavar="P", type=float, help="range in percent of the mode's maximum"
    )
    add(
        "--gain", metavar="P", type=float, dest="gain_percent", default=50.0, help="gain in percent"
    )
    add("--gamma", type=int, default=255, help="display exponent, 0 to 255 (default: 255, linear)")
    add(
        "--speed-of-sound",
        metavar="MPS",
        type=float,
        help="speed of sound in m/s (default: computed by the sonar)",
    )
    add(
        "--salinity",
        metavar="PPT",
        type=float,
        default=35.0,
        help="salinity of the water: 0 fresh water, 35 sea",
    )
    add("--beams", type=int, choices=(256, 512), default=512)
    add("--bits", type=int, choices=(8, 16, 32), default=8)
    add("--no-gain-words", action="store_true", help="do not request the gain of each row")
    add("--gain-assist", action="store_true", help="let the sonar select the gain")
    add(
        "--network-limit",
        metavar="MBPS",
        type=int,
        help="limit of the data rate in Mbit/s (default: link speed)",
    )


def settings_of(args: argparse.Namespace, *, triggered: bool = False) -> FireSettings:
    """Return the settings in the arguments.

    Raises:
        SettingsError: a value is outside its limits.
    """
    return FireSettings(
        mode=Mode(args.mode),
        ping_rate=RATES[args.rate],
        range_m=None if args.range_percent is not None else args.range_m,
        range_percent=args.range_percent,
        gain_percent=args.gain_percent,
        gamma=args.gamma,
        speed_of_sound_mps=args.speed_of_sound,
        salinity_ppt=args.salinity,
        beams=args.beams,
        bits_per_sample=args.bits,
        gain_words=not args.no_gain_words,
        gain_assist=args.gain_assist,
        network_trigger=triggered,
        network_limit_mbps=args.network_limit,
    )


def open_sonar(
    args: argparse.Namespace,
    settings: FireSettings,
    *,
    keep_pinging: bool = False,
    on_chunk: Callable[[bytes, int, MessageBounds], object] | None = None,
    on_status: Callable[[bytes, int], object] | None = None,
    on_state: Callable[[LinkStatus], None] | None = None,
) -> OculusSonar:
    """Return the sonar selected by the arguments, for `async with`."""
    from oculus_driver.sonar import OculusSonar  # noqa: PLC0415 - imports the whole driver

    return OculusSonar(
        args.host,
        settings,
        serial=args.serial,
        port=args.port,
        version=args.version,
        keep_pinging=keep_pinging,
        on_chunk=on_chunk,
        on_status=on_status,
        on_state=on_state,
        discovery=lambda: Discovery(args.status_port, args.listen),
    )


def line_of(sonar: OculusSonar) -> str:
    """Return state and counters in one line."""
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


def counter_fields(counters: SonarCounters) -> dict[str, object]:
    """Return the counters for JSON."""
    fields = {name: getattr(counters, name) for name in counters.__slots__}
    fields["messages"] = {str(number): count for number, count in counters.messages.items()}
    fields["rejects"] = dict(counters.rejects)
    return fields
