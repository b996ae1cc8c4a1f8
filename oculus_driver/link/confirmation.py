"""Comparison of pings with the requested settings: the only acknowledgement of a fire message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from oculus_driver.wire import FireFlags

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oculus_driver.ping import Ping, PingHeader
    from oculus_driver.settings import FireSettings

CONFIRM_TIMEOUT_NS: Final = 20_000_000_000
"""Speed of sound and salinity may take more than 6 s to take effect; the rest is faster, unless the
sonar is simulated on a busy computer."""

_DECISIVE_FLAGS: Final = {
    "range unit": FireFlags.RANGE_IN_METRES,
    "16-bit flag": FireFlags.SIXTEEN_BIT,
    "512-beam flag": FireFlags.FULL_BEAMS,
}
_RANGE_TOLERANCE_M: Final = 1e-3
_GAIN_TOLERANCE: Final = 0.1
_SPEED_TOLERANCE_MPS: Final = 0.5
_SALINITY_TOLERANCE_PPT: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference between a ping and the request.

    Attributes:
        name: of the setting.
        asked: requested value.
        shown: value in the ping.
        decisive: whether the settings are not in force while this differs. Other differences may
            settle slowly or be the sonar's own choice; those of changed settings are waited for.
    """

    name: str
    asked: float
    shown: float
    decisive: bool

    def __str__(self) -> str:
        return f"{self.name}: requested {self.asked:g}, got {self.shown:g}"


@dataclass(frozen=True, slots=True)
class Confirmation:
    """Result of a settings request.

    Attributes:
        confirmed: whether a ping showed the settings in force, or the sonar is in standby. Only
            decisive differences count.
        reason: human-readable.
        waited_ns: time from the request to this result.
        pings: number of examined pings.
        changed: differences between the last of them and the request.
        unsettled: those of settings that the request changed, if the time was up before a ping
            showed them.
    """

    confirmed: bool
    reason: str
    waited_ns: int
    pings: int
    changed: tuple[Difference, ...]
    unsettled: tuple[Difference, ...] = ()


def differences(settings: FireSettings, ping: Ping | PingHeader) -> tuple[Difference, ...]:
    """Return the differences between a ping and the request, as far as the echo is reliable.

    Not compared: ping rate and network speed, whose echo is uninitialised memory, and the speed of
    sound if the sonar computes it. A range in percent has no echo in metres.
    """
    return tuple(
        Difference(name, asked, shown, decisive)
        for name, asked, shown, tolerance, decisive in _comparisons(settings, ping)
        if not abs(asked - shown) <= tolerance
    )


def _comparisons(
    settings: FireSettings, ping: Ping | PingHeader
) -> Iterator[tuple[str, float, float, float, bool]]:
    """Yield name, requested value, value in the ping, tolerance, and whether it is decisive."""
    yield "mode", settings.mode, ping.mode, 0.0, True
    yield "gamma", settings.gamma, ping.gamma, 0.0, True
    for name, flag in _DECISIVE_FLAGS.items():
        yield name, bool(settings.flags & flag), bool(ping.flags & flag), 0.0, True
    if settings.range_m is not None and ping.range_setting_m is not None:
        yield "range, m", settings.range_m, ping.range_setting_m, _RANGE_TOLERANCE_M, True
    yield "beams", settings.beams, ping.beams, 0.0, False
    yield "bits per sample", settings.bits_per_sample, ping.bits_per_sample, 0.0, False
    yield "gain words", settings.gain_words, ping.has_gains, 0.0, False
    yield "gain, percent", _gain_percent(settings, ping), ping.gain_percent, _GAIN_TOLERANCE, False
    yield "salinity, ppt", settings.salinity_ppt, ping.salinity_ppt, _SALINITY_TOLERANCE_PPT, False
    if settings.speed_of_sound_mps is not None:
        asked, shown = settings.speed_of_sound_mps, ping.speed_of_sound_mps
        yield "speed of sound, m/s", asked, shown, _SPEED_TOLERANCE_MPS, False


def _gain_percent(settings: FireSettings, ping: Ping | PingHeader) -> float:
    """Return the expected gain: older firmware maps it to 40 to 100 % in mode 2."""
    mapped = 40.0 + 0.6 * settings.gain_percent
    older = settings.mode == 2 and abs(ping.gain_percent - mapped) <= _GAIN_TOLERANCE  # noqa: PLR2004 - mode 2
    return mapped if older else settings.gain_percent


def _changed_names(
    before: FireSettings, after: FireSettings, ping: Ping | PingHeader
) -> frozenset[str]:
    """Return the names of what a ping shows and the request changed."""
    earlier = {name: asked for name, asked, *_ in _comparisons(before, ping)}
    return frozenset(
        name for name, asked, *_ in _comparisons(after, ping) if asked != earlier.get(name)
    )


class PendingConfirmation:
    """Compares pings until one shows the settings in force, or the time is up.

    A setting that the request changed is waited for even if it is not decisive.

    Args:
        settings: the requested settings, compared in the report.
        asked_ns: time of the request, host monotonic.
        sent: the settings that were sent, if they differ.
        timeout_ns: maximum wait. Standby is confirmed by a dummy message.
        before: the settings until now, if they are known.
    """

    def __init__(
        self,
        settings: FireSettings,
        asked_ns: int,
        sent: FireSettings | None = None,
        timeout_ns: int = CONFIRM_TIMEOUT_NS,
        before: FireSettings | None = None,
    ) -> None:
        self._settings = settings
        self._before = before
        self._sent = sent or settings
        self._asked_ns = asked_ns
        self._pings = 0
        self._is_decided = False
        self._unsettled: tuple[Difference, ...] = ()
        self._last: tuple[Difference, ...] = ()
        self.deadline_ns = asked_ns + timeout_ns

    def ping(self, ping: Ping | PingHeader, now_ns: int) -> Confirmation | None:
        """Add a ping; return the result if it is final."""
        self._pings += 1
        if self._sent.standby:
            return None
        self._last = differences(self._settings, ping)
        left = differences(self._sent, ping)
        if self._before is not None:
            awaited = _changed_names(self._before, self._sent, ping)
            self._unsettled = tuple(one for one in left if one.name in awaited)
        self._is_decided = not any(one.decisive for one in left)
        if self._unsettled or not self._is_decided:
            return None
        return self._answer("a ping shows the settings", now_ns, confirmed=True)

    def dummy(self, now_ns: int) -> Confirmation | None:
        """Add a dummy message, which a sonar in standby sends."""
        if not self._sent.standby:
            return None
        return self._answer("the sonar reports standby", now_ns, confirmed=True)

    def expire(self, now_ns: int) -> Confirmation:
        """Return the result at the timeout."""
        if self._pings == 0:
            return self._answer("no ping arrived", now_ns, confirmed=False)
        if self._sent.standby:
            return self._answer("pings arrived, but no sign of standby", now_ns, confirmed=False)
        if self._is_decided:
            shown = "; ".join(map(str, self._unsettled))
            return self._answer(f"the last ping still differs: {shown}", now_ns, confirmed=True)
        shown = "; ".join(str(one) for one in self._last if one.decisive)
        return self._answer(f"the pings differ: {shown}", now_ns, confirmed=False)

    def _answer(self, reason: str, now_ns: int, *, confirmed: bool) -> Confirmation:
        waited_ns = now_ns - self._asked_ns
        return Confirmation(confirmed, reason, waited_ns, self._pings, self._last, self._unsettled)
