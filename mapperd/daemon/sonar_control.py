"""Control of the sonar while it maps: its settings in force, changed, confirmed and reported."""

import asyncio
from typing import Any, NoReturn

from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from mapperd.events import EventLog, Severity
from oculus_driver.errors import OutsideLimitsError, SettingsError
from oculus_driver.link.confirmation import Confirmation
from oculus_driver.models import UNKNOWN
from oculus_driver.settings import FireSettings, Mode, PingRate
from oculus_driver.sonar import OculusSonar
from oculus_driver.sound_speed import speed_of_sound_mps

__all__ = ["SonarControl", "fire_settings"]

POLL_INTERVAL_S = 0.5
"""Interval of looks at the sonar's model, which arrives with its first message."""


def fire_settings(config: Config) -> FireSettings:
    """Return the sonar settings to request, of `device` and `water`.

    Raises:
        SettingsError: the sonar does not support a setting.
    """
    device, water = config.device, config.water
    sound_mps = water.speed_of_sound or None
    if sound_mps is None and water.temperature:
        sound_mps = speed_of_sound_mps(water.temperature, water.salinity)
    rate = "standby" if device.standby else device.ping_rate
    return FireSettings(
        mode=Mode(device.mode),
        ping_rate=PingRate[rate.upper()],
        range_m=device.range,
        gain_percent=device.gain,
        gain_assist=device.gain_assist,
        gamma=device.gamma,
        beams=device.beams,
        bits_per_sample=device.bits_per_sample,
        salinity_ppt=water.salinity,
        speed_of_sound_mps=sound_mps,
    )


class SonarControl:
    """Applies the settings to the sonar while it runs.

    Args:
        sonar: the sonar; it starts with `fire_settings(config)`.
        config: the settings at the start.
        events: receives confirmations; may be None.
    """

    FOLLOWS = (
        "device.mode",
        "device.ping_rate",
        "device.standby",
        "device.range",
        "device.gain",
        "device.gain_assist",
        "device.gamma",
        "device.beams",
        "device.bits_per_sample",
        "water.salinity",
        "water.temperature",
        "water.speed_of_sound",
    )
    """Settings that the sonar follows."""

    def __init__(self, sonar: OculusSonar, config: Config, events: EventLog | None) -> None:
        self._sonar = sonar
        self._events = events
        self._wanted = fire_settings(config)
        self._changed = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._limit = ""

    def check(self, config: Config) -> None:
        """Check settings against the model, if it is known; any thread.

        Raises:
            ConfigError: the sonar does not support a setting.
        """
        try:
            settings = fire_settings(config)
            if self._sonar.model is not None:
                settings.check_model(self._sonar.model)
        except (SettingsError, OutsideLimitsError) as error:
            raise ConfigError(f"$.device.range: {error}", "$.device.range") from error

    def request(self, config: Config) -> None:
        """Request other settings from the sonar; any thread, does not wait."""
        self._wanted = fire_settings(config)
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._changed.set)

    async def run(self) -> NoReturn:
        """Apply changes while the sonar is open, until cancelled."""
        self._loop = asyncio.get_running_loop()
        if self._wanted != self._sonar.settings:
            self._changed.set()
        watching = asyncio.create_task(self._watch_limit())
        try:
            while True:
                await self._changed.wait()
                self._changed.clear()
                await self._apply(self._wanted)
        finally:
            watching.cancel()
            await asyncio.gather(watching, return_exceptions=True)

    def status(self) -> dict[str, Any]:
        """Return the requested settings, the model's limit, and what the last ping differs in."""
        wanted, model = self._wanted, self._sonar.model
        known = model is not None and model.family != UNKNOWN
        farthest_m = model.family.max_range_m[wanted.mode - 1] if model and known else None
        return {
            "model": None if model is None else model.name,
            "model_range_m": farthest_m,
            "requested": {
                "mode": int(wanted.mode),
                "standby": wanted.standby,
                "range_m": self._sonar.limited.range_m,
                "gain_percent": wanted.gain_percent,
                "gain_assist": wanted.gain_assist,
                "gamma": wanted.gamma,
                "beams": wanted.beams,
                "bits_per_sample": wanted.bits_per_sample,
                "salinity_ppt": wanted.salinity_ppt,
                "speed_of_sound_mps": wanted.speed_of_sound_mps,
            },
            "differences": [str(one) for one in self._sonar.changed],
        }

    async def _apply(self, settings: FireSettings) -> None:
        """Apply settings; report the confirmation, unless a newer request replaces them."""
        applying = asyncio.create_task(self._sonar.apply(settings))
        newer = asyncio.create_task(self._changed.wait())
        try:
            await asyncio.wait((applying, newer), return_when=asyncio.FIRST_COMPLETED)
            if not applying.done():
                return
            confirmation = applying.result()
        finally:
            for task in (applying, newer):
                task.cancel()
            await asyncio.gather(applying, newer, return_exceptions=True)
        severity = Severity.NOTICE if confirmation.confirmed else Severity.WARNING
        self._add(
            severity,
            "sonar_settings",
            _text(confirmation),
            confirmed=confirmation.confirmed,
            waited_s=confirmation.waited_ns / 1e9,
        )

    async def _watch_limit(self) -> NoReturn:
        """Report a range that the model limits, as settings of the start may have."""
        while True:
            limit, model = "", self._sonar.model
            if model is not None:
                try:
                    self._sonar.settings.check_model(model)
                except SettingsError as error:
                    limit = f"device.range: {error}; the sonar gets that"
            if limit and limit != self._limit:
                self._add(Severity.WARNING, "sonar_limited", limit)
            self._limit = limit
            await asyncio.sleep(POLL_INTERVAL_S)

    def _add(self, severity: Severity, code: str, text: str, **facts: Any) -> None:  # noqa: ANN401 of events
        if self._events is not None:
            self._events.add(severity, code, text, **facts)


def _text(confirmation: Confirmation) -> str:
    """Return the result of a request, with what the last ping shows otherwise."""
    if not confirmation.confirmed:
        return f"sonar settings are not confirmed: {confirmation.reason}"
    if confirmation.unsettled:
        return f"sonar settings are sent; {confirmation.reason}"
    left = "; ".join(map(str, confirmation.changed))
    return f"sonar settings are in force: {confirmation.reason}" + (left and f", but for {left}")
