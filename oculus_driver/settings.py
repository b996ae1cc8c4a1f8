"""Settings of a sonar, validated before they are sent."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from oculus_driver.encode import encode_fire
from oculus_driver.errors import SettingsError
from oculus_driver.models import MAX_RATE_HZ, UNKNOWN
from oculus_driver.wire import EXTENDED_32_BIT, FireFlags, PingRate

if TYPE_CHECKING:
    from oculus_driver.models import Model

__all__ = ["FireSettings", "Mode", "PingRate"]

FULL_BEAMS: Final = 512
HALF_BEAMS: Final = 256
LINK_SPEED: Final = 255
"""Network-speed byte: no limit below the link's own speed, 100 Mbit/s and 1 Gbit/s alike."""

_RANGE_LIMITS_M: Final = (
    0.1,
    200.0,
)  # over all models; the limit of a sonar is known once its model is known
_SPEED_LIMITS_MPS: Final = (1300.0, 1700.0)
_SALINITY_LIMITS_PPT: Final = (0.0, 42.0)  # where practical salinity is defined
_BITS: Final = (8, 16, 32)
_BITS_32: Final = 32
_MIN_SOUND_MPS: Final = 1400.0
_MAX_ROWS: Final = 800
_HEADER_BYTES: Final = 4096
_MIN_LINK_MBPS: Final = 100


class Mode(IntEnum):
    """Master mode. Frequency and field of view depend on the model."""

    LOW_FREQUENCY = 1  # wide field of view, long range
    HIGH_FREQUENCY = 2  # narrow field of view, short range


@dataclass(frozen=True, slots=True, kw_only=True)
class FireSettings:
    """Content of a fire message.

    Attributes:
        mode: frequency and field of view.
        ping_rate: upper limit; see `oculus_driver.models.MAX_RATE_HZ`.
        range_m: range, 0.1 to 200 m; None if `range_percent` is set.
        range_percent: range as a fraction of the mode's maximum, greater than 0 to 100.
        gain_percent: 0 to 100. Has little effect while `gain_assist` is on.
        gamma: 0 to 255. The image is displayed with the exponent gamma/255; 0 and 255 mean linear.
        speed_of_sound_mps: 1300 to 1700; None: the sonar computes it from `salinity_ppt`.
        salinity_ppt: 0 (fresh water) to 42; the sea has 35.
        beams: 256 or 512.
        bits_per_sample: 8, 16, or 32. 32 selects "scientific" data without time-varying gain, which
            needs version 2 of the fire message.
        gain_words: send the gain of each row, so that levels are comparable.
        gain_assist: let the sonar select the gain. Sources disagree about the meaning of this bit
            (interpreted as 1 = on); according to one it has no effect in mode 2.
        network_trigger: ping only on a fire message. Some sonars corrupted their stream with it and
            had to be restarted.
        network_limit_mbps: 1 to 254 Mbit/s; None: link speed.

    Raises:
        SettingsError: a value is outside these limits; the message names the value and the limits.
    """

    mode: Mode = Mode.LOW_FREQUENCY
    ping_rate: PingRate = PingRate.NORMAL
    range_m: float | None = 10.0
    range_percent: float | None = None
    gain_percent: float = 50.0
    gamma: int = 255
    speed_of_sound_mps: float | None = None
    salinity_ppt: float = 35.0
    beams: int = FULL_BEAMS
    bits_per_sample: int = 8
    gain_words: bool = True
    gain_assist: bool = False
    network_trigger: bool = False
    network_limit_mbps: int | None = None

    def __post_init__(self) -> None:
        _check_choice("mode", self.mode, tuple(Mode))
        _check_choice("ping_rate", self.ping_rate, tuple(PingRate))
        _check_choice("beams", self.beams, (HALF_BEAMS, FULL_BEAMS))
        _check_choice("bits_per_sample", self.bits_per_sample, _BITS)
        if (self.range_m is None) == (self.range_percent is None):
            raise SettingsError("set either range_m or range_percent, and None for the other")
        if self.range_m is not None:
            _check_range("range_m", self.range_m, *_RANGE_LIMITS_M)
        if self.range_percent is not None:
            _check_range("range_percent", self.range_percent, 0.0, 100.0)
            if self.range_percent == 0.0:
                raise SettingsError("range_percent is 0: it must be more than 0 to 100")
        _check_range("gain_percent", self.gain_percent, 0.0, 100.0)
        _check_int("gamma", self.gamma, 0, 255)
        if self.speed_of_sound_mps is not None:
            _check_range("speed_of_sound_mps", self.speed_of_sound_mps, *_SPEED_LIMITS_MPS)
        _check_range("salinity_ppt", self.salinity_ppt, *_SALINITY_LIMITS_PPT)
        if self.network_limit_mbps is not None:
            _check_int("network_limit_mbps", self.network_limit_mbps, 1, LINK_SPEED - 1)

    @property
    def standby(self) -> bool:
        """Whether these settings put the sonar into standby."""
        return self.ping_rate == PingRate.STANDBY

    @property
    def needs_version_2(self) -> bool:
        """Whether these settings cannot be encoded as version 1."""
        return self.bits_per_sample == _BITS_32

    @property
    def flags(self) -> FireFlags:
        """The flags byte. `SIMPLE_RETURN` is always set: the other format is undocumented."""
        flags = FireFlags.SIMPLE_RETURN
        for bit, wanted in (
            (FireFlags.RANGE_IN_METRES, self.range_m is not None),
            (FireFlags.SIXTEEN_BIT, self.bits_per_sample > 8),  # noqa: PLR2004 - bits of a byte
            (FireFlags.SEND_GAIN, self.gain_words),
            (FireFlags.GAIN_ASSIST, self.gain_assist),
            (FireFlags.FULL_BEAMS, self.beams == FULL_BEAMS),
            (FireFlags.NETWORK_TRIGGER, self.network_trigger),
        ):
            if wanted:
                flags |= bit
        return flags

    @property
    def max_period_s(self) -> float:
        """Upper estimate of the time of one ping by rate, travel time and network, seconds.

        Infinite in standby. For the detection of silence, not a guarantee: it assumes cold fresh
        water, the largest number of rows seen, and a link of at most 100 Mbit/s.
        """
        if self.standby:
            return math.inf
        far_m = _RANGE_LIMITS_M[1] * (self.range_percent or 0.0) / 100.0
        two_way_s = 2.0 * (self.range_m or far_m) / _MIN_SOUND_MPS
        row_bytes = self.beams * self.bits_per_sample // 8 + 4
        speed_bps = 1e6 * (self.network_limit_mbps or _MIN_LINK_MBPS)
        transfer_s = 8.0 * (_HEADER_BYTES + _MAX_ROWS * row_bytes) / speed_bps
        return max(1.0 / MAX_RATE_HZ[self.ping_rate], two_way_s, transfer_s)

    def in_standby(self) -> FireSettings:
        """Return the same settings in standby: no pings, not even triggered ones."""
        return replace(self, ping_rate=PingRate.STANDBY, network_trigger=False)

    def check_model(self, model: Model) -> None:
        """Check the settings against the model's limits; an unknown model has none.

        Raises:
            SettingsError: the model does not have the mode, or the range is beyond the mode's.
        """
        limited = self.limited_to(model)
        if limited != self:
            raise SettingsError(
                f"a range of {self.range_m:g} m: {model.name} reaches {limited.range_m:g} m in "
                f"mode {int(self.mode)}"
            )

    def limited_to(self, model: Model) -> FireSettings:
        """Return the settings with the range limited to the model's maximum in this mode.

        The firmware's reaction to a longer range is undocumented, so it is never requested. For an
        unknown model the settings are returned unchanged.

        Raises:
            SettingsError: the model does not have the mode.
        """
        if model.family == UNKNOWN:
            return self
        farthest_m = model.family.max_range_m[self.mode - 1]
        if farthest_m is None:
            raise SettingsError(f"{model.name} has no mode {int(self.mode)}: use mode 1")
        if self.range_m is None or self.range_m <= farthest_m:
            return self
        return replace(self, range_m=farthest_m)

    def encode(self, version: int = 2) -> bytes:
        """Return the fire message, 89 bytes (version 2) or 53 bytes (version 1).

        Raises:
            SettingsError: version 1 cannot encode these settings, or the version does not exist.
        """
        if version not in (1, 2):
            raise SettingsError(f"there is no fire message of version {version}: use 1 or 2")
        if version == 1 and self.needs_version_2:
            raise SettingsError("32 bits per sample need version 2 of the fire message")
        limit = self.network_limit_mbps
        return encode_fire(
            version=version,
            mode=self.mode,
            ping_rate=self.ping_rate,
            network_speed_mbps=LINK_SPEED if limit is None else limit,
            gamma=self.gamma,
            flags=self.flags,
            range_demand=self.range_m or self.range_percent or 0.0,
            gain_percent=self.gain_percent,
            speed_of_sound_demand_mps=self.speed_of_sound_mps or 0.0,
            salinity_ppt=self.salinity_ppt,
            extended_flags=EXTENDED_32_BIT if self.needs_version_2 else 0,
        )


def _check_choice(name: str, value: int, allowed: tuple[int, ...]) -> None:
    if value not in allowed:
        names = ", ".join(str(int(choice)) for choice in allowed)
        raise SettingsError(f"{name} is {value}: it must be one of {names}")


def _check_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:  # also rejects NaN
        raise SettingsError(f"{name} is {value}: it must be from {low:g} to {high:g}")


def _check_int(name: str, value: int, low: int, high: int) -> None:
    if not isinstance(value, int):
        raise SettingsError(f"{name} is {value}: it must be a whole number")
    _check_range(name, value, low, high)
