"""The estimated pose is saved now and then, and read where a session begins."""

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import AmclConfig
from mapperd.daemon.localization_service import PoseKeeper
from mapperd.daemon.run import _start_localization
from mapperd.errors import ConfigError
from mapperd.events import EventLog
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.saved_pose import load_pose
from mapperd.localization.session import begun
from tests.mapperd.localization.room import settings, write_room

if TYPE_CHECKING:
    from mapperd.localization.status import LocalizationSnapshot


class SentState:
    """Facts that a test changes."""

    def __init__(self, path: Path, config_text: str) -> None:
        localizing = begun(config_from_text(config_text))
        assert localizing is not None
        self.snapshot: LocalizationSnapshot | None = localizing.stage.snapshot()
        self.amcl = AmclConfig(save_pose_rate=50.0)
        self.events = EventLog(lambda: 0)
        self.path = path
        self.keeper = PoseKeeper(path, lambda: self.snapshot, lambda: self.amcl, int, self.events)

    def now_at(self, x_m: float, stamp_ns: int, elsewhere: float = 0.0) -> None:
        assert self.snapshot is not None
        pose = PlanarGaussian(x_m, 0.0, 0.0, np.eye(3))
        belief = Belief(pose, pose, np.ones(1), elsewhere, 10.0)
        self.snapshot = replace(self.snapshot, belief=belief, stamp_ns=stamp_ns)

    @property
    def saved_x_m(self) -> float | None:
        pose = load_pose(self.path, "map")
        return None if pose is None else pose.x_m


@pytest.fixture
def reported(tmp_path: Path) -> SentState:
    return SentState(tmp_path / "pose.json", settings(write_room(tmp_path)))


def test_newest_estimate_is_saved(reported: SentState) -> None:
    reported.keeper.save()
    assert reported.saved_x_m is None  # nothing is saved yet
    reported.now_at(1.0, 1)
    reported.keeper.save()
    assert reported.saved_x_m == 1.0
    reported.path.unlink()
    reported.keeper.save()
    assert reported.saved_x_m is None  # nothing new


def test_ambiguous_estimate_is_not_saved(reported: SentState) -> None:
    reported.now_at(1.0, 1)
    reported.keeper.save()
    reported.now_at(2.0, 2, elsewhere=0.5)
    reported.keeper.save()
    assert reported.saved_x_m == 1.0


def test_rate_of_zero_saves_nothing(reported: SentState) -> None:
    reported.amcl = AmclConfig(save_pose_rate=0.0)
    reported.now_at(1.0, 1)
    reported.keeper.save()
    assert reported.saved_x_m is None


def test_it_saves_while_it_runs(reported: SentState) -> None:
    async def work() -> None:
        running = asyncio.create_task(reported.keeper.run())
        reported.now_at(3.0, 1)
        async with asyncio.timeout(10):
            while reported.saved_x_m != 3.0:  # noqa: ASYNC110 another thread writes it
                await asyncio.sleep(0.01)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    asyncio.run(work())


def test_full_disk_is_reported_once(reported: SentState) -> None:
    reported.path.mkdir()
    for k in (1, 2):
        reported.now_at(float(k), k)
        reported.keeper.save()
    codes = [event.code for event in reported.events.since(0)[0]]
    assert codes == ["pose_not_saved"]


def test_map_that_is_being_made_is_not_the_known_one(tmp_path: Path) -> None:
    def config(**ours: Any) -> Any:
        path = tmp_path / "own.map"
        return config_from_text(
            settings(path, **ours) + f"outofcore: {{use: true, map_path: '{path}'}}\n"
        )

    events = EventLog(lambda: 0)
    with pytest.raises(ConfigError, match="is the map that pings are mapped into"):
        _start_localization(config(mapping="corrected"), events)
    with pytest.raises(ConfigError, match="no such file"):
        _start_localization(config(mapping="off"), events)


def test_saved_pose_that_is_invalid_is_reported_and_passed_over(
    reported: SentState, tmp_path: Path
) -> None:
    config = config_from_text(settings(write_room(tmp_path), pose_path=f"'{reported.path}'"))
    for text, codes in (("{}", ["saved_pose_ignored"]), (None, [])):
        reported.path.unlink(missing_ok=True)
        if text is not None:
            reported.path.write_text(text, encoding="utf-8")
        events = EventLog(lambda: 0)
        found = _start_localization(config, events)
        assert found is not None
        assert found.saved is None
        assert [event.code for event in events.since(0)[0]] == codes
    reported.now_at(3.0, 1)
    reported.keeper.save()
    found = _start_localization(config, EventLog(lambda: 0))
    assert found is not None
    assert found.saved is not None
    assert found.saved.x_m == 3.0
    assert found.stage.snapshot().particles[:, 0].mean() == pytest.approx(3.0, abs=0.5)
