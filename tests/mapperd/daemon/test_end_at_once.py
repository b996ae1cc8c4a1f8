"""What a second Ctrl-C reports: only what is recorded counts as recorded."""

import asyncio
import shutil
from pathlib import Path

import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.daemon.run import kept_at_once
from mapperd.pipeline.recorder import Recorder
from mapperd.session_log import Gap, chunk_of


def config_of(folder: Path, *, on_disk: bool, floor_mib: int = 0, enabled: bool = True) -> Config:
    return config_from_text(
        f"outofcore: {{use: {str(on_disk).lower()}, map_path: {folder}/dive.map}}\n"
        f"recording: {{folder: {folder}/recordings, free_floor: {floor_mib}, "
        f"enabled: {str(enabled).lower()}}}\n"
    )


def kept(config: Config) -> str:
    """Record something, and end at once."""
    recorder = Recorder(config, "a")

    async def work() -> str:
        async with recorder:
            recorder.record(chunk_of(Gap("sonar"), 1), gap=False)
            recorder.wait_for(recorder.newest, 1.0)
            return kept_at_once(config, recorder)

    return asyncio.run(work())


@pytest.mark.parametrize("on_disk", [True, False])
def test_what_is_recorded_is_named(tmp_path: Path, *, on_disk: bool) -> None:
    text = kept(config_of(tmp_path, on_disk=on_disk))
    assert ("the next start maps the rest" if on_disk else "--replay") in text
    assert "paused" not in text
    assert "not recorded" not in text


@pytest.mark.parametrize("on_disk", [True, False])
def test_a_paused_recording_is_not_said_to_hold_the_session(
    tmp_path: Path, *, on_disk: bool
) -> None:
    floor_mib = (shutil.disk_usage(tmp_path).free >> 20) + 10_000
    text = kept(config_of(tmp_path, on_disk=on_disk, floor_mib=floor_mib))
    assert "the recording is paused (free_space" in text
    assert "in memory" in text
    assert "the next start maps the rest" not in text


@pytest.mark.parametrize("on_disk", [True, False])
def test_without_a_recording_the_rest_is_lost(tmp_path: Path, *, on_disk: bool) -> None:
    text = kept(config_of(tmp_path, on_disk=on_disk, enabled=False))
    assert "recording.enabled is off" in text
    assert "the next start maps the rest" not in text


def test_before_the_session_the_next_start_maps_what_is_recorded(tmp_path: Path) -> None:
    text = kept_at_once(config_of(tmp_path, on_disk=True), None)
    assert "the next start maps the rest of the recording" in text
