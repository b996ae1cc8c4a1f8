"""Recorded data that fail their checksum are not mapped, and everyone reports what is missing."""

import asyncio
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.daemon.session import Live
from mapperd.errors import Reject
from mapperd.events import EventLog
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PosedPing, SessionDecoder
from mapperd.pipeline.ingest import SONAR
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.session.recordings import DamagedData, Tail, files_in, sessions_of
from mapperd.session.recovery import (
    StoredSession,
    map_recorded_sessions,
    recover,
    replay_sessions,
)
from mapperd.session.startup import open_map
from mapperd.session_log import DECISIONS
from mapperd.store.checkpoint import decode_state, encode_state
from mapperd.store.position import RecordingOffset, position_in
from mapperd.store.tile_store import TileStore
from oculus_driver.command_line import ExitCode
from oculus_driver.recording import OCULUS, Chunk, RecordingWriter

PingBytes = Callable[..., bytes]
Survey = Callable[..., list[Any]]
Run = Callable[..., Any]
START_NS = 1_700_000_000_000_000_000
PINGS = 60
STILL = pose_from_rpy((0, 0, 0), (0, 0, 30))

pytestmark = pytest.mark.usefixtures("no_picture")


def recorded(path: Path, events: Iterable[Any]) -> None:
    """Write a recording."""
    kinds = {"ping": OCULUS, "odometry": "odometry-native"}
    with RecordingWriter(path) as writer:
        links = {kind: writer.add_link(kind, encoding) for kind, encoding in kinds.items()}
        for kind, data, seconds in events:
            writer.write(links[kind], data, START_NS + round(seconds * 1e9))


def altered(path: Path, pings: Iterable[bytes]) -> Path:
    """Return a copy with a changed sample in each of these pings."""
    data = bytearray(path.read_bytes())
    for ping in pings:
        data[data.index(ping) + len(ping) - 1] ^= 0x40
    copy = path.with_name("altered")
    copy.write_bytes(data)
    return copy


def track(survey: Survey) -> list[Any]:
    """Odometry first, then the pings."""
    return sorted(survey(PINGS), key=lambda event: event[0])


def test_altered_pings_are_not_mapped(
    tmp_path: Path, run: Run, survey: Survey, ping_bytes: PingBytes
) -> None:
    recorded(tmp_path / "whole", track(survey))
    ran = run(tmp_path / "whole")
    assert (ran.code, ran.summary["pings_mapped"]) == (ExitCode.OK, PINGS)
    every = [ping_bytes(k + 1) for k in range(PINGS)]
    ran = run(altered(tmp_path / "whole", every))
    assert ran.code == ExitCode.BAD_DATA
    assert ran.summary["pings_dropped"] == {"checksum": PINGS}
    assert "fail their checksum" in ran.output


def test_the_rest_of_a_damaged_recording_is_mapped_and_the_loss_is_listed(
    tmp_path: Path, run: Run, survey: Survey, ping_bytes: PingBytes
) -> None:
    events = track(survey)
    recorded(tmp_path / "whole", events)
    whole = run(tmp_path / "whole").summary
    changed = [ping_bytes(9), ping_bytes(10), ping_bytes(30)]
    damaged = altered(tmp_path / "whole", changed)
    ran = run(damaged)
    summary, facts = ran.summary, ran.summary["recording"]
    assert ran.code == ExitCode.BAD_DATA
    assert (summary["pings_mapped"], summary["pings_dropped"]) == (PINGS - 3, {"checksum": 3})
    assert summary["pings_lost"] == 0
    assert [part["file"] for part in facts["damaged_parts"]] == ["altered"] * 3
    assert facts["damaged_bytes"] == sum(part["bytes"] for part in facts["damaged_parts"])
    offset, size = (facts["damaged_parts"][0][key] for key in ("offset", "bytes"))
    assert offset < damaged.read_bytes().index(ping_bytes(9)[:-1]) < offset + size
    assert f"altered byte {offset}" in ran.output
    assert "were not mapped" in ran.output

    recorded(tmp_path / "rest", [event for event in events if event[1] not in changed])
    assert run(tmp_path / "rest").summary["map_sha256"] == summary["map_sha256"]

    ran = run(damaged, "--allow-damaged")
    assert (ran.code, ran.summary["pings_mapped"]) == (ExitCode.OK, PINGS)
    assert ran.summary["map_sha256"] not in (whole["map_sha256"], summary["map_sha256"])
    assert "were mapped all the same" in ran.output


def test_a_replay_into_a_store_leaves_altered_pings_out(
    tmp_path: Path, run: Run, survey: Survey, ping_bytes: PingBytes
) -> None:
    recorded(tmp_path / "whole", track(survey))
    damaged = altered(tmp_path / "whole", [ping_bytes(9)])
    ran = run(damaged, "--store", str(tmp_path / "map.db"))
    assert ran.code == ExitCode.BAD_DATA
    assert ran.summary["pings_dropped"] == {"checksum": 1}
    assert ran.summary["map_sha256"] == run(damaged).summary["map_sha256"]


@pytest.mark.parametrize("stored", [False, True])
def test_a_damaged_record_head_ends_in_a_statement(
    stored: bool,  # noqa: FBT001 a parameter of the test
    tmp_path: Path,
    run: Run,
    survey: Survey,
    ping_bytes: PingBytes,
) -> None:
    recorded(tmp_path / "whole", track(survey))
    data = bytearray((tmp_path / "whole").read_bytes())
    end = data.index(ping_bytes(9))
    start = data.rindex(b"\x06", 0, data.rindex(b"\x05", 0, end - 22))
    data[start] = 0x0B  # a chunk of pings looks like statistics
    (tmp_path / "altered").write_bytes(data)
    ran = run(tmp_path / "altered", *(["--store", str(tmp_path / "map.db")] if stored else []))
    assert (ran.code, ran.summary["recording"]["data_lost"]) == (ExitCode.BAD_DATA, True)
    assert "damaged at byte" in ran.output


def test_altered_odometry_is_not_used(
    tmp_path: Path, run: Run, survey: Survey, odometry_bytes: PingBytes
) -> None:
    recorded(tmp_path / "whole", survey(PINGS))
    data = bytearray((tmp_path / "whole").read_bytes())
    record = odometry_bytes(p=(0.05 * 20, 0.0, 0.0))
    data[data.index(record) + 15] ^= 1
    (tmp_path / "altered").write_bytes(data)
    ran = run(tmp_path / "altered")
    assert ran.code == ExitCode.BAD_DATA
    assert ran.summary["poses"]["odometry_received"] == PINGS
    assert ran.summary["pings_mapped"] == PINGS


def test_pings_keep_their_numbers_through_damage_and_a_checkpoint(ping_bytes: PingBytes) -> None:
    config = Config()
    chunks = [
        Chunk(SONAR, OCULUS, START_NS + k, data, damaged=k in {3, 4})
        for k, data in enumerate(
            ping[part]
            for ping in map(ping_bytes, range(1, 7))
            for part in (slice(0, 1000), slice(1000, None))
        )
    ]

    def works(cut: int | None) -> list[PosedPing]:
        counters = PipelineCounters()
        decoder = SessionDecoder(config, FixedPose(STILL), counters, confirm=False, obey=True)
        found: list[Any] = []
        for k, chunk in enumerate(chunks):
            if k == cut:
                state = decode_state(encode_state(decoder.state()), type(decoder.state()))
                poses = FixedPose(STILL)
                decoder = SessionDecoder(config, poses, counters, confirm=False, obey=True)
                decoder.restore(state)
            found += decoder.feed(chunk)
        found += decoder.end()
        assert counters.pings_lost == 0
        return found

    for cut in (None, *range(len(chunks))):
        came = works(cut)
        assert [work.number for work in came] == list(range(6))
        bad = [work.number for work in came if isinstance(work.pose, Reject)]
        assert bad == [1, 2]


def test_checkpoints_written_before_damage_was_marked_are_read() -> None:
    decoder = SessionDecoder(
        Config(), FixedPose(STILL), PipelineCounters(), confirm=False, obey=True
    )
    state = decoder.state()
    before = (*state[:5], state.stream[:-1], *state[6:-1])
    assert state[5] is state.stream
    assert decode_state(encode_state(before), type(state)).stream == state.stream


def dive(folder: Path, map_path: Path, pings: list[bytes]) -> Config:
    """Map a session live, with its map in memory; the recording has a chunk for each ping."""
    config = config_from_text(
        "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
        "device: {address: 127.0.0.1}\n"
        f"outofcore: {{use: true, map_path: '{map_path}'}}\n"
        f"recording: {{folder: '{folder}', free_floor: 0}}\n"
    )
    live = Live(SonarMap(config), FixedPose(STILL), session="one", clock=lambda: START_NS)

    async def work() -> None:
        async with live.recorder:
            live.ingest.order(live._beginning())
            live.mapping.start()
            for k, data in enumerate(pings):
                live.ingest.receive(SONAR, data, START_NS + 100_000_000 * k, gap=False)
            live.queue.close()
            await asyncio.to_thread(live.mapping.join)

    asyncio.run(work())
    return config


def damage(folder: Path, ping: bytes) -> None:
    [path] = folder.iterdir()
    path.write_bytes(altered(path, [ping]).read_bytes())
    (folder / "altered").unlink()


@pytest.mark.parametrize("use", [False, True])
def test_a_rebuild_leaves_altered_pings_out_unless_asked(
    use: bool,  # noqa: FBT001 a parameter of the test
    tmp_path: Path,
    ping_bytes: PingBytes,
) -> None:
    folder, path = tmp_path / "recordings", tmp_path / "map.db"
    pings = [ping_bytes(k + 1) for k in range(5)]
    config = dive(folder, path, pings)
    damage(folder, pings[2])
    damaged = DamagedData(allowed=use)
    sonar_map = SonarMap(config)
    with TileStore(path, sonar_map, tile_size_m=8.0, cache_tiles=8) as store:
        mapped, _ = map_recorded_sessions(store, sonar_map, ("one",), folder, damaged)
    assert mapped == (5 if use else 4)
    assert len(damaged.parts) == 1
    assert not replay_sessions(SonarMap(config), ("one",), folder, DamagedData(allowed=use))


@pytest.mark.parametrize("allowed", [False, True])
def test_a_recovery_leaves_altered_pings_out_unless_asked(
    allowed: bool,  # noqa: FBT001 a parameter of the test
    tmp_path: Path,
    ping_bytes: PingBytes,
) -> None:
    folder, path = tmp_path / "recordings", tmp_path / "map.db"
    pings = [ping_bytes(k + 1) for k in range(5)]
    config = dive(folder, path, pings)
    damage(folder, pings[2])
    sonar_map, damaged = SonarMap(config), DamagedData(allowed)
    counters, nothing = PipelineCounters(), Tail({}, RecordingOffset())
    decoder = SessionDecoder(config, FixedPose(STILL), counters, confirm=False, obey=True)
    with TileStore(path, sonar_map, tile_size_m=8.0, cache_tiles=8) as store:
        persistence = StoredSession(store, sonar_map, "one").persistence()
        persistence.begin(decoder, nothing, lambda: None)
        persistence.stop()  # as a kill does: nothing is mapped yet
        position = position_in(store.saved_position)
        assert position is not None
        recovered = recover(store, sonar_map, position, folder, damaged)
    assert recovered is not None
    assert (recovered.pings, recovered.problem) == (5 if allowed else 4, None)
    assert "fail their checksum" in str(damaged)


def test_the_daemon_reports_damaged_recordings_when_it_rebuilds_its_map(
    tmp_path: Path, ping_bytes: PingBytes
) -> None:
    folder, path = tmp_path / "recordings", tmp_path / "map.db"
    pings = [ping_bytes(k + 1) for k in range(5)]
    config = dive(folder, path, pings)
    damage(folder, pings[2])
    path.with_name(f"{path.name}.rebuilding").touch()  # a rebuild was interrupted
    events = EventLog(lambda: START_NS)
    open_map(config, "two", events, {}, lambda: 5.0).close()
    [event] = [one for one in events.since(0)[0] if one.code == "recording_damaged"]
    assert "fail their checksum and were not mapped" in event.text


def test_a_session_whose_beginning_is_damaged_is_still_one(
    tmp_path: Path, ping_bytes: PingBytes
) -> None:
    folder = tmp_path / "recordings"
    pings = [ping_bytes(k + 1) for k in range(5)]
    dive(folder, tmp_path / "map.db", pings)
    damage(folder, pings[2])
    [session] = sessions_of(files_in([folder]))
    assert session.beginning() is not None


def test_damaged_decisions_are_counted_among_the_losses(
    tmp_path: Path, ping_bytes: PingBytes
) -> None:
    folder = tmp_path / "recordings"
    pings = [ping_bytes(k + 1) for k in range(5)]
    dive(folder, tmp_path / "map.db", pings)
    damage(folder, b"voxel_resolution")  # in the settings of its beginning
    damaged = DamagedData()
    [session] = sessions_of(files_in([folder]), damaged)
    decisions = sum(chunk.damaged and chunk.encoding == DECISIONS for chunk in session)
    for _ in session:
        """Reading again counts once."""
    assert decisions > 0
    assert sum(damaged.decisions.values()) == decisions
    assert f"{decisions} recorded decisions are among them" in str(damaged)
