"""Whatever happened while mapping live, the recording gives the same map again, bit for bit."""

import asyncio
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from mapperd.cli.mapperd import main
from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.daemon.session import Live
from mapperd.events import EventLog
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.ingest import SONAR, STATUS
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.step import PingResult
from mapperd.session.recordings import files_in, sessions_of
from mapperd.session_log import (
    DECISIONS,
    SESSION,
    ClockSet,
    Drop,
    Gap,
    Reset,
    Settings,
    Skip,
    decision_of,
)
from oculus_driver.command_line import ExitCode
from oculus_driver.encode import encode_dummy, encode_status
from oculus_driver.link.receiver import PingReceiver
from oculus_driver.recording import OCULUS_STATUS, RecordingWriter

MakeBytes = Callable[..., bytes]
START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
ROWS, BEAMS = 300, 256
PINGS = 60


@dataclass
class Event:
    """Something that happens: bytes of a link, or an order. The sonar's gap: a new connection."""

    t_ns: int
    link: str
    data: bytes = b""
    gap: bool = False
    changes: dict[str, Any] | None = None


def settings_text(folder: Path) -> str:
    return (
        "octree: {voxel_resolution: 0.1}\nmounting: {orientation: {pitch: 0}}\n"
        "device: {address: 127.0.0.1}\n"
        "odometry: {sources: [{name: vehicle, link: 'udp://127.0.0.1:52200'}]}\n"
        "behind: {max_wait: 1.0}\n"
        f"recording: {{folder: '{folder}', max_file: 1, free_floor: 0}}\n"
    )


def image_of(chance: Random) -> Any:
    """A rough wall, every beam's at another range."""
    rough = np.random.default_rng(chance.randrange(1 << 30))
    image = np.zeros((ROWS, BEAMS), dtype=np.uint8)
    rows = rough.integers(100, 250, BEAMS)
    for k in range(4):
        image[rows + k, np.arange(BEAMS)] = rough.integers(40, 250, BEAMS)
    return image


def dive(
    chance: Random, ping_bytes: MakeBytes, odometry_bytes: MakeBytes, resets: tuple[int, ...]
) -> Iterator[Event]:
    """Pings cut anywhere, lost connections, noise, silent odometry, changed settings, resets."""
    bearings = np.linspace(-6000, 6000, BEAMS).round().astype(np.int16)
    fields: dict[str, Any] = {"range_resolution_m": 0.02, "bearings_cdeg": bearings}
    fresh, noise = True, Random(PINGS)  # noqa: S311 no secret
    for k in range(PINGS):
        t_ns = START_NS + 100 * k * MS
        data = ping_bytes(k + 1, start_time=50 + 0.1 * k, image=image_of(chance), **fields)
        lost = chance.random() < 0.1
        whole = data[: chance.randrange(1, len(data))] if lost else data
        if lost and noise.random() < 0.3:  # between two messages
            whole = data
        if noise.random() < 0.3:
            whole = encode_dummy(source_id=7) + whole
        if noise.random() < 0.1:
            whole = noise.randbytes(noise.randrange(1, 2000)) + whole
        cuts = sorted(chance.randrange(len(whole)) for _ in range(3))
        for i, (a, b) in enumerate(zip([0, *cuts], [*cuts, len(whole)], strict=True)):
            yield Event(t_ns + i * MS, SONAR, whole[a:b], gap=fresh and i == 0)
            fresh = False
        fresh = lost
        if not 20 < k < 30 or k % 4 == 0:
            pose = odometry_bytes(p=(0.02 * k, 0.01 * k, 0.0))
            yield Event(t_ns + 20 * MS, "vehicle", pose, gap=chance.random() < 0.05)
        if chance.random() < 0.1:
            changes = {"filtering.intensity_threshold": chance.randrange(20, 120)}
            changes |= {"processing.frame_skip": chance.choice([1, 1, 2, 3])}
            yield Event(t_ns + 30 * MS, "settings", changes=changes)
        if k % 10 == 0:
            yield Event(t_ns + 25 * MS, STATUS, encode_status(device_id=k))
        if k in resets:
            yield Event(t_ns + 40 * MS, "reset")


def slow_steps(live: Live, clock: list[int], step_ns: int) -> None:
    """Let each ping take a while, by a clock that else follows the arrivals."""
    executor = live.mapping.pipeline.executor
    map_ping = executor.map_ping

    def slow(posed: PosedPing) -> PingResult | None:
        clock[0] += step_ns
        return map_ping(posed)

    executor.map_ping = slow  # type: ignore[method-assign]


def is_busy(live: Live) -> bool:
    return bool(live.queue.waiting_bytes or len(live.mapping.backlog))


def mapped_live(
    config: Config, events: list[Event], *, at_once: float, step_ns: int, room: int
) -> tuple[SonarMap, PipelineCounters]:
    """Map as the daemon does, the links left out.

    Args:
        config: the settings.
        events: what comes in.
        at_once: share of it that comes before the first ping is mapped.
        step_ns: what a step takes, by a clock that else follows the arrivals.
        room: bytes that may wait for the mapping thread.
    """
    store, sonar_map, clock = ConfigStore(Layered(config)), SonarMap(config), [START_NS]
    live = Live(sonar_map, OdometryPoses(config), session="abc", clock=lambda: clock[0])
    live.queue._limit = room
    driver = PingReceiver()
    slow_steps(live, clock, step_ns)
    store.follow(PingExecutor.FOLLOWS, live.reconfigure)

    async def work() -> None:
        async with live.recorder:
            live.ingest.order(live._beginning())
            for k, event in enumerate(events):
                if k == round(at_once * len(events)):
                    live.mapping.start()
                started = k >= round(at_once * len(events))
                while started and clock[0] < event.t_ns and is_busy(live):  # noqa: ASYNC110
                    await asyncio.sleep(0.001)
                clock[0] = max(clock[0], event.t_ns)
                if event.link == "settings":
                    assert isinstance(store.apply(event.changes or {}, "test"), Applied)
                elif event.link == "reset":
                    live.ingest.order(Reset(k, "test"))
                elif event.link == SONAR:
                    if event.gap:
                        driver.finish()
                        live._is_new_connection = True
                    driver.feed(event.data, event.t_ns)
                    live._receive_sonar(event.data, event.t_ns, driver.framing)
                else:
                    live.ingest.receive(event.link, event.data, event.t_ns, gap=event.gap)
            while is_busy(live):  # noqa: ASYNC110
                await asyncio.sleep(0.01)  # at the end nothing is dropped any more
            live.queue.close()
            await asyncio.to_thread(live.mapping.join)
        assert live.mapping.failure is None

    asyncio.run(work())
    return sonar_map, live.counters


def replayed(folder: Path, out: Path) -> dict[str, Any]:
    words = ["--replay", str(folder), "--as-recorded", "--out", str(out)]
    assert main(words) == ExitCode.OK
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return summary


def kinds_in(folder: Path) -> set[type]:
    (session,) = sessions_of(files_in([folder]))
    return {type(decision_of(chunk)) for chunk in session if chunk.encoding == DECISIONS}


@pytest.mark.usefixtures("no_picture")
@pytest.mark.parametrize("seed", range(6))
def test_recording_gives_the_map_again(
    seed: int, tmp_path: Path, ping_bytes: MakeBytes, odometry_bytes: MakeBytes
) -> None:
    chance = Random(seed)  # noqa: S311 no secret
    folder = tmp_path / "recordings"
    config = config_from_text(settings_text(folder))
    resets = (1,) if seed % 2 else (17, 40)
    events = list(dive(chance, ping_bytes, odometry_bytes, resets))
    at_once, step_ns = chance.uniform(0.3, 0.9), chance.randrange(50, 500) * MS
    room = 64 << 20 if seed < 3 else 1 << 20
    sonar_map, counters = mapped_live(config, events, at_once=at_once, step_ns=step_ns, room=room)
    summary = replayed(folder, tmp_path / "out")
    assert summary["recording"]["files"] > 2
    assert summary["pings_dropped"] == counters.pings_dropped
    assert summary["pings_mapped"] == counters.pings_mapped > 3
    assert summary["pings_total"] == counters.pings_total
    assert summary["bytes_total"] == counters.bytes_total
    assert summary["bytes_rejected"] == counters.bytes_rejected > 0
    assert summary["resyncs"] == counters.resyncs
    assert summary["map_sha256"] == sonar_map.sha256()
    kinds = kinds_in(folder)
    assert kinds >= {Gap, Settings, Reset, Drop}
    assert (Skip in kinds) == (room < 64 << 20)


def test_statuses_of_the_sonar_are_recorded(tmp_path: Path) -> None:
    config = config_from_text(settings_text(tmp_path / "recordings"))
    live = Live(SonarMap(config), OdometryPoses(config), session="abc", clock=lambda: START_NS)
    status = encode_status(device_id=7)

    async def work() -> None:
        async with live.recorder:
            live.ingest.order(live._beginning())
            assert live.sonar._on_status is not None
            live.sonar._on_status(status, START_NS)

    asyncio.run(work())
    (session,) = sessions_of(files_in([tmp_path / "recordings"]))
    recorded = [chunk for chunk in session if chunk.encoding == OCULUS_STATUS]
    assert [(chunk.link, chunk.arrival_ns, chunk.data) for chunk in recorded] == [
        (STATUS, START_NS, status)
    ]


def test_a_clock_that_is_set_is_recorded_and_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offset_ns = [START_NS]
    monkeypatch.setattr("mapperd.daemon.session.unix_offset_ns", lambda: offset_ns[0])
    monkeypatch.setattr("mapperd.daemon.session.CLOCK_INTERVAL_S", 0.0)
    config = config_from_text(settings_text(tmp_path / "recordings"))
    events = EventLog(lambda: START_NS)
    poses, clock = OdometryPoses(config), lambda: START_NS
    live = Live(SonarMap(config), poses, session="abc", clock=clock, events=events)

    async def work() -> None:
        async with live.recorder:
            live.ingest.order(live._beginning())
            watching = asyncio.create_task(live._watch_clock())
            for change_ns in (0, 100 * MS, 3600_000 * MS, 100 * MS):
                offset_ns[0] += change_ns
                await asyncio.sleep(0.02)
            watching.cancel()

    asyncio.run(work())
    (session,) = sessions_of(files_in([tmp_path / "recordings"]))
    decisions = [decision_of(chunk) for chunk in session]
    assert [one for one in decisions if isinstance(one, ClockSet)] == [ClockSet(3600_100 * MS)]
    assert [event.code for event in events.since(0)[0]] == ["clock_set"]


def short_session(sonar_map: SonarMap, session: str, pings: list[bytes], pose: Pose) -> None:
    """A vehicle that stands still hears a few pings."""
    live = Live(sonar_map, FixedPose(pose), session=session, clock=lambda: START_NS)

    async def work() -> None:
        async with live.recorder:
            live.ingest.order(live._beginning())
            live.mapping.start()
            for k, data in enumerate(pings):
                live.ingest.receive(SONAR, data, START_NS + 100 * k * MS, gap=False)
            live.queue.close()
            await asyncio.to_thread(live.mapping.join)

    asyncio.run(work())
    assert live.mapping.failure is None


@pytest.mark.usefixtures("no_picture")
def test_sessions_of_a_folder_go_into_one_map(tmp_path: Path, ping_bytes: MakeBytes) -> None:
    folder = tmp_path / "recordings"
    config = config_from_text(settings_text(folder))
    sonar_map = SonarMap(config)
    for session, x_m in (("one", 0.0), ("two", 2.0)):
        pings = [ping_bytes(k) for k in range(1, 4)]  # the sonar started again as well
        short_session(sonar_map, session, pings, pose_from_rpy((x_m, 0, 0), (0, 0, 30)))
    (folder / "dive_000099_20261122T000000Z.mcap").touch()  # who was killed before the first byte,
    RecordingWriter(folder / "dive_000100_20261122T000001Z.mcap", metadata={SESSION: "x"}).close()
    summary = replayed(folder, tmp_path / "out")
    assert summary["map_sha256"] == sonar_map.sha256()
    assert (summary["recording"]["sessions"], summary["pings_mapped"]) == (2, 6)


@pytest.mark.usefixtures("no_picture")
@pytest.mark.parametrize("size", [0, 1, 8, 300])
def test_recording_that_a_kill_cut_at_its_first_bytes_is_passed_over(
    size: int, tmp_path: Path, ping_bytes: MakeBytes
) -> None:
    folder = tmp_path / "recordings"
    sonar_map = SonarMap(config_from_text(settings_text(folder)))
    still = pose_from_rpy((0, 0, 0), (0, 0, 30))
    short_session(sonar_map, "one", [ping_bytes(k) for k in range(1, 4)], still)
    [whole] = folder.iterdir()
    (folder / "dive_000002_20261122T040000Z.mcap").write_bytes(whole.read_bytes()[:size])
    summary = replayed(folder, tmp_path / "out")
    assert summary["map_sha256"] == sonar_map.sha256()
    assert (summary["recording"]["sessions"], summary["pings_mapped"]) == (1, 3)


def test_session_without_its_beginning_cannot_be_mapped_as_recorded(
    tmp_path: Path, ping_bytes: MakeBytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "raw.bin").write_bytes(ping_bytes(1))
    words = ["--replay", str(tmp_path / "raw.bin"), "--as-recorded", "--out", str(tmp_path)]
    assert main(words) == ExitCode.USAGE
    assert "raw.bin " in capsys.readouterr().err


@pytest.mark.usefixtures("no_picture")
def test_end_is_not_put_off_for_ever(
    tmp_path: Path, ping_bytes: MakeBytes, odometry_bytes: MakeBytes
) -> None:
    folder = tmp_path / "recordings"
    config = config_from_text(settings_text(folder))
    events = [Event(START_NS + k * MS, SONAR, ping_bytes(k + 1)) for k in range(8)]
    events.append(Event(START_NS + 9 * MS, "vehicle", odometry_bytes()))
    events.append(Event(START_NS + 9 * MS, "vehicle", odometry_bytes()))
    step_ns = 4000 * MS  # nothing is settled before the end: there ten seconds are for three pings
    sonar_map, counters = mapped_live(config, events, at_once=0.0, step_ns=step_ns, room=64 << 20)
    assert counters.pings_dropped["too_slow"] > 0
    assert replayed(folder, tmp_path / "out")["map_sha256"] == sonar_map.sha256()
