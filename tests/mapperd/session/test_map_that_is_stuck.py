"""Saves fail for a while, and the map takes no more pings: none of them counts as mapped."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from mapperd.config.tree import Config
from mapperd.daemon.session import Live
from mapperd.errors import StoreError
from mapperd.events import EventLog
from mapperd.pipeline.ingest import SONAR
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.recordings import files_in, sessions_of
from mapperd.session.replay_to_store import map_into_store
from mapperd.session.startup import open_map
from mapperd.session_log import STUCK, Drop, decision_of, remarks_in
from mapperd.store.transfer import Saver, Snapshot
from tests.mapperd.conftest import START_NS, make_odometry, make_ping
from tests.mapperd.session.crash import test_startup as sessions

S = 1_000_000_000
PINGS = 100
LIVE = (
    "device: {address: 127.0.0.1}\nbehind: {max_wait: 60}\n"
    "odometry: {sources: [{name: vehicle, link: 'udp://127.0.0.1:52200'}]}\n"
)


def config_of(folder: Path, more: str = "") -> Config:
    config = sessions.config_of(folder, more)
    return msgspec.structs.replace(
        config, outofcore=msgspec.structs.replace(config.outofcore, cache_size=1)
    )


def refuse(monkeypatch: pytest.MonkeyPatch, is_full: Callable[[], bool]) -> None:
    """Let saves with bricks fail while the disk is full."""
    write = Saver.write

    def maybe(saver: Saver, snapshot: Snapshot) -> None:
        if list(snapshot.bricks) and is_full():
            raise StoreError("the disk is full", "disk_full")
        write(saver, snapshot)

    monkeypatch.setattr(Saver, "write", maybe)


def for_a_while() -> Callable[[], bool]:
    attempts = iter(range(1 << 30))
    return lambda: next(attempts) < 40


@pytest.mark.parametrize("rule", ["iwlo", "arc"])
def test_a_replay_stops_and_the_next_one_maps_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rule: str
) -> None:
    config = config_of(tmp_path, f"mapping: {{rule: {rule}}}\n")
    recording = sessions.record(config, 1, "a", range(PINGS))
    path = tmp_path / "other.map"
    with monkeypatch.context() as patch:
        refuse(patch, for_a_while())
        with pytest.raises(StoreError, match="cannot be mapped: nothing can be saved"):
            map_into_store([recording], config, None, path)
    whole, *_ = map_into_store([recording], config, None, path)
    found = whole.sha256()
    whole.close()
    assert found == sessions.reference(config, "a")


def test_a_recovery_stops_and_the_next_one_maps_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_of(tmp_path)
    sessions.record(config, 1, "a", range(2 * PINGS))
    sessions.mapped(config, "a", chunks=60, save_at=20)
    with monkeypatch.context() as patch:
        refuse(patch, for_a_while())
        with pytest.raises(StoreError, match="nothing can be saved"):
            sessions.opened(config)
    assert sessions.codes(sessions.opened(config)) == ["recovered"]
    assert sessions.content(config)[0] == sessions.reference(config, "a")


@pytest.mark.parametrize("ends", ["well", "killed"])
@pytest.mark.parametrize("rule", ["iwlo", "arc"])
def test_a_live_session_records_and_states_which_pings_it_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: str, rule: str
) -> None:
    config = config_of(tmp_path, f"{LIVE}mapping: {{rule: {rule}}}\n")
    events = EventLog(lambda: 0)
    opened = open_map(config, "a", events, {}, lambda: 3600.0)
    live = Live(
        opened.sonar_map,
        OdometryPoses(config),
        session="a",
        clock=lambda: START_NS,
        persistence=opened.persistence,
    )

    def is_full() -> bool:
        return ends == "killed" or live.counters.pings_dropped[STUCK] < 5

    async def work() -> None:
        async with live.recorder:
            live.ingest.order(live._beginning())
            opened.persistence.begin(live.mapping.pipeline.decoder, live.recorder, live.queue.wake)
            live.mapping.start()
            for k in range(PINGS):
                t_ns = START_NS + k * S // 10
                odometry = make_odometry(p=(0.3 * k, 0.0, 0.0))
                live.ingest.receive("vehicle", odometry, t_ns, gap=False)
                ping = make_ping(k + 1, image=sessions.wall_of(config, k))
                live.ingest.receive(SONAR, ping, t_ns + S // 20, gap=False)
            live.queue.close()
            await asyncio.to_thread(live.mapping.join)

    with monkeypatch.context() as patch:
        refuse(patch, is_full)
        if ends == "killed":
            patch.setattr(opened.persistence, "end", lambda: None)
        asyncio.run(work())
    assert live.mapping.failure is None
    lost = live.counters.pings_dropped[STUCK]
    assert lost >= 5
    status = opened.persistence.status()
    opened.close()
    assert status is not None
    assert status["data_lost"]
    if ends == "well":
        assert f"{lost} pings were not mapped" in status["loss"]
        assert [event.code for event in events.since(0)[0]][-1] == "map_not_saved"
    (session,) = sessions_of(files_in([tmp_path / "recordings"]))
    decisions = [decision_of(chunk) for chunk in session]
    assert sum(isinstance(one, Drop) for one in decisions) == lost
    assert len(remarks_in(session).stuck) == lost
    codes = sessions.codes(sessions.opened(config))
    assert codes == ["recovered", "sessions_not_mapped"][ends == "well" :]
    found, position = sessions.content(config)
    assert found == sessions.reference(config, "a")
    assert list(position.incomplete) == ["a"]
