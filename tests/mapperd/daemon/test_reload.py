import asyncio
from pathlib import Path

from mapperd.config.layers import Layered, load_files
from mapperd.config.live import Applied, ConfigStore
from mapperd.daemon.daemon import Daemon
from mapperd.daemon.session import Live
from mapperd.events import EventLog
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import FixedPose


def daemon_of(layered: Layered, path: Path) -> Daemon:
    store = ConfigStore(layered)
    sonar_map, events = SonarMap(store.current), EventLog(lambda: 0)
    live = Live(sonar_map, FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0))), clock=lambda: 0)

    def read() -> Layered:
        return load_files([path])

    return Daemon(store, sonar_map, live, events, read=read, folder=path.parent)


def texts(daemon: Daemon) -> list[str]:
    return [event.text for event in daemon.events.since(0)[0]]


def test_reload_reads_the_files_again_and_reports_what_became_of_it(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("filtering: {min_range: 1}", encoding="utf-8")

    async def run() -> None:
        daemon = daemon_of(load_files([path]), path)
        path.write_text(
            "filtering: {min_range: 2}\noctree: {voxel_resolution: 1}\ntime_sync: {max_gap_sec: 1}",
            encoding="utf-8",
        )
        await daemon.reload("SIGHUP")
        assert isinstance(daemon.settings.apply({"filtering.min_range": 3}, "x"), Applied)
        assert texts(daemon) == [
            "setting filtering.min_range is now 2.0",
            "setting time_sync.max_gap_sec is now 1.0",
            "setting octree.voxel_resolution: changed in the files, waits for a restart",
            "setting filtering.min_range is now 3.0",
        ]

    asyncio.run(run())


def test_files_that_became_wrong_leave_the_settings_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("filtering: {min_range: 1}", encoding="utf-8")
    daemon = daemon_of(load_files([path]), path)
    before = daemon.settings.current
    path.write_text("filtering: {min_range: -1}", encoding="utf-8")
    result = asyncio.run(daemon.reload("test"))
    (line,) = texts(daemon)
    assert f"{path}: $.filtering.min_range: -1 " in line
    assert daemon.settings.current is before
    assert list(result["refused"]) == ["$.filtering.min_range"]


def test_refused_reload_reports_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("mapping: {occupied_threshold: 0.4, free_threshold: 0.3}", encoding="utf-8")
    daemon = daemon_of(load_files([path]), path)
    path.write_text(
        "crosstalk: {enabled: false}\nmapping: {occupied_threshold: 0.2, free_threshold: 0.3}",
        encoding="utf-8",
    )
    result = asyncio.run(daemon.reload("test"))
    assert result["changed"] == {}
    assert texts(daemon)[0].startswith("settings stay as they are: ")


def test_nothing_new_is_reported_too(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("{}", encoding="utf-8")
    daemon = daemon_of(load_files([path]), path)
    assert asyncio.run(daemon.reload("test")) == {"changed": {}, "refused": {}, "waiting": []}
    assert texts(daemon) == ["settings read again: nothing is new"]
