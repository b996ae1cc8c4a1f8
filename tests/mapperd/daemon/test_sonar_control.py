"""The sonar follows the settings while it maps, and what it cannot do is reported."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import pytest

from mapperd.config.catalog import parameters
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.daemon.session import Live
from mapperd.daemon.sonar_control import SonarControl, fire_settings
from mapperd.errors import ConfigError
from mapperd.events import Event, EventLog
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import FixedPose
from oculus_driver import Confirmation, Difference, OculusSonar, PlaybackSonar
from oculus_driver.sound_speed import speed_of_sound_mps
from oculus_driver.wire import FireFlags, PingRate
from tests.support.process import free_port
from tests.support.waiting import run

MakeBytes = Callable[..., bytes]
M750D = 1032


def text_of(device: str, water: str = "") -> str:
    return (
        "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
        f"device: {{{device}}}\nwater: {{{water}}}\n"
        f"odometry: {{sources: [{{link: 'udp://127.0.0.1:{free_port()}'}}]}}\n"
    )


@pytest.mark.parametrize(
    ("water", "sound_mps"),
    [
        ("", None),
        ("salinity: 0", None),
        ("temperature: 12", speed_of_sound_mps(12, 35)),
        ("temperature: 12, salinity: 0", speed_of_sound_mps(12, 0)),
        ("temperature: 12, speed_of_sound: 1480", 1480.0),
    ],
)
def test_the_water_reaches_the_fire_message(water: str, sound_mps: float | None) -> None:
    settings = fire_settings(config_from_text(text_of("range: 4", water)))
    assert settings.speed_of_sound_mps == sound_mps
    assert settings.salinity_ppt == (0.0 if "salinity" in water else 35.0)


def test_bits_and_gain_assist_reach_the_fire_message() -> None:
    text = text_of("bits_per_sample: 32, gain_assist: true, gamma: 127, standby: true")
    settings = fire_settings(config_from_text(text))
    assert settings.flags & FireFlags.GAIN_ASSIST
    assert settings.needs_version_2
    assert settings.gamma == 127
    assert settings.ping_rate == PingRate.STANDBY


class Bench:
    """A session with a sonar on loopback."""

    def __init__(self, sonar: PlaybackSonar, device: str) -> None:
        here = f"address: {sonar.host}, port: {sonar.port}, ping_rate: highest, beams: 256"
        self.here = here
        sonar_map = SonarMap(config_from_text(text_of(f"{here}, {device}")))
        self.events = EventLog(lambda: 0)
        fixed = FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0)))
        self.live = Live(sonar_map, fixed, events=self.events)

    def change(self, device: str, water: str = "") -> None:
        self.live.reconfigure(config_from_text(text_of(f"{self.here}, {device}", water)))

    async def event(self, code: str) -> Event:
        while True:
            found = [one for one in self.events.since(0)[0] if one.code == code]
            if found:
                return found[-1]
            await asyncio.sleep(0.01)


def session(
    ping_bytes: MakeBytes, device: str, work: Callable[[Bench, PlaybackSonar], Any]
) -> None:
    async def worked() -> None:
        pings = [ping_bytes(k, start_time=100 + 0.05 * k, part_number=M750D) for k in range(1, 40)]
        async with PlaybackSonar(pings, standby=True, loops=None, resampled=True) as sonar:
            bench = Bench(sonar, device)
            await bench.live.run(work(bench, sonar))

    run(worked())


@pytest.mark.net
def test_a_change_is_sent_confirmed_and_shown(ping_bytes: MakeBytes) -> None:
    async def work(bench: Bench, sonar: PlaybackSonar) -> None:
        while not bench.live.counters.pings_mapped:  # noqa: ASYNC110 no event to await
            await asyncio.sleep(0.01)
        bench.change("range: 5, gain: 61", "salinity: 0, speed_of_sound: 1450")
        event = await bench.event("sonar_settings")
        assert event.facts["confirmed"] is True, event.text
        assert event.text == "sonar settings are in force: a ping shows the settings"
        assert bench.live.sonar.changed == ()
        demand = sonar.device.request
        assert demand is not None
        assert (demand.range_demand, demand.gain_percent) == (5.0, 61.0)
        assert (demand.salinity_ppt, demand.speed_of_sound_demand_mps) == (0.0, 1450.0)
        status = bench.live.control.status()
        assert (status["model"], status["model_range_m"]) == ("M750d", 120.0)
        assert status["requested"]["range_m"] == 5.0

    session(ping_bytes, "range: 10", work)


GAIN = Difference("gain, percent", 61.0, 50.0, decisive=False)
SENT = Confirmation(
    confirmed=True,
    reason="the last ping still differs: gain",
    waited_ns=0,
    pings=9,
    changed=(GAIN,),
    unsettled=(GAIN,),
)
IN_FORCE = replace(SENT, reason="a ping shows the settings", unsettled=())


@pytest.mark.parametrize(
    ("confirmation", "text"),
    [
        (SENT, "are sent; the last ping still differs: gain"),
        (IN_FORCE, f"are in force: a ping shows the settings, but for {GAIN}"),
    ],
    ids=["changed", "unchanged"],
)
def test_what_the_last_ping_shows_otherwise_is_in_the_event(
    confirmation: Confirmation, text: str
) -> None:
    class Sonar:
        settings, model = fire_settings(Config()), None

        async def apply(self, _: object) -> Confirmation:
            return confirmation

    async def worked() -> None:
        events = EventLog(lambda: 0)
        control = SonarControl(cast("OculusSonar", Sonar()), Config(), events)
        control.request(config_from_text(text_of("gain: 61")))
        running = asyncio.create_task(control.run())
        while not events.since(0)[0]:  # noqa: ASYNC110 no event to await
            await asyncio.sleep(0)
        running.cancel()
        assert [one.text for one in events.since(0)[0]] == [f"sonar settings {text}"]

    run(worked())


@pytest.mark.net
def test_a_range_beyond_the_model_is_refused_once_the_model_is_known(
    ping_bytes: MakeBytes,
) -> None:
    async def work(bench: Bench, _: PlaybackSonar) -> None:
        far = config_from_text(text_of("mode: 2, range: 100"))
        bench.live.control.check(far)  # no message came yet
        while bench.live.sonar.model is None:  # noqa: ASYNC110 no event to await
            await asyncio.sleep(0.01)
        with pytest.raises(ConfigError, match=r"^\$\.device\.range: .* reaches 40 m in mode 2$"):
            bench.live.control.check(far)

    session(ping_bytes, "range: 10", work)


@pytest.mark.net
def test_a_range_of_the_start_that_the_model_limits_is_an_event(ping_bytes: MakeBytes) -> None:
    async def work(bench: Bench, _: PlaybackSonar) -> None:
        event = await bench.event("sonar_limited")
        for part in ("device.range", "200 m", "M750d", "120 m"):
            assert part in event.text
        assert bench.live.control.status()["requested"]["range_m"] == 120.0

    session(ping_bytes, "range: 200", work)


@pytest.mark.net
def test_standby_keeps_the_connection(ping_bytes: MakeBytes) -> None:
    async def work(bench: Bench, sonar: PlaybackSonar) -> None:
        await asyncio.sleep(0.2)
        bench.change("standby: true")
        event = await bench.event("sonar_settings")
        assert "standby" in event.text
        assert sonar.device.request is not None
        assert sonar.device.request.standby
        assert bench.live.link.state == "standby"

    session(ping_bytes, "range: 10", work)


def test_what_the_sonar_follows_may_change_live() -> None:
    live = {
        name
        for name, one in parameters().items()
        if one.dynamic and name.startswith(("device.", "water."))
    }
    assert live == {*SonarControl.FOLLOWS, "water.correct_ranges"}
