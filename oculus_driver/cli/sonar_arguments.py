"""Which sonar, and what it shall do: arguments that several subcommands share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from oculus_driver.cli.arguments import address, count, port
from oculus_driver.cli.discover import add_status_arguments
from oculus_driver.settings import FireSettings, Mode, PingRate
from oculus_driver.wire import TCP_PORT

if TYPE_CHECKING:
    import argparse

RATES: Final = {rate.name.lower(): rate for rate in PingRate}
_RATE_HELP: Final = "highest 40, high 15, normal 10, low 5, lowest 2 Hz at most, or standby"


def add_sonar_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare which sonar is meant."""
    add = parser.add_argument
    add("host", metavar="ADDRESS", nargs="?", type=address, help="(default: by its status)")
    add("--serial", metavar="ID", type=count, help="serial number, to choose among several")
    add("--port", type=port, default=TCP_PORT, help="TCP port (default: %(default)s)")
    add("--version", type=int, choices=(1, 2), help="of fire messages (default: 2, else 1)")
    add_status_arguments(parser)


def add_settings_arguments(parser: argparse.ArgumentParser, *, rate: str = "normal") -> None:
    """Declare what a fire message can say; values are checked by `FireSettings`."""
    group = parser.add_argument_group("settings of the sonar")
    add = group.add_argument
    add("--mode", type=int, choices=[int(mode) for mode in Mode], default=1)
    add("--rate", choices=RATES, default=rate, help=f"{_RATE_HELP} (default: {rate})")
    reach = group.add_mutually_exclusive_group()
    reach.add_argument("--range", metavar="M", type=float, dest="range_m", default=10.0)
    reach.add_argument("--range-percent", metavar="P", type=float, help="of the mode's farthest")
    add("--gain", metavar="P", type=float, dest="gain_percent", default=50.0)
    add("--gamma", type=int, default=255, help="0 to 255 (default: linear)")
    add("--speed-of-sound", metavar="MPS", type=float, help="(default: by the sonar)")
    add("--salinity", metavar="PPT", type=float, default=35.0)
    add("--beams", type=int, choices=(256, 512), default=512)
    add("--bits", type=int, choices=(8, 16, 32), default=8)
    add("--no-gain-words", action="store_true")
    add("--gain-assist", action="store_true")
    add("--network-limit", metavar="MBPS", type=int, help="(default: none)")


def settings_of(said: argparse.Namespace, *, triggered: bool = False) -> FireSettings:
    """Return the settings that were said.

    Raises:
        SettingsError: a value outside its limits.
    """
    return FireSettings(
        mode=Mode(said.mode),
        ping_rate=RATES[said.rate],
        range_m=None if said.range_percent is not None else said.range_m,
        range_percent=said.range_percent,
        gain_percent=said.gain_percent,
        gamma=said.gamma,
        speed_of_sound_mps=said.speed_of_sound,
        salinity_ppt=said.salinity,
        beams=said.beams,
        bits_per_sample=said.bits,
        gain_words=not said.no_gain_words,
        gain_assist=said.gain_assist,
        network_trigger=triggered,
        network_limit_mbps=said.network_limit,
    )
