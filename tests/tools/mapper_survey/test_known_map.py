"""A dive is planned again when its localization map changes, wherever it is stored."""

from pathlib import Path

import numpy as np
from mapper_survey.engine import InProcess
from mapper_survey.folder import Folder
from mapper_survey.planning import plan_all
from mapper_survey.request import read_survey

from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore
from tests.mapperd.localization.room import settings, write_room
from tests.tools.mapper_survey.dives import write_survey
from tests.tools.mapper_survey.maps import CONFIG, map_of


def planned_on(folder: Path, known: Path) -> str:
    """Fingerprint of a dive localized on a map; the recording is empty, to be quick."""
    (folder / "plain.yaml").write_text(settings(known), encoding="utf-8")
    dive = {"name": "a", "recording": "none", "localization": known.name}
    survey = write_survey(folder, dives=[dive], configuration="plain.yaml", settings={})
    (folder / "none").mkdir(exist_ok=True)
    (plan,) = plan_all(
        read_survey(survey), Folder(str(folder / "out")), InProcess(), lambda *_: None
    )
    return plan.fingerprint


def voxels_in(path: Path) -> int:
    sonar_map = SonarMap(CONFIG)
    with StoreReader(path) as reader:
        reader.load(sonar_map)
    return sonar_map.counts().occupied


def put(store: TileStore, *voxels: tuple[int, int, int]) -> None:
    (brick,) = map_of(np.array(voxels)).core.bricks_since(0)[1]
    store.restore([(brick[0], brick[2])], whole=True)


def test_what_is_in_the_journal_alone_counts(tmp_path: Path) -> None:
    known = tmp_path / "known.db"
    with TileStore(known, SonarMap(CONFIG), tile_size_m=6.4, cache_tiles=4) as store:
        put(store, (1, 2, 3))
        first = known.stat().st_mtime_ns, voxels_in(known), planned_on(tmp_path, known)
        put(store, (1, 2, 3), (4, 4, 4))
        second = known.stat().st_mtime_ns, voxels_in(known), planned_on(tmp_path, known)
    assert first[0] == second[0]
    assert (first[1], second[1]) == (1, 2)
    assert first[2] != second[2]


def test_looking_into_a_map_changes_nothing(tmp_path: Path) -> None:
    known = tmp_path / "known.db"
    with TileStore(known, SonarMap(CONFIG), tile_size_m=6.4, cache_tiles=4) as store:
        put(store, (1, 2, 3))
    before = planned_on(tmp_path, known)
    voxels_in(known)
    assert (tmp_path / "known.db-wal").exists()
    assert planned_on(tmp_path, known) == before


def test_the_image_of_a_planar_map_counts(tmp_path: Path) -> None:
    known = write_room(tmp_path)
    before = planned_on(tmp_path, known)
    image = known.with_suffix(".pgm")
    image.write_bytes(image.read_bytes()[:-1] + b"\x00")
    assert planned_on(tmp_path, known) != before
