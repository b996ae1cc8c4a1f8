"""Mistakes of a set-up: each is one line that names the remedy."""

from types import SimpleNamespace
from typing import Any

import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.daemon.problems import Problem, activity_of, problems_of
from mapperd.daemon.status import Watch
from mapperd.events import EventLog

IN_USE = (
    "the sonar at 192.168.2.3 is in use by 192.168.2.9: it serves one client at a time, close the "
    "other one"
)
QUANTITIES = ("position", "attitude", "depth", "velocity")


def status(
    *has: str,
    sonar: tuple[str, str] = ("pinging", ""),
    links: dict[str, str] | None = None,
    accepted: int = 10,
    frames: dict[str, int] | None = None,
    rejected: dict[str, int] | None = None,
    clock_offset_s: float | None = None,
    **parts: Any,
) -> dict[str, Any]:
    quantities = {name: {"newest_ns": 1 if name in has else None} for name in QUANTITIES}
    connections = {
        name: {"link": "UDP 127.0.0.1:52200", "state": state, "reason": ""}
        for name, state in (links or {"odometry": "receiving"}).items()
    }
    return {
        "uptime_s": 60.0,
        "sonar": {"state": sonar[0], "reason": sonar[1], "address": None},
        "odometry": {
            "source": "odometry",
            "received": 10 if accepted or rejected else 0,
            "accepted": accepted,
            "rejected": rejected or {},
            "quantities": quantities,
            "sources": {"dvl": {"rejected": rejected or {}, "clock_offset_s": clock_offset_s}},
            "connections": connections,
            "links": {
                "odometry": {
                    "bytes": 99,
                    "frames": 10 if frames is None else sum(frames.values()),
                    "messages": frames or {},
                    "records": 10 if frames is None else 0,
                    "rejected": {},
                }
            },
        },
        "localization": None,
        "recording": {"state": "logging", "reason": ""},
        "store": {"bricks_lost": 0},
    } | parts


def found(state: dict[str, Any], settings: str = "") -> list[tuple[str, str]]:
    problems = problems_of(state, config_from_text(settings))
    assert not any("\n" in one.text for one in problems)
    return [(one.code, one.text) for one in problems]


def test_headlines_say_mapping_only_where_something_is_mapped() -> None:
    mapped = {"pings": {"mapped": 3}, "problems": []}
    assert activity_of("mapping", mapped) == "mapping"
    assert activity_of("stopping", mapped) == "stopping"
    assert activity_of("mapping", mapped | {"pings": {"mapped": 0}}) == "nothing mapped yet"
    for code, activity in (("no_position", "not mapping"), ("clock_off", "mapping")):
        assert activity_of("mapping", mapped | {"problems": [{"code": code}]}) == activity


def test_an_unconfirmed_pose_is_no_problem_where_a_search_may_confirm_it() -> None:
    state = status("attitude", "position", localization={"map": "a.map", "confirmed": False})
    model = "amcl: {laser_model_type: likelihood_field_prob}\n"
    search = "localization: {search_poses: 1000, alternative_interval: 3}\n"
    assert found(state, model + search) == []
    assert len(found(state, search)) == 1


def test_a_session_that_maps_has_no_problem() -> None:
    assert found(status("attitude", "position")) == []
    assert found(status("attitude", "velocity", "depth")) == []
    assert found(status("attitude"), "odometry: {owners: {position: fixed}}") == []
    fixed_pose = {"source": "fixed", "ignored": 0, "connections": {}}
    assert found(status(odometry=fixed_pose)) == []


def test_nothing_is_missed_in_the_first_seconds() -> None:
    assert found(status(sonar=("searching", "no status received yet"), uptime_s=2.0)) == []


@pytest.mark.parametrize(
    ("state", "settings", "code", "words"),
    [
        (
            status("attitude", "depth"),
            "",
            "no_position",
            [
                "neither horizontal position nor velocity",
                "only attitude and depth",
                "recorded and shown",
                "Add a DVL",
                "odometry.owners.position: fixed",
            ],
        ),
        (
            status("attitude", rejected={"no_lock": 4}),
            "odometry: {sources: [{name: dvl}], owners: {velocity: dvl}}",
            "no_position",
            ["velocity is expected from dvl, which sent: no_lock 4"],
        ),
        (status("depth"), "", "no_attitude", ["only depth", "odometry.sources"]),
        (
            status(links={"odometry": "waiting"}),
            "",
            "no_odometry",
            ["UDP 127.0.0.1:52200 (odometry)", "let the vehicle send there", "odometry.sources"],
        ),
        (
            status("attitude", "position", links={"one": "receiving", "dvl": "backing off"}),
            "",
            "odometry_quiet",
            ["(dvl)", "give the source another port", "`mapperd doctor`"],
        ),
        (
            status(accepted=0, rejected={"not_a_frame": 7}, frames={}),
            "odometry: {sources: [{format: mavlink}]}",
            "odometry_format",
            ["nothing that arrives", "of format mavlink: correct its format"],
        ),
        (
            status(accepted=0, frames={"HEARTBEAT": 9}),
            "odometry: {sources: [{format: mavlink}]}",
            "odometry_format",
            ["sends no odometry, only HEARTBEAT 9", "the autopilot sends no position"],
        ),
        (
            status(accepted=0, rejected={"clock_off": 9, "jump": 1}),
            "",
            "odometry_rejected",
            ["clock_off 9, jump 1", "docs/guides/odometry.md"],
        ),
        (
            status("attitude", "position", localization={"map": ""}),
            "",
            "no_map",
            ["localization.map_path", "`mapperctl set_map`"],
        ),
        (
            status("attitude", "position", clock_offset_s=-10800.0),
            "",
            "clock_off",
            ["source dvl is 3.0 h behind this computer's", "Synchronize"],
        ),
        (
            status("attitude", "position", sonar=("searching", "no status received yet")),
            "",
            "no_sonar",
            ["power and cable", "device.address"],
        ),
        (
            status(
                "attitude",
                "position",
                sonar=("searching", IN_USE),
            ),
            "",
            "sonar_in_use",
            ["192.168.2.9", "close the other one"],
        ),
        (
            status("attitude", "position", sonar=("backing off", "TCP port 52100 is silent")),
            "device: {address: 192.168.2.77}",
            "sonar_unreachable",
            ["If 192.168.2.77 is wrong, correct device.address", "finds the sonar"],
        ),
        (
            status("attitude", "position", sonar=("silent", "no ping for 3.0 s")),
            "",
            "sonar_silent",
            ["no ping for 3.0 s", "`mapperd doctor`"],
        ),
        (
            status(
                "attitude",
                "position",
                recording={"state": "paused", "reason": "less than 1024 MiB are free"},
            ),
            "",
            "recording_paused",
            ["less than 1024 MiB are free", "recording.budget"],
        ),
        (
            status("attitude", "position", localization={"map": "a.map", "confirmed": False}),
            "",
            "pose_unconfirmed",
            ["stays ambiguous", "initial pose", "alternative_interval", "config/localization.yaml"],
        ),
        (
            status("attitude", "position", store={"bricks_lost": 3}),
            "",
            "bricks_lost",
            ["3 damaged bricks", "not free", "restart"],
        ),
    ],
    ids=lambda value: value if isinstance(value, str) and value.isidentifier() else "",
)
def test_a_mistake_is_one_line_with_a_remedy(
    state: dict[str, Any], settings: str, code: str, words: list[str]
) -> None:
    ((problem, text),) = found(state, settings)
    assert problem == code
    assert [word for word in words if word not in text] == []


def test_a_problem_is_one_event_and_so_is_its_end() -> None:
    live: Any = None
    events = EventLog(lambda: 0)
    watch = Watch(events, live)
    problem = Problem("no_position", "attitude alone arrives: add a DVL")
    watch.look_at_problems([problem])
    assert events.since(0)[0] == []  # the next record may solve it
    for _ in range(3):
        watch.look_at_problems([problem])
    watch.look_at_problems([])
    reported = [(one.code, one.text) for one in events.since(0)[0]]
    assert reported == [
        ("no_position", "attitude alone arrives: add a DVL"),
        ("problem_solved", "solved: attitude alone arrives"),
    ]


def test_another_state_of_the_sonar_is_the_same_problem() -> None:
    live: Any = None
    events = EventLog(lambda: 0)
    watch = Watch(events, live)
    silent = Problem("sonar_silent", "the sonar does not ping: no ping for 5 s")
    away = Problem("sonar_unreachable", "the sonar at 10.0.0.1 sends nothing: timed out")
    for problem in (silent, silent, away, silent, away, away, away):
        watch.look_at_problems([problem])
    watch.look_at_problems([])
    assert [one.code for one in events.since(0)[0]] == [
        "sonar_silent",
        "sonar_unreachable",
        "problem_solved",
    ]


def test_a_paused_recording_is_logged_with_its_remedy() -> None:
    state = {"state": "logging", "reason": ""}
    live: Any = SimpleNamespace(recorder=SimpleNamespace(status=lambda: state))
    events = EventLog(lambda: 0)
    watch = Watch(events, live)
    watch._look_at_recording()
    state = {"state": "paused", "reason": "free_space"}
    watch._look_at_recording()
    state = {"state": "logging", "reason": ""}
    watch._look_at_recording()
    paused, again = events.since(0)[0]
    assert "less free space than recording.free_floor. Delete files" in paused.text
    assert again.text == "recording: logging"


def test_the_default_settings_give_no_false_alarm() -> None:
    assert problems_of(status("attitude", "position"), Config()) == []
