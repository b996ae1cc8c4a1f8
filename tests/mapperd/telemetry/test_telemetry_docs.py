"""The telemetry page lists what is sent."""

import re
from pathlib import Path

from mapperd.config.loader import config_from_text
from mapperd.events import Severity
from mapperd.telemetry.broker import TIMEOUT_S, Kind, Outbox
from mapperd.telemetry.publisher import Reporter
from mapperd.telemetry.telemetry import (
    MAX_BYTES,
    MAX_ID,
    MAX_RETRY_DELAY_S,
    MAX_WAITING,
    REMEMBERED,
    RETRY_DELAY_S,
)
from mapperd.telemetry.topics import MAX_NAME, Topics
from tests.mapperd.localization.believed import snapshot
from tests.mapperd.telemetry.conftest import POSE, ROBOT, T0_S, FakeVehicle, below

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "guides" / "telemetry.md").read_text(
    encoding="utf-8"
)


def test_table_has_every_topic_with_its_quality_and_whether_it_is_kept(daemon: FakeVehicle) -> None:
    daemon.pose, daemon.robots, daemon.localized = POSE, [ROBOT], snapshot()
    daemon.events.add(Severity.INFO, "code", "text")
    outbox = Outbox(100)
    topics = Topics.of(daemon.settings.current.mqtt)
    Reporter(daemon, topics, outbox, dict, dict).collect(T0_S)
    sent = {"status": ("1", "yes")}  # by the shell, and as the will
    while (message := outbox.take(*Kind)) is not None:
        topic = re.sub("config/.*", "config/<setting>", below(message.topic))
        sent[topic] = (str(message.qos), "yes" if message.retain else "no")
    rows = re.findall(r"^\| `([^`]+)` \|.*\| ([01]) \| (yes|no) \|.*\|$", PAGE, re.MULTILINE)
    assert {topic: (qos, kept) for topic, qos, kept in rows} == sent


def test_numbers_are_those_of_the_code() -> None:
    text = " ".join(PAGE.split())
    for words in (
        f"at most {MAX_ID} characters",
        f"of the last {REMEMBERED} requests",
        f"more than {MAX_WAITING} requests",
        f"more than {MAX_NAME} characters",
        f"more than {MAX_BYTES} bytes",
        f"{TIMEOUT_S:g} s without an answer",
        f"random pause of {RETRY_DELAY_S / 2:g} to {RETRY_DELAY_S:g} s",
        f"growing to {MAX_RETRY_DELAY_S:g} s",
    ):
        assert words in text, words


def test_example_loads() -> None:
    (example,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert config_from_text(example).mqtt.vehicle == "rov-1"
