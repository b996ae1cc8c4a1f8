"""A survey's map is that of one ordinary replay, brick by brick, to the bit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mapper_survey.request import read_survey
from mapper_survey.spool import NO_TIME, ROW
from mapper_survey.tiles import ordinals_of

from mapperd.config.tree import Config
from mapperd.geometry.motion import PingMotion
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.decoder import PosedPing
from mapperd.session.recordings import sessions_of
from mapperd.session.replay import Window, as_asked
from mapperd.session.replay_to_store import map_into_store
from mapperd.store.tile_store import TileStore
from tests.tools.mapper_survey.dives import (
    SETTINGS,
    revision_of,
    rows_in,
    run_here,
    write_dive,
    write_survey,
)


class Caught(SonarMap):
    """Keeps what would be integrated, with its time."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.t_ns: int | None = None
        self.pings: list[tuple[Any, ...]] = []

    def integrate(self, echo: Any, map_T_sonar: Any, motion: PingMotion | None = None) -> Any:  # noqa: N803
        self.pings.append((self.t_ns, echo, map_T_sonar, motion))
        return super().integrate(echo, map_T_sonar, motion)


def caught(path: Path, config: Config) -> list[tuple[Any, ...]]:
    (session,) = sessions_of([path])
    sonar_map = Caught(config)
    replay = as_asked(session, None, config).replay(sonar_map, Window())

    def note(posed: PosedPing) -> None:
        sonar_map.t_ns = posed.t_ns

    replay.on_posed = note
    for _ in replay.run(session):
        pass
    return sonar_map.pings


def turned(ping: tuple[Any, ...], transform: Any) -> tuple[Any, ...]:
    """A ping in the survey's frame."""
    t_ns, echo, dive_T_sonar, motion = ping  # noqa: N806
    moved = PingMotion(
        transform[:3, :3] @ motion.linear_mps,
        motion.angular_radps,
        motion.valid_s,
        motion.speed_of_sound_mps,
    )
    return t_ns, echo, transform @ dive_T_sonar, moved


def replayed(survey: Path, path: Path) -> int:
    """All pings by time into one ordinary map's file, in this process; returns how many."""
    request = read_survey(survey)
    pings = []
    for dive in request.survey.dives:
        found = caught(request.path_of(dive), request.config)
        frame = dive.transform
        pings += found if frame is None else [turned(ping, frame.matrix()) for ping in found]
    pings.sort(key=lambda ping: ping[0])
    sonar_map = SonarMap(request.config)
    with TileStore(path, sonar_map, tile_size_m=6.4, cache_tiles=4) as store:
        for _, *ping in pings:
            sonar_map.integrate(*ping)
            store.advance(b"")
    return len(pings)


@pytest.mark.parametrize("integrator", ["evidence_grid", "rays"])
def test_two_dives_at_the_same_time_are_one_map(tmp_path: Path, integrator: str) -> None:
    settings = SETTINGS | {"mapping": {"integrator": integrator, "within_ping_motion": True}}
    survey = write_survey(tmp_path, settings=settings, tile_size_m=12.8)
    record = run_here(survey, tmp_path / "out", by_dive=True)
    pings = replayed(survey, tmp_path / "whole.db")
    found = rows_in(tmp_path / "out/map.db")
    assert found == rows_in(tmp_path / "whole.db")
    assert len(found) >= 16
    assert record["pings"] == revision_of(tmp_path / "out/map.db") == pings == 60
    assert record["maps"][0]["tiles"] >= 6
    for name in "ab":
        alone = rows_in(tmp_path / f"out/dives/{name}.db")
        assert {row[:3] for row in alone} < {row[:3] for row in found}


def test_dives_one_after_the_other_are_what_the_daemon_makes_of_them(tmp_path: Path) -> None:
    dives = [{"name": name, "recording": f"{name}.mcap"} for name in "ba"]
    survey = write_survey(tmp_path, dives=dives)
    write_dive(tmp_path / "b.mcap", 2, begin_s=60.0, y=3.0)
    run_here(survey, tmp_path / "out", by_dive=True)
    config = read_survey(survey).config
    for name in "ab":
        map_into_store([tmp_path / f"{name}.mcap"], config, None, tmp_path / "whole.db")
    map_into_store([tmp_path / "b.mcap"], config, None, tmp_path / "b.db")
    assert rows_in(tmp_path / "out/map.db") == rows_in(tmp_path / "whole.db")
    assert rows_in(tmp_path / "out/dives/b.db") == rows_in(tmp_path / "b.db")


@pytest.mark.slow
def test_the_size_of_tiles_changes_nothing(tmp_path: Path) -> None:
    maps = []
    for size_m in (6.4, 25.6, 400.0):
        survey = write_survey(tmp_path, tile_size_m=size_m)
        record = run_here(survey, tmp_path / "out")
        maps.append((record["maps"][0]["tiles"], rows_in(tmp_path / "out/map.db")))
    (many, first), (some, second), (few, third) = maps
    assert many > some > few
    assert first == second == third


def test_a_tile_that_is_too_large_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dives = [
        {"name": name, "recording": f"{name}.mcap", "transform": {"x": 10.0, "y": y, "z": 25.0}}
        for name, y in (("a", 12.0), ("b", 30.0))  # both in one tile
    ]
    survey = write_survey(tmp_path, tile_size_m=51.2, dives=dives)
    whole = run_here(survey, tmp_path / "whole")
    most = 1_100_000
    assert whole["maps"][0]["largest_tile_bytes"] > most + 400_000
    monkeypatch.setattr("mapper_survey.running.voxel_bytes_of", lambda *_: most)
    record = run_here(survey, tmp_path / "cut")
    assert record["tile_bricks"] == whole["tile_bricks"] == 8
    assert record["maps"][0]["tiles_cut"] > 0
    assert most < record["maps"][0]["largest_tile_bytes"] < most + 300_000  # of the last ping
    assert rows_in(tmp_path / "cut/map.db") == rows_in(tmp_path / "whole/map.db")
    again = run_here(survey, tmp_path / "cut")
    assert again["tasks"] == record["tasks"]


@pytest.mark.slow
def test_tiles_asked_for_that_are_too_large_for_a_ping_begin_smaller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    survey = write_survey(tmp_path, tile_size_m=204.8)
    whole = run_here(survey, tmp_path / "whole")
    monkeypatch.setattr("mapper_survey.running.voxel_bytes_of", lambda *_: 700_000)
    record = run_here(survey, tmp_path / "cut")
    assert (whole["tile_bricks"], record["tile_bricks"]) == (32, 1)
    assert rows_in(tmp_path / "cut/map.db") == rows_in(tmp_path / "whole/map.db")


def test_time_order_matters(tmp_path: Path) -> None:
    """The test above would see dives that are mapped one after the other instead."""
    survey = write_survey(tmp_path)
    run_here(survey, tmp_path / "out")
    config = read_survey(survey).config
    sonar_map = SonarMap(config)
    transform = read_survey(survey).survey.dives[1].transform
    assert transform is not None
    second = [turned(ping, transform.matrix()) for ping in caught(tmp_path / "b.mcap", config)]
    with TileStore(tmp_path / "row.db", sonar_map, tile_size_m=6.4, cache_tiles=4) as store:
        for _, *ping in [*caught(tmp_path / "a.mcap", config), *second]:
            sonar_map.integrate(*ping)
            store.advance(b"")
    assert rows_in(tmp_path / "row.db") != rows_in(tmp_path / "out/map.db")


def test_pings_without_a_time_stay_with_the_one_before() -> None:
    def rows(*times: int) -> Any:
        return np.array([(t, 0, 0, (0, 0, 0), (0, 0, 0)) for t in times], dtype=ROW)

    first, second = ordinals_of([rows(10, NO_TIME, 5, 30), rows(NO_TIME, 10, 20)])
    assert first.tolist() == [2, 3, 4, 7]
    assert second.tolist() == [1, 5, 6]
    assert [each.tolist() for each in ordinals_of([rows(), rows(1)])] == [[], [1]]
