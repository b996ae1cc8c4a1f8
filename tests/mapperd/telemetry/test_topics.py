import pytest

from mapperd.config.tree import MqttConfig
from mapperd.telemetry.topics import Asked, Topics
from tests.mapperd.telemetry.conftest import ROOT

TOPICS = Topics.of(MqttConfig(vehicle="rov-1"))


def test_topics_are_those_of_the_convention() -> None:
    assert TOPICS.root == ROOT
    assert TOPICS.of_name("pose") == f"{ROOT}/pose"
    assert TOPICS.of_name("/sonar_robot_detections") == f"{ROOT}/sonar_robot_detections"
    name = "filtering.min_range"
    assert TOPICS.setting(name) == f"{ROOT}/config/{name}"
    assert TOPICS.requests == (f"{ROOT}/cmd/+", f"{ROOT}/config/+/set")
    assert TOPICS.result(Asked("config", name)) == f"{ROOT}/config/{name}/result"
    assert TOPICS.result(Asked("cmd", "save")) == f"{ROOT}/cmd/save/result"


@pytest.mark.parametrize(
    ("below", "asked"),
    [
        ("cmd/save", Asked("cmd", "save")),
        ("config/iwlo.L_occ/set", Asked("config", "iwlo.L_occ")),
        ("cmd/save/result", None),
        ("config/iwlo.L_occ", None),
        ("config/iwlo.L_occ/result", None),
        ("cmd/", None),
        ("cmd/" + "x" * 129, None),
        ("pose", None),
    ],
)
def test_what_a_topic_asks_for(below: str, asked: Asked | None) -> None:
    assert TOPICS.asked(f"{ROOT}/{below}") == asked


def test_another_vehicle_asks_for_nothing_here() -> None:
    assert TOPICS.asked("mapperd/v1/rov-2/mapper/cmd/save") is None
    assert TOPICS.asked("cmd/save") is None
