"""Requests of localization through the socket."""

from pathlib import Path
from typing import Any

import pytest

from mapperd.api import PoseRequest
from tests.support.control_server import Served, go, refusal

POSE = {"x_m": 1.5, "y_m": -2, "yaw_rad": 0.5}


def test_each_is_done(short: Path) -> None:
    async def work(one: Served) -> None:
        line = await one.line()
        assert (await line.ask("initial_pose", pose=POSE))["result"] == {}
        assert (await line.ask("global_localization"))["result"] == {}
        assert (await line.ask("request_nomotion_update"))["result"] == {}
        there = {"path": "/maps/tank.yaml"}
        assert (await line.ask("set_map", name="tank.yaml", pose=POSE))["result"] == there
        assert (await line.ask("set_map", name="tank.yaml"))["result"] == there
        look = await line.ask("localization", particles=7)
        assert look["result"] == {"mode": "off", "state": "off", "particles": 7}
        line.close()
        assert [what[0] for what in one.daemon.done] == [
            "initial_pose",
            "global_localization",
            "request_nomotion_update",
            "set_map",
            "set_map",
        ]
        assert all("control" in what[-1] for what in one.daemon.done)
        assert one.daemon.poses == [PoseRequest(1.5, -2.0, 0.5)] * 2 + [None]

    go(work, short)


def test_all_of_a_pose_arrives(short: Path) -> None:
    covariance = [[1, 0.5, 0], [0.5, 2, 0], [0, 0, 0.1]]

    async def work(one: Served) -> None:
        line = await one.line()
        await line.ask("initial_pose", pose=POSE | {"covariance": covariance, "frame": "tank"})
        await line.ask("initial_pose", pose=POSE | {"std_xy_m": 0.2, "std_yaw_rad": 0.1})
        line.close()
        first, second = one.daemon.poses
        assert first is not None
        assert second is not None
        assert first.covariance == ((1.0, 0.5, 0.0), (0.5, 2.0, 0.0), (0.0, 0.0, 0.1))
        assert first.frame == "tank"
        assert (second.std_xy_m, second.std_yaw_rad) == (0.2, 0.1)

    go(work, short)


def test_refusal_is_answered_with_its_reason(short: Path) -> None:
    async def work(one: Served) -> None:
        line = await one.line()
        for reason in ("no_map", "no_filter", "wrong_frame", "no_free_cells", "first_map_only"):
            one.daemon.fault = refusal(reason)
            error = (await line.ask("global_localization"))["error"]
            assert error["reason"] == reason
            assert error["message"] == f"it cannot be: {reason}"
        line.close()

    go(work, short)


@pytest.mark.parametrize(
    ("do", "more"),
    [
        ("initial_pose", {}),
        ("initial_pose", {"pose": None}),
        ("initial_pose", {"pose": [1, 2, 3]}),
        ("initial_pose", {"pose": {"x_m": 1, "y_m": 2}}),
        ("initial_pose", {"pose": POSE | {"x_m": float("nan")}}),
        ("initial_pose", {"pose": POSE | {"y_m": float("-inf")}}),
        ("initial_pose", {"pose": POSE | {"yaw_rad": 1e9}}),
        ("initial_pose", {"pose": POSE | {"x_m": "1"}}),
        ("initial_pose", {"pose": POSE | {"std_xy_m": -0.1}}),
        ("initial_pose", {"pose": POSE | {"covariance": [1] * 9}}),
        ("initial_pose", {"pose": POSE | {"covariance": [[1e99] * 3] * 3}}),
        ("initial_pose", {"pose": POSE | {"frame": "x" * 65}}),
        ("initial_pose", {"pose": POSE, "force": True}),
        ("global_localization", {"pose": POSE}),
        ("set_map", {"name": 7, "pose": POSE}),
        ("set_map", {"pose": POSE}),
        ("localization", {"particles": 501}),
        ("localization", {"particles": -1}),
        ("globallocalization", {}),
    ],
)
def test_what_makes_no_sense_reaches_nobody(short: Path, do: str, more: dict[str, Any]) -> None:
    async def work(one: Served) -> None:
        line = await one.line()
        assert (await line.ask(do, **more))["error"]["reason"] == "bad_request"
        assert (await line.ask("status"))["result"]["phase"] == "mapping"
        line.close()
        assert one.daemon.done == []
        assert one.daemon.poses == []

    go(work, short)


def test_token_is_needed_as_for_all_else(short: Path) -> None:
    async def work(one: Served) -> None:
        line = await one.raw("tcp")
        answer = await line.hello(b"wrong-token-of-nobody")
        assert answer["reason"] == "wrong_token"
        await line.is_cut()
        line.close()
        line = await one.line("tcp")
        assert "result" in await line.ask("global_localization")
        line.close()
        assert one.daemon.done == [("global_localization", "control, 127.0.0.1")]

    go(work, short)
