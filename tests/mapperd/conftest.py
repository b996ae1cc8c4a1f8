"""Small pings, odometry records, recordings, certificates and folders of sockets."""

import json
import ssl
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trustme

from mapperd.cli.mapperd import main
from mapperd.odometry.native import NativeRecord, encode_native
from oculus_driver.encode import encode_ping
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.recording import RecordingWriter
from oculus_driver.stream import StreamParser

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND
ROWS, BEAMS = 50, 65
WALL_ROW = 30

PingBytes = Callable[..., bytes]
OdometryBytes = Callable[..., bytes]


def make_ping(ping_id: int = 1, **changes: Any) -> bytes:
    """A ping that sees a wall 3 m away: 50 rows of 10 cm, 65 beams over 120 degrees."""
    image = np.zeros((ROWS, BEAMS), dtype=np.uint8)
    image[WALL_ROW : WALL_ROW + 2] = 200
    fields: dict[str, Any] = {
        "ping_id": ping_id,
        "mode": 1,
        "frequency_hz": 750e3,
        "range_m": 5.0,
        "gain_percent": 50.0,
        "speed_of_sound_mps": 1500.0,
        "salinity_ppt": 35.0,
        "start_time": 0.1 * ping_id,
        "range_resolution_m": 0.1,
        "bearings_cdeg": np.linspace(-6000, 6000, BEAMS).round().astype(np.int16),
        "image": image,
        "source_id": 7,
    }
    return encode_ping(**(fields | changes))


def make_odometry(**changes: Any) -> bytes:
    """A record of a vehicle that stands at the origin, stamped by its arrival."""
    fields: dict[str, Any] = {
        "v": 1,
        "clk": "arrival",
        "w": "enu",
        "b": "flu",
        "p": (0.0, 0.0, 0.0),
        "q": (1.0, 0.0, 0.0, 0.0),
    }
    return encode_native(NativeRecord(**(fields | changes)))


@pytest.fixture(autouse=True)
def own_folders(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """A daemon under test keeps nothing in the user's folders, and shares no socket."""
    folder = tmp_path_factory.mktemp("own")
    for name in ("STATE_DIRECTORY", "LOGS_DIRECTORY", "RUNTIME_DIRECTORY"):
        monkeypatch.setenv(name, str(folder))


@pytest.fixture
def short() -> Iterator[Path]:
    """Return a folder whose path leaves room for a socket: 107 bytes at most."""
    with tempfile.TemporaryDirectory(prefix="m") as folder:
        yield Path(folder)


@pytest.fixture(scope="session")
def authority() -> trustme.CA:
    """Return an authority that issues certificates."""
    return trustme.CA()


@pytest.fixture(scope="session")
def tls(authority: trustme.CA) -> tuple[ssl.SSLContext, ssl.SSLContext]:
    """Return the contexts of a server and of a client that trusts it."""
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.issue_cert("localhost", "127.0.0.1").configure_cert(server)
    client = ssl.create_default_context()
    authority.configure_trust(client)
    return server, client


@pytest.fixture(scope="session")
def ping_bytes() -> PingBytes:
    return make_ping


@pytest.fixture(scope="session")
def odometry_bytes() -> OdometryBytes:
    return make_odometry


@pytest.fixture(scope="session")
def ping() -> Callable[..., Ping]:
    def build(ping_id: int = 1, arrival_ns: int | None = START_NS, **changes: Any) -> Ping:
        (message,) = StreamParser().feed(make_ping(ping_id, **changes), arrival_ns)
        decoded = decode_ping(message)
        assert isinstance(decoded, Ping), decoded
        return decoded

    return build


Event = tuple[str, bytes, float | None]


@pytest.fixture(scope="session")
def write_recording() -> Callable[[Path, Iterable[Event]], list[int]]:
    """Write (kind, data, seconds) events; returns the size of the file after each of them."""

    def write(path: Path, events: Iterable[Event]) -> list[int]:
        sizes = []
        with RecordingWriter(path, overwrite=True) as writer:
            links = {
                "ping": writer.add_link("sonar", "oculus"),
                "ping2": writer.add_link("second", "oculus"),
                "odometry": writer.add_link("vehicle", "odometry-native"),
            }
            for kind, data, seconds in events:
                stamp = None if seconds is None else START_NS + round(seconds * SECOND)
                writer.write(links[kind], data, stamp)
                sizes.append(writer.size_bytes)
        return sizes

    return write


@pytest.fixture(scope="session")
def survey() -> Callable[..., list[Event]]:
    """A vehicle on its way forward: odometry at 10 Hz, a ping half way between two records."""

    def events(pings: int = 5, *, pings_from: int = 1) -> list[Event]:
        track: list[Event] = []
        for k in range(pings + 1):
            track.append(("odometry", make_odometry(p=(0.05 * k, 0.0, 0.0)), 0.1 * k))
            if k < pings:
                track.append(("ping", make_ping(pings_from + k), 0.1 * k + 0.05))
        return track

    return events


@pytest.fixture(scope="session")
def quick_config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Coarse voxels and a sonar that looks forward: a ping in milliseconds."""
    path = tmp_path_factory.mktemp("config") / "quick.yaml"
    path.write_text(
        "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n", encoding="utf-8"
    )
    return path


class Ran:
    """What one run of the command did; every ping is accounted for."""

    def __init__(self, code: int, output: str, out: Path) -> None:
        self.code = code
        self.output = output
        self.out = out

    @property
    def summary(self) -> dict[str, Any]:
        summary: dict[str, Any] = json.loads((self.out / "summary.json").read_text("utf-8"))
        dropped = sum(summary["pings_dropped"].values())
        assert summary["pings_total"] == summary["pings_mapped"] + dropped
        return summary


@pytest.fixture
def run(
    tmp_path: Path, quick_config: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Ran]:
    def call(path: Path, *more: str, config: Path = quick_config) -> Ran:
        out = tmp_path / "out"
        words = ["--replay", str(path), "--config", str(config), "--out", str(out), *more]
        code = main(words)
        return Ran(code, capsys.readouterr().err, out)

    return call


@pytest.fixture
def no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hundreds of runs: the picture is drawn elsewhere."""
    monkeypatch.setattr("mapperd.daemon.map_folder.write_picture", lambda *_: None)
