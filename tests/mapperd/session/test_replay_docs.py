"""docs/guides/replay.md describes what the program does."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mapperd.config.tree import Config
from mapperd.daemon.map_folder import recording_facts, summary_of
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.session.recordings import RecordedSession
from mapperd.session.replay import Replay, Window
from oculus_driver.command_line import ExitCode
from oculus_driver.ping import Ping

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "guides" / "replay.md").read_text(
    encoding="utf-8"
)

COMMANDS = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "cli.md").read_text(
    "utf-8"
)


def test_library_example_runs(ping: Callable[..., Ping]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, Any] = {"ping": ping()}
    exec(example, names)  # noqa: S102 our own page
    assert names["result"].stats.occupied > 0
    assert len(names["occupied"]) > 0


def test_every_key_of_the_summary_is_explained(
    tmp_path: Path, ping_bytes: Callable[..., bytes]
) -> None:
    (tmp_path / "raw").write_bytes(ping_bytes(1))
    sonar_map, poses = SonarMap(Config()), FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0)))
    replay = Replay(sonar_map, poses, Window(), lambda: 0.0)
    session = RecordedSession([tmp_path / "raw"], None)
    list(replay.run(session))
    summary = summary_of(recording_facts([session]), sonar_map, poses, replay.counters, 0.0)
    for key in summary:
        assert f"`{key}`" in PAGE


def test_every_exit_code_is_explained() -> None:
    for code in ExitCode:
        assert f"| {code.value} |" in COMMANDS
