import importlib.util
import json
import os
import random
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mapperd.cli.mapperd import main
from mapperd.config.tree import Config
from mapperd.store.map_files import map_in
from mapperd.store.tile_store import TileStore
from oculus_driver.command_line import ExitCode

Write = Callable[..., list[int]]
Survey = Callable[..., list[Any]]

KEYS = {
    "pings_total",
    "pings_mapped",
    "pings_dropped",
    "bytes_rejected",
    "voxels_occupied",
    "voxels_free",
    "voxel_resolution_m",
    "ms_per_ping",
    "wall_s",
    "map_sha256",
    "integrator",
    "config",
    "version",
    "poses",
    "recording",
}
STILL = "--pose=0,0,0,0,0,0"


@pytest.fixture
def recording(tmp_path: Path, write_recording: Write, survey: Survey) -> Path:
    path = tmp_path / "capture.bin"
    write_recording(path, survey(5))
    return path


def summary_in(folder: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    dropped = sum(summary["pings_dropped"].values())
    assert summary["pings_total"] == summary["pings_mapped"] + dropped
    return summary


def test_recording_becomes_a_folder_of_results(
    recording: Path, quick_config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "deep" / "out"
    words = ["--replay", str(recording), "--config", str(quick_config), "--out", str(out)]
    assert main(words) == ExitCode.OK
    assert {path.name for path in out.iterdir()} == {
        "map.bt",
        "map.ply",
        "map.png",
        "trajectory.csv",
        "trajectory.tum",
        "summary.json",
    }
    summary = summary_in(out)
    assert set(summary) >= KEYS
    assert summary["pings_mapped"] == 5
    assert summary["voxels_occupied"] > 0
    assert summary["voxel_resolution_m"] == 0.2
    assert summary["integrator"] == "evidence_grid"
    assert summary["poses"]["odometry_accepted"] == 6
    assert (out / "map.bt").read_bytes().startswith(b"# Octomap OcTree binary file")
    assert (
        f"element vertex {summary['voxels_occupied']}\n".encode() in (out / "map.ply").read_bytes()
    )
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")
    assert "mapped 5 of 5 pings" in capsys.readouterr().out


@pytest.mark.usefixtures("no_picture")
def test_replay_refines_the_map_on_request(
    recording: Path, quick_config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = quick_config.read_text(encoding="utf-8")
    assert "mapping:" not in text
    config = tmp_path / "arc.yaml"
    config.write_text(f"{text}mapping: {{rule: arc}}\n", encoding="utf-8")
    summaries = []
    for name, more in (("once", []), ("again", ["--refine"])):
        words = ["--replay", str(recording), "--config", str(config), *more]
        assert main([*words, "--out", str(tmp_path / name)]) == ExitCode.OK
        summaries.append(summary_in(tmp_path / name))
    once, again = summaries
    assert "pings_refined" not in once
    assert again["pings_refined"] == again["pings_mapped"] == once["pings_mapped"] == 5
    assert again["map_sha256"] != once["map_sha256"]
    files = [{path.name for path in (tmp_path / name).iterdir()} for name in ("once", "again")]
    assert files[1] - files[0] == {"map.map"}
    assert map_in(tmp_path / "again" / "map.map", Config()).map.sha256() == again["map_sha256"]
    capsys.readouterr()
    words = ["--replay", str(recording), "--config", str(quick_config), "--refine"]
    assert main([*words, "--out", str(tmp_path / "no")]) == ExitCode.USAGE
    [line] = capsys.readouterr().err.splitlines()[-1:]
    assert "--refine" in line
    assert "rule: arc" in line
    disk = tmp_path / "disk.yaml"
    disk.write_text(f"{config.read_text()}outofcore: {{use: true}}\n", encoding="utf-8")
    words = ["--replay", str(recording), "--config", str(disk), "--refine"]
    assert main([*words, "--out", str(tmp_path / "disk")]) == ExitCode.OK
    assert summary_in(tmp_path / "disk")["map_sha256"] == again["map_sha256"]


@pytest.mark.slow
def test_two_runs_give_one_fingerprint_and_integrators_two(
    recording: Path, quick_config: Path, tmp_path: Path
) -> None:
    prints = []
    for name, more in (("a", []), ("b", []), ("c", ["--integrator", "rays"])):
        words = ["--replay", str(recording), "--config", str(quick_config)]
        assert main([*words, "--out", str(tmp_path / name), *more]) == ExitCode.OK
        summary = summary_in(tmp_path / name)
        prints.append((summary["map_sha256"], summary["integrator"]))
    assert prints[0] == prints[1]
    assert prints[2][0] != prints[0][0]
    assert prints[2][1] == "rays"


@pytest.mark.usefixtures("no_picture")
def test_replay_with_the_map_on_disk_gives_the_same_results(
    recording: Path, quick_config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []

    class Opened(TileStore):
        def __init__(self, path: Path, *args: object, **more: object) -> None:
            opened.append(path)
            super().__init__(path, *args, **more)  # type: ignore[arg-type]

    monkeypatch.setattr("mapperd.cli.replay.TileStore", Opened)
    config = tmp_path / "disk.yaml"
    text = quick_config.read_text(encoding="utf-8")
    config.write_text(f"{text}outofcore: {{use: true, cache_size: 1}}\n", encoding="utf-8")
    for name, settings in (("memory", quick_config), ("disk", config)):
        words = ["--replay", str(recording), "--config", str(settings)]
        assert main([*words, "--out", str(tmp_path / name)]) == ExitCode.OK
    assert [path.parent.parent for path in opened] == [tmp_path / "disk"]
    memory, disk = summary_in(tmp_path / "memory"), summary_in(tmp_path / "disk")
    assert memory.keys() == disk.keys()
    for key in ("map_sha256", "voxels_occupied", "voxels_free", "pings_mapped"):
        assert disk[key] == memory[key]
    names = [sorted(path.name for path in (tmp_path / at).iterdir()) for at in ("memory", "disk")]
    assert names[0] == names[1]
    for name in ("map.bt", "map.ply"):
        assert (tmp_path / "disk" / name).read_bytes() == (tmp_path / "memory" / name).read_bytes()


@pytest.mark.usefixtures("no_picture")
def test_settings_of_an_earlier_version_are_reported_once(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "old.yaml"
    config.write_text(
        "octree: {voxel_resolution: 0.2}\n"
        "mapping: {integrator: projective, error_bound: 0.1}\nbehind: {policy: drop_oldest}\n",
        encoding="utf-8",
    )
    words = ["--replay", str(recording), "--config", str(config), "--out", str(tmp_path / "out")]
    assert main(words) == ExitCode.OK
    reported = [line for line in capsys.readouterr().err.splitlines() if str(config) in line]
    assert len(reported) == 1
    for name in ("mapping.error_bound", "mapping.integrator", "behind.policy"):
        assert name in reported[0]


def test_window_is_taken_from_the_command_line(
    recording: Path, quick_config: Path, tmp_path: Path
) -> None:
    words = ["--replay", str(recording), "--config", str(quick_config), "--out", str(tmp_path)]
    assert main([*words, "--start", "0.1", "--duration", "0.2"]) == ExitCode.OK
    assert summary_in(tmp_path)["pings_total"] == 2


def test_pose_on_the_command_line_overrules_odometry_and_is_reported(
    recording: Path, quick_config: Path, tmp_path: Path
) -> None:
    words = ["--replay", str(recording), "--config", str(quick_config), "--out", str(tmp_path)]
    assert main([*words, "--pose", "-1,2,3,0,0,0"]) == ExitCode.OK
    assert summary_in(tmp_path)["poses"] == {"source": "fixed", "odometry_ignored": 6}


@pytest.mark.slow
def test_program_runs_as_a_module(recording: Path, quick_config: Path, tmp_path: Path) -> None:
    words = ["--replay", str(recording), "--config", str(quick_config), "--out", str(tmp_path)]
    done = subprocess.run(  # noqa: S603 our own program
        [sys.executable, "-m", "mapperd", *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert "mapped 5 of 5" in done.stdout
    assert "Traceback" not in done.stderr


def test_missing_matplotlib_costs_the_picture_only(
    recording: Path,
    quick_config: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    out = tmp_path / "out"
    words = ["--replay", str(recording), "--config", str(quick_config), "--out", str(out)]
    assert main(words) == ExitCode.OK
    assert "`topside`" in capsys.readouterr().err
    assert not (out / "map.png").exists()
    assert (out / "map.ply").exists()


@pytest.mark.slow
def test_broken_matplotlib_costs_the_picture_only(
    recording: Path, quick_config: Path, tmp_path: Path
) -> None:
    broken = tmp_path / "site" / "matplotlib"
    broken.mkdir(parents=True)
    (broken / "__init__.py").write_text("raise ImportError('numpy is too new')", encoding="utf-8")
    out = tmp_path / "out"
    words = ["--replay", str(recording), "--config", str(quick_config), "--out", str(out)]
    done = subprocess.run(  # noqa: S603 our own program
        [sys.executable, "-m", "mapperd", *words],
        env=os.environ | {"PYTHONPATH": str(broken.parent)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == ExitCode.OK, done.stderr
    assert "`topside`" in done.stderr
    assert {path.name for path in out.iterdir()} == {
        "map.bt",
        "map.ply",
        "summary.json",
        "trajectory.csv",
        "trajectory.tum",
    }


def test_interrupt_writes_nothing_and_is_reported(
    recording: Path,
    quick_config: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mapperd.pipeline.executor.process_ping", interrupt)
    out = tmp_path / "out"
    words = ["--replay", str(recording), "--config", str(quick_config), "--out", str(out)]
    assert main(words) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert list(out.iterdir()) == []


@pytest.mark.slow
def test_an_interrupted_replay_into_a_store_names_what_it_holds(
    recording: Path,
    quick_config: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    store = tmp_path / "dive.map"
    words = ["--replay", str(recording), "--config", str(quick_config), "--out", str(tmp_path)]
    words += ["--store", str(store)]

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("mapperd.pipeline.executor.process_ping", interrupt)
        assert main(words) == 130
    errors = capsys.readouterr().err
    assert f"{store} holds the last save; the same command maps the rest" in errors
    assert "nothing was written" not in errors
    assert main(words) == ExitCode.OK


class TestRealCapture:
    """three_pings_8bit.raw: 256 beams, 2 m, no odometry in it."""

    @pytest.fixture
    def capture(self, shared_data: Path) -> bytes:
        return (shared_data / "oculus" / "three_pings_8bit.raw").read_bytes()

    def replay(self, data: bytes, folder: Path) -> dict[str, Any]:
        path = folder / "raw"
        path.write_bytes(data)
        assert main(["--replay", str(path), "--out", str(folder / "out"), STILL]) == ExitCode.OK
        return summary_in(folder / "out")

    def test_all_three_pings_are_mapped(self, capture: bytes, tmp_path: Path) -> None:
        summary = self.replay(capture, tmp_path)
        assert (summary["pings_total"], summary["pings_mapped"]) == (3, 3)
        assert summary["bytes_rejected"] == 0
        assert summary["bytes_total"] == 546048
        assert summary["voxels_occupied"] > 100

    @pytest.mark.parametrize(
        ("start", "pings", "rejected"),
        [
            (1, 2, 182015),
            (634, 2, 181382),
            (1000, 2, 181016),
            (2048, 2, 179968),
            (182015, 2, 1),
            (182017, 1, 182015),
        ],
    )
    def test_cut_beginning_costs_the_first_ping(
        self, capture: bytes, tmp_path: Path, start: int, pings: int, rejected: int
    ) -> None:
        summary = self.replay(capture[start:], tmp_path)
        assert (summary["pings_total"], summary["pings_mapped"]) == (pings, pings)
        assert summary["bytes_rejected"] == rejected

    def test_random_bytes_between_pings_cost_only_themselves(
        self, capture: bytes, tmp_path: Path
    ) -> None:
        noise = random.Random(4).randbytes(777)  # noqa: S311 a test
        summary = self.replay(capture[:182016] + noise + capture[182016:], tmp_path)
        assert summary["pings_mapped"] == 3
        assert summary["bytes_rejected"] == 777
        assert summary["resyncs"] == 1

    def test_random_bytes_inside_a_ping_cost_no_other_ping(
        self, capture: bytes, tmp_path: Path
    ) -> None:
        noise = random.Random(5).randbytes(777)  # noqa: S311 a test
        summary = self.replay(capture[:200_000] + noise + capture[200_000:], tmp_path)
        assert summary["pings_mapped"] == 3
        assert summary["bytes_rejected"] == 777

    @pytest.mark.parametrize(
        ("place", "rejected", "reason"),
        [
            (0, 182016, "bad_magic"),
            (1, 182016, "bad_magic"),
            (6, 0, "unknown_id"),  # a plausible message that nobody knows: stepped over
            (7, 0, "unknown_id"),
            (8, 0, None),  # version 255: stepped over, then no ping
            (13, 182016, "oversize"),  # 4 GB
        ],
    )
    @pytest.mark.slow
    def test_flipped_byte_of_a_header_costs_that_ping_only(
        self, capture: bytes, tmp_path: Path, place: int, rejected: int, reason: str | None
    ) -> None:
        damaged = bytearray(capture)
        damaged[182016 + place] ^= 0xFF
        summary = self.replay(bytes(damaged), tmp_path)
        assert summary["pings_mapped"] == 2
        assert summary["bytes_rejected"] == rejected
        assert summary["resyncs"] == (rejected > 0)
        if reason is not None:
            assert summary["messages_rejected"] == {reason: 1}

    def test_without_a_pose_it_is_refused(
        self, shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        capture = shared_data / "oculus" / "three_pings_8bit.raw"
        assert main(["--replay", str(capture), "--out", str(tmp_path / "out")]) == ExitCode.USAGE
        output = capsys.readouterr().err
        assert "--pose" in output
        assert output.count("\n") == 1
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_journal_knows_an_error_from_a_remark(tmp_path: Path) -> None:
    config = tmp_path / "bad.yaml"
    config.write_text("nope: 1", encoding="utf-8")
    output = tmp_path / "journal"
    with output.open("wb") as stream:
        facts = os.fstat(stream.fileno())
        code = subprocess.call(  # noqa: S603
            [sys.executable, "-m", "mapperd", "--config", str(config), "--out", str(tmp_path)],
            env=os.environ | {"JOURNAL_STREAM": f"{facts.st_dev}:{facts.st_ino}"},
            stderr=stream,
        )
    assert code == ExitCode.BAD_CONFIG
    assert output.read_text(encoding="utf-8").startswith(f"<3>{config}: $.nope: ")


def live(folder: Path, settings: str) -> int:
    """Run the daemon for a moment, without a sonar."""
    path = folder / "live.yaml"
    path.write_text(f"device: {{address: 127.0.0.1, port: 1}}\n{settings}", encoding="utf-8")
    words = ["--config", path, "--out", folder / "out", "--duration", "0.1"]
    return main([str(word) for word in words])


def test_recordings_folder_that_cannot_be_used_is_no_wrong_setting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    settings = f"recording: {{folder: {tmp_path}/file/inside, free_floor: 0}}\n"
    assert live(tmp_path, settings) == ExitCode.CANNOT_WRITE
    assert "recording.folder: " in capsys.readouterr().err
    settings = f"recording: {{folder: {tmp_path}/read-only, free_floor: 0}}\n"
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert live(tmp_path, settings) == ExitCode.CANNOT_WRITE
    assert "no files can be created" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("settings", "library"),
    [
        ("odometry: {sources: [{format: mavlink, link: 'udp://127.0.0.1:1'}]}\n", "pymavlink"),
        ("odometry: {sources: [{format: nmea, link: 'udp://127.0.0.1:1'}]}\n", "pynmea2"),
        (
            "odometry: {sources: [{format: native_serial, link: 'serial:///dev/ttyUSB0:115200'}]}\n",
            "serial",
        ),
        ("mqtt: {host: shore}\n", "aiomqtt"),
    ],
)
def test_extra_that_the_settings_need_is_missed_at_the_start(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    settings: str,
    library: str,
) -> None:
    real = importlib.util.find_spec
    ours = ("mapperd.odometry.mavlink", "mapperd.odometry.mavlink_frames", "mapperd.odometry.nmea")
    for module in list(sys.modules):
        if module.partition(".")[0] == library or module in ours:
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)

    def found(name: str, *more: Any) -> Any:
        return None if name == library else real(name, *more)

    monkeypatch.setattr("importlib.util.find_spec", found)
    monkeypatch.setattr("mapperd.odometry.formats.find_spec", found)
    assert live(tmp_path, settings) == ExitCode.BAD_CONFIG
    (line,) = capsys.readouterr().err.splitlines()
    assert "pip install" in line


@pytest.mark.net
def test_a_replay_is_shown_in_the_browser_until_interrupted(
    recording: Path, quick_config: Path, tmp_path: Path
) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    config = tmp_path / "disk.yaml"
    text = quick_config.read_text(encoding="utf-8")
    config.write_text(f"{text}outofcore: {{use: true}}\n", encoding="utf-8")  # as `init` writes it
    words = ["--replay", recording, "--config", config, "--out", tmp_path / "out"]
    command = [sys.executable, "-m", "mapperd", *map(str, words), "--view", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:  # noqa: S603
        assert process.stderr is not None
        url = ""
        for line in process.stderr:
            url = line.split()[-1] if "the map is shown at" in line else url
            if "until Ctrl-C" in line:
                break
        with urllib.request.urlopen(url, timeout=60) as page:  # noqa: S310 our own
            assert page.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == ExitCode.OK
    assert summary_in(tmp_path / "out")["pings_mapped"] == 5


INTERRUPTED_WHILE_THE_PAGE_OPENS = """
import signal, sys
from mapperd.cli.mapperctl import view
from mapperd.cli.mapperd import main
signal.signal(signal.SIGINT, signal.default_int_handler)

def open_page(*place, opened=view.open_page):
    page = opened(*place)
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        print("lost", file=sys.stderr)  # as in a callback of a weak reference
    return page

view.open_page = open_page
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.net
def test_ctrl_c_while_the_page_opens_ends_the_replay(
    recording: Path, quick_config: Path, tmp_path: Path
) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    words = ["--replay", recording, "--config", quick_config, "--out", tmp_path / "out"]
    command = [sys.executable, "-c", INTERRUPTED_WHILE_THE_PAGE_OPENS, *map(str, words)]
    done = subprocess.run(  # noqa: S603
        [*command, "--view", "0"], stderr=subprocess.PIPE, text=True, timeout=60, check=False
    )
    assert done.returncode == ExitCode.INTERRUPTED
    assert "lost" not in done.stderr
    assert "interrupted" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "hint"),
    [(["--view"], "mapperctl view"), (["--replay", "a", "--store", "b", "--view"], "view MAP")],
)
def test_what_cannot_be_viewed_names_the_alternative(
    words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert (ended.value.code, hint in capsys.readouterr().err) == (ExitCode.USAGE, True)
