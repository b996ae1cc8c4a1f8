"""What localization is asked for while it runs: answered, recorded, and done again by a replay."""

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.cli.mapperd import main
from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.daemon.session import Live
from mapperd.errors import CheckpointError, MapError, Reject
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.map_io import write_nav2_map
from mapperd.localization.maps import GridMap
from mapperd.localization.models import check_localization
from mapperd.localization.session import LocalizationSession, begun
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.ingest import SONAR
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.recordings import files_in, sessions_of
from mapperd.session_log import (
    DECISIONS,
    GlobalLocalization,
    InitialPose,
    NewMap,
    NoMotionUpdate,
    Request,
    SetMap,
    Settings,
    decision_of,
)
from oculus_driver.command_line import ExitCode
from tests.mapperd.localization.room import dive, events, room, settings, write_room

Asked = Request | dict[str, Any]

REFUSED = "{'amcl': 'z_hit and z_rand must not both be 0'}"

START_NS = 1_700_000_000_000_000_000
COVARIANCE = (0.02, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.003)
SHIFT_M = 2.0

pytestmark = pytest.mark.usefixtures("no_picture")


class Session:
    """A session of the daemon, its links left out."""

    def __init__(self, config: Config, localizing: LocalizationSession | None) -> None:
        self.sonar_map = SonarMap(config)
        self.store = ConfigStore(Layered(config))
        self.live = Live(
            self.sonar_map,
            OdometryPoses(config),
            session="abc",
            clock=lambda: START_NS,
            localization=localizing,
        )
        self.store.follow(PingExecutor.FOLLOWS, self.live.reconfigure, check_localization)
        self.answers: list[str] = []

    def run(self, track: list[tuple[str, bytes, float]], requests: dict[int, Asked]) -> None:
        """Let things come in; before so many of them have, something is asked for or set."""

        async def work() -> None:
            live = self.live
            async with live.recorder:
                live.ingest.order(live._beginning())
                live._requests.open()
                live.mapping.on_request = live._requests.done
                live.mapping.start()
                for k, (kind, data, seconds) in enumerate(track):
                    if k in requests:
                        self.answers.append(await self.asked(requests[k]))
                    link = SONAR if kind == "ping" else "vehicle"
                    live.ingest.receive(link, data, START_NS + round(seconds * 1e9), gap=False)
                    while live.queue.waiting_bytes or len(live.mapping.backlog):  # noqa: ASYNC110
                        await asyncio.sleep(0.001)  # none is too slow
                live.queue.close()
                await asyncio.to_thread(live.mapping.join)
            assert live.mapping.failure is None

        asyncio.run(work())

    async def asked(self, request: Asked) -> str:
        if isinstance(request, dict):
            applied = self.store.apply(request, "test")
            return "set" if isinstance(applied, Applied) else str(applied.reasons)
        refused = await asyncio.wait_for(self.live.request(request), 10)
        return refused.reason if isinstance(refused, Reject) else "done"


def text_of(folder: Path, **ours: object) -> str:
    text = settings(write_room(folder), **ours).replace(
        "set_initial_pose: true", "set_initial_pose: false"
    )
    return text + (
        "device: {address: 127.0.0.1}\nbehind: {max_wait: 60}\n"
        "odometry: {sources: [{name: vehicle, link: 'udp://127.0.0.1:52200'}]}\n"
        f"recording: {{folder: '{folder}/recordings', free_floor: 0}}\n"
    )


def shifted_room(folder: Path) -> Path:
    """The same room in a map whose x is larger."""
    grid = room()
    path = folder / "shifted.yaml"
    cells = np.array(grid.occupancy)
    write_nav2_map(
        GridMap(cells, grid.resolution_m, grid.origin_x_m + SHIFT_M, grid.origin_y_m), path
    )
    return path


def pose_at(ping: int, shift_m: float = 0.0, frame: str = "map") -> dict[str, Any]:
    x, y, yaw = dive().truth[ping].tolist()
    return {
        "number": 0,
        "x_m": x + shift_m,
        "y_m": y,
        "yaw_rad": yaw,
        "covariance": COVARIANCE,
        "frame": frame,
        "origin": "test",
    }


def asked_for(folder: Path) -> dict[int, Asked]:
    """Three events a ping."""
    shifted = str(shifted_room(folder))
    return {
        10: NoMotionUpdate(0),
        11: GlobalLocalization(0),
        20: InitialPose(**pose_at(6, frame="odom")),
        30: InitialPose(**pose_at(10)),
        150: NoMotionUpdate(0),
        180: SetMap(**pose_at(60, SHIFT_M), path=shifted, sha256=""),
        240: {"amcl.max_particles": 500, "amcl.laser_sigma_hit": 0.15},
        241: {"amcl.laser_z_hit": 1e-300, "amcl.laser_z_rand": 0.0},
        300: NewMap(0, str(folder / "room.yaml"), ""),
        303: InitialPose(**pose_at(101)),
    }


def replayed(folder: Path, out: Path) -> tuple[int, dict[str, Any]]:
    code = main(["--replay", str(folder), "--as-recorded", "--out", str(out)])
    if code != ExitCode.OK:
        return code, {}
    return code, json.loads((out / "summary.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_requests_are_recorded_and_done_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = config_from_text(text_of(tmp_path, mapping="corrected"))
    session = Session(config, begun(config))
    session.run(events(room(), dive()), asked_for(tmp_path))
    assert session.answers == [
        "no_filter", "done", "wrong_frame", "done", "done", "done", "set", REFUSED, "done", "done"
    ]  # fmt: skip
    facts = session.live.mapping.snapshot.localization
    assert facts is not None
    assert facts.belief is not None
    assert abs(facts.belief.best.x_m - dive().truth[-1][0]) < 0.4
    assert facts.known is not None
    assert facts.known.path.endswith("room.yaml")
    assert 1 < facts.particles.shape[0] <= 500
    assert facts.particles[:, 3].sum() == pytest.approx(1)

    (recorded,) = sessions_of(files_in([tmp_path / "recordings"]))
    kinds = [type(decision_of(chunk)) for chunk in recorded if chunk.encoding == DECISIONS]
    asked = [one for k, one in asked_for(tmp_path).items() if k != 241]
    assert kinds[1:] == [Settings if isinstance(one, dict) else type(one) for one in asked]

    _, summary = replayed(tmp_path / "recordings", tmp_path / "out")
    assert summary["map_sha256"] == session.sonar_map.sha256()
    assert summary["pings_mapped"] == session.live.counters.pings_mapped > 80
    assert summary["localization"]["updates"] == facts.updates
    assert summary["localization"]["pose"]["x_m"] == facts.belief.best.x_m

    write_nav2_map(GridMap(np.array(room().occupancy), 0.2), tmp_path / "shifted.yaml")
    code, _ = replayed(tmp_path / "recordings", tmp_path / "out")
    assert code == ExitCode.BAD_DATA
    assert "shifted.yaml: another map" in capsys.readouterr().err


def test_saved_pose_of_a_session_is_in_its_recording(tmp_path: Path) -> None:
    config = config_from_text(text_of(tmp_path, mapping="corrected"))
    x, y, yaw = dive().truth[0].tolist()
    saved = PlanarGaussian(x, y, yaw, np.diag([0.02, 0.02, 0.003]))
    session = Session(config, begun(config, saved))
    session.run(events(room(), dive(40)), {})
    assert session.live.counters.pings_mapped > 35
    _, summary = replayed(tmp_path / "recordings", tmp_path / "out")
    assert summary["map_sha256"] == session.sonar_map.sha256()
    assert summary["pings_mapped"] == session.live.counters.pings_mapped


def test_map_that_cannot_be_loaded_is_never_ordered(tmp_path: Path) -> None:
    config = config_from_text(text_of(tmp_path))
    session = Session(config, begun(config))

    async def work() -> None:
        session.live._requests.open()
        with pytest.raises(MapError, match=r"none\.yaml"):
            await session.live.request(NewMap(0, str(tmp_path / "none.yaml"), ""))

    asyncio.run(work())
    assert session.live.mapping.pipeline.decoder.orders_taken == 0
    assert not session.live.queue.waiting_bytes


def test_maps_that_were_loaded_are_taken_whatever_becomes_of_their_files(tmp_path: Path) -> None:
    localizing = begun(config_from_text(text_of(tmp_path)))
    assert localizing is not None
    path = shifted_room(tmp_path)
    maps, stage = localizing.maps, localizing.stage
    known, again = maps.load(str(path)), maps.load(str(path))
    maps.offer(known)
    maps.offer(again)  # the same map, asked for twice before it is taken once
    path.with_suffix(".pgm").unlink()
    for number in (1, 2):
        assert stage.request(NewMap(number, known.path, known.sha256)) is None
    with pytest.raises(CheckpointError):  # in a replay the session cannot be as it was
        stage.request(NewMap(3, known.path, known.sha256))


def test_nothing_can_be_asked_where_localization_is_off(tmp_path: Path) -> None:
    config = config_from_text(text_of(tmp_path).replace("mode: track", "mode: 'off'"))
    assert begun(config) is None
    session = Session(config, None)
    session.run(events(room(), dive(5)), {3: GlobalLocalization(0)})
    assert session.answers == ["localization_off"]
    assert session.live.mapping.snapshot.localization is None


def test_session_that_has_ended_answers(tmp_path: Path) -> None:
    config = config_from_text(text_of(tmp_path))
    session = Session(config, begun(config))

    async def work() -> str:
        session.live._requests.open()
        asking = asyncio.create_task(session.asked(GlobalLocalization(0)))
        await asyncio.sleep(0)
        session.live._requests.close()
        return await asking

    assert asyncio.run(work()) == "closed"
