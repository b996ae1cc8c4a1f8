"""Whatever the name, nothing is written outside of the folder for maps."""

import os
import threading
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mapperd.api import OperationError
from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore
from mapperd.daemon.map_folder import MapFolder, checked_name
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap


@pytest.fixture
def folder(tmp_path: Path) -> MapFolder:
    return MapFolder(tmp_path / "state" / "maps", ConfigStore(Layered()), clock=lambda: 1.0)


def test_map_is_saved_and_reported(folder: MapFolder, sonar_map: SonarMap) -> None:
    reported = folder.save("Ålesund 2.ply", lambda: sonar_map)
    path = folder.folder / "Ålesund 2.ply"
    assert reported == {"path": str(path), "bytes": path.stat().st_size, "seconds": 0.0}


def test_both_files_of_a_grid_are_counted(folder: MapFolder, sonar_map: SonarMap) -> None:
    reported = folder.save("a.pgm", lambda: sonar_map)
    files = [folder.folder / "a.pgm", folder.folder / "a.yaml"]
    assert reported["bytes"] == sum(file.stat().st_size for file in files)
    assert sorted(folder.folder.iterdir()) == files


@pytest.mark.parametrize(
    "name",
    [
        "../a.ply", "/etc/a.ply", "a/b.ply", "..", ".", "", ".ply", ".hidden.ply", "-rf.ply",
        "a\\b.ply", "a\0.ply", "a\n.ply", "a.ply\n", "~/a.ply", "$HOME.ply", "a:b.ply",
        "a" * 300 + ".ply", "å" * 150 + ".ply", "a.ply/", "\udce9.ply", "a;b.ply", "\u202ea.ply",
    ],
)  # fmt: skip
def test_bad_name_is_refused(folder: MapFolder, sonar_map: SonarMap, name: str) -> None:
    with pytest.raises(OperationError) as caught:
        folder.save(name, lambda: sonar_map)
    assert caught.value.reason == "bad_name"
    assert not folder.folder.exists()
    assert str(caught.value).isprintable()


@given(st.text(max_size=40) | st.text("./\\ab ply\0\n", max_size=20), st.sampled_from(["", ".ply"]))
@example("a", ".ply")
def test_name_that_is_accepted_is_a_name_in_the_folder(stem: str, suffix: str) -> None:
    name = stem + suffix
    try:
        checked = checked_name(name)
    except OperationError:
        assert name != "a.ply"
        return
    assert checked == name
    assert is_inside(checked)


def is_inside(name: str) -> bool:
    joined = Path("/state/maps") / name
    return Path(os.path.normpath(joined)) == joined and joined.parent == Path("/state/maps")


def test_unknown_format_is_refused(folder: MapFolder, sonar_map: SonarMap) -> None:
    with pytest.raises(OperationError, match=r"\.bt \.ot \.ply") as caught:
        folder.save("a.exe", lambda: sonar_map)
    assert caught.value.reason == "bad_format"


@pytest.mark.parametrize("planted", ["a.ply", ".a.ply.partial"])
def test_planted_link_is_replaced_and_not_followed(
    folder: MapFolder, sonar_map: SonarMap, tmp_path: Path, planted: str
) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious", encoding="utf-8")
    folder.folder.mkdir(parents=True)
    (folder.folder / planted).symlink_to(victim)
    folder.save("a.ply", lambda: sonar_map)
    assert victim.read_text(encoding="utf-8") == "precious"
    assert not (folder.folder / "a.ply").is_symlink()
    assert [path.name for path in folder.folder.iterdir()] == ["a.ply"]


def test_what_cannot_be_written_leaves_what_was_there(
    folder: MapFolder, sonar_map: SonarMap
) -> None:
    (folder.folder / "a.ply").mkdir(parents=True)
    with pytest.raises(OperationError) as caught:
        folder.save("a.ply", lambda: sonar_map)
    assert caught.value.reason == "cannot_write"
    assert [path.name for path in folder.folder.iterdir()] == ["a.ply"]


def test_store_that_cannot_be_read_is_reported(folder: MapFolder) -> None:
    def unreadable() -> SonarMap:
        raise StoreError("the disk is gone", "io_error")

    with pytest.raises(OperationError, match="the disk is gone") as caught:
        folder.save("a.ply", unreadable)
    assert caught.value.reason == "cannot_write"


def test_one_at_a_time(folder: MapFolder, sonar_map: SonarMap) -> None:
    begun, resume = threading.Event(), threading.Event()

    def slow() -> SonarMap:
        begun.set()
        assert resume.wait(60)
        return sonar_map

    first = threading.Thread(target=folder.save, args=("a.ply", slow))
    first.start()
    assert begun.wait(60)
    with pytest.raises(OperationError) as caught:
        folder.save("b.ply", lambda: sonar_map)
    resume.set()
    first.join()
    assert caught.value.reason == "busy"
    folder.save("b.ply", lambda: sonar_map)
    assert sorted(path.name for path in folder.folder.iterdir()) == ["a.ply", "b.ply"]


def test_heights_of_the_grids_can_change_meanwhile(tmp_path: Path, sonar_map: SonarMap) -> None:
    settings = ConfigStore(Layered())
    folder = MapFolder(tmp_path, settings)
    applied = settings.apply({"export.min_z": -8.0, "export.max_z": -6.5}, "test")
    assert isinstance(applied, Applied)
    folder.save("low.asc", lambda: sonar_map)
    assert b"-7.8750" in (tmp_path / "low.asc").read_bytes()
    assert b"-6.1250" not in (tmp_path / "low.asc").read_bytes()
