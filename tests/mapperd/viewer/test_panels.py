"""The panels of settings and of the sonar, on a page without a browser."""

import asyncio
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

pytest.importorskip("viser", reason="the extra `topside` is not installed")

from mapperd.cli.mapperctl.view import open_page
from mapperd.config.live import facts_of
from mapperd.config.tree import Config
from mapperd.server.state_feed import SettingLog
from mapperd.viewer import sonar_panel
from mapperd.viewer.settings import SettingsPanel
from mapperd.viewer.sonar_panel import LABELS, SonarPanel, caption_html

if TYPE_CHECKING:
    from viser import ViserServer

pytestmark = pytest.mark.net

FACTS = facts_of(Config(), lambda _: "default", [])
LIVE = {name for name, fact in FACTS.items() if fact["dynamic"]}


@pytest.fixture(scope="module")
def server() -> Iterator["ViserServer"]:
    server = open_page("127.0.0.1", 0)
    yield server
    server.stop()


def test_a_setting_that_changed_before_the_page_opened_has_its_control(
    server: "ViserServer",
) -> None:
    log = SettingLog(FACTS)
    name = "filtering.min_range"
    log.put({name: FACTS[name] | {"value": 1.5}})  # it is the last of all settings now
    panel = SettingsPanel(server, server.gui.add_tab_group().add_tab("one"), lambda *_: None)
    number, messages = 0, 0
    while number < log.last:
        number, facts = log.since(number, 3000)
        panel.take({name: decoded(fact) for name, fact in facts.items()})
        messages += 1
    assert messages > 3
    assert panel._controls.keys() == LIVE
    assert panel._controls[name][1].value == 1.5
    orders = [panel._controls[one][1].order for one in FACTS if one in panel._controls]
    assert orders == sorted(orders), "they stand in the order of the configuration"


def call(do: Callable[[], object]) -> None:
    do()


def decoded(fact: Any) -> Any:
    return msgspec.msgpack.decode(bytes(fact))


def test_a_value_beyond_the_limits_is_sent_and_not_clamped(server: "ViserServer") -> None:
    sent: list[dict[str, Any]] = []
    tab = server.gui.add_tab_group().add_tab("two")
    panel = SettingsPanel(server, tab, lambda _, changes: sent.append(changes))
    panel.take(FACTS)
    handle = panel._controls["filtering.min_range"][1]
    assert handle.min is handle.max is None
    handle.value = 500.0
    panel._send(None, "filtering")
    assert sent == [{"filtering.min_range": 500.0}]
    panel.reset(sent[0])
    assert handle.value == FACTS["filtering.min_range"]["value"]


def test_the_sonar_has_its_controls_and_sends_a_value_once_it_rests(
    server: "ViserServer", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sonar_panel, "SETTLE_S", 0.4)
    sent: list[dict[str, Any]] = []

    async def work() -> None:
        tabs = server.gui.add_tab_group()
        panel = SonarPanel(
            server,
            tabs.add_tab("three"),
            tabs.add_tab("four"),
            post=call,
            apply=lambda _, changes: sent.append(changes),
            shown=lambda: None,
        )
        panel.take_settings(FACTS)
        assert panel._handles.keys() == LABELS.keys()
        for value in (9.0, 8.5, 8.0):
            panel._handles["device.range"].value = value
            panel._changed("device.range", None)
        panel._handles["device.mode"].value = "2"
        panel._changed("device.mode", None)
        while len(sent) < 2:  # noqa: ASYNC110 the panel notifies nobody
            await asyncio.sleep(0.05)
        assert sent == [{"device.range": 8.0}, {"device.mode": 2}]
        panel.reset({"device.range": 8.0, "device.mode": 2})
        assert panel._handles["device.range"].value == 10.0
        assert panel._handles["device.mode"].value == "1"
        for status, there in (({"phase": "file"}, False), ({"sonar": {}}, True)):
            panel.take_status(status)
            assert {handle.visible for handle in panel._handles.values()} == {there}
            assert panel._note.visible is not there

    asyncio.run(work())


def test_the_line_under_the_image_names_what_differs() -> None:
    sonar = {
        "model": "M750d",
        "state": "pinging",
        "ping_rate_hz": 9.96,
        "requested": {"range_m": 8.0, "gain_percent": 50.0, "standby": False},
        "differences": ["gain, percent: requested 50, got <40>"],
    }
    text = caption_html(sonar)
    assert "M750d &middot; pinging &middot; 10.0 pings/s &middot; 8 m &middot; gain 50 %" in text
    assert "requested 50, got &lt;40&gt;" in text
    assert "no image yet" in caption_html({})
