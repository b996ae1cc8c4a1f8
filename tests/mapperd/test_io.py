import os
from pathlib import Path

import pytest

from mapperd.errors import ExportError
from mapperd.io import atomic_file, lock_file, make_folder


def test_file_appears_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with atomic_file(path) as file:
        file.write(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_failure_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def fail() -> None:
        with atomic_file(path) as file:
            file.write(b"half of it")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="missing"), atomic_file(tmp_path / "missing" / "a"):
        pass


def test_folder_is_made_with_its_parents(tmp_path: Path) -> None:
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []


def test_file_in_the_way_of_a_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ExportError, match="file"):
        make_folder(tmp_path / "file")


def test_a_lock_holds_until_its_handle_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    handle = lock_file(path, mode=0o640)
    assert path.stat().st_mode & 0o777 == 0o640
    open_handles = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(BlockingIOError):
        lock_file(path)
    assert len(list(Path("/proc/self/fd").iterdir())) == open_handles
    os.close(handle)
    os.close(lock_file(path, wait=True))


def test_a_folder_can_be_locked_and_a_link_refused(tmp_path: Path) -> None:
    os.close(lock_file(tmp_path, os.O_RDONLY))
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="link"):
        lock_file(tmp_path / "link", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW)
    assert not (tmp_path / "elsewhere").exists()
