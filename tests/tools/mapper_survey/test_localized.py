"""A dive that is localized on a known map is mapped there, as the daemon maps it."""

from pathlib import Path

import pytest

from mapperd.config.loader import config_from_text
from mapperd.session.replay_to_store import map_into_store
from oculus_driver.recording import RecordingWriter
from tests.mapperd.conftest import Event
from tests.mapperd.localization.room import dive, events, room, settings, write_room
from tests.tools.mapper_survey.dives import START_NS, rows_in, run_here, write_survey

LINKS = {"ping": "oculus", "odometry": "odometry-native"}


def write_recording(path: Path, found: list[Event]) -> None:
    with RecordingWriter(path, overwrite=True) as writer:
        links = {kind: writer.add_link(kind, encoding) for kind, encoding in LINKS.items()}
        for kind, data, seconds in found:
            stamp = None if seconds is None else START_NS + round(seconds * 1e9)
            writer.write(links[kind], data, stamp)


@pytest.mark.slow
def test_a_localized_dive_is_what_the_daemon_makes_of_it(tmp_path: Path) -> None:
    write_recording(tmp_path / "dive.mcap", list(events(room(), dive(40))))
    known = write_room(tmp_path)
    (tmp_path / "plain.yaml").write_text(settings(known), encoding="utf-8")
    one = {"name": "one", "recording": "dive.mcap"}
    maps = []
    for number, more in enumerate(({"localization": "room.yaml"}, {})):
        out = tmp_path / f"out{number}"
        survey = write_survey(tmp_path, dives=[one | more], configuration="plain.yaml", settings={})
        record = run_here(survey, out)
        maps.append(rows_in(out / "map.db"))
        assert record["dives"][0]["pings"] > 20
    config = config_from_text(settings(known, mapping="corrected"))
    map_into_store([tmp_path / "dive.mcap"], config, None, tmp_path / "whole.db")
    assert maps[0] == rows_in(tmp_path / "whole.db") != maps[1]
