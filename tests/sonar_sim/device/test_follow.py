"""A served sonar whose vehicle others drive."""

import asyncio
import contextlib
import math
import socket
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from sonar_sim.device.ping_generator import TransmitState
from sonar_sim.device.server import ServedScenario, ServeSettings
from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.live_path import LivePath
from sonar_sim.geometry.pose import FramePose
from sonar_sim.navigation.follow import PoseFollower
from sonar_sim.navigation.odometry_output import output_named
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.vehicle import Vehicle

from mapperd.odometry.native import decode_native
from mapperd.odometry.records import Odometry
from oculus_driver import FireSettings, OculusSonar, PingRate
from tests.support.process import free_port

pytestmark = pytest.mark.net

MakeScenario = Callable[..., Scenario]
QUICK = FireSettings(range_m=3.0, beams=256, ping_rate=PingRate.HIGH)


def run(work: Coroutine[Any, Any, None]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(30.0):
            await work

    asyncio.run(limited())


def native(x_m: float) -> bytes:
    record = {"v": 1, "clk": "arrival", "w": "enu", "b": "flu", "p": [x_m, 0.0, -2.0]}
    packed: bytes = msgpack.packb(record | {"q": [1.0, 0.0, 0.0, 0.0], "u": [1.0, 0.0, 0.0]})
    return packed


async def drive(send: Callable[[float], object], clock: Callable[[], float]) -> None:
    """Ahead at 1 m/s: x is the clock's time."""
    while True:
        send(clock())
        await asyncio.sleep(0.05)


async def seen(
    served: ServedScenario, count: int, settings: FireSettings = QUICK
) -> list[TransmitState]:
    """States at the transmission of pings, after the first few."""
    states: list[TransmitState] = []
    served.sonar.device.on_ping = lambda _, when: states.append(when)
    async with OculusSonar("127.0.0.1", port=served.sonar.port, settings=settings) as sonar:
        pings = aiter(sonar.pings())
        while len(states) < count:
            await anext(pings)
    return states[3:]


def test_pings_are_where_native_records_say(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        settings = ServeSettings(follow={"vehicle": "udp://127.0.0.1:0"})
        async with ServedScenario(floor_scenario(), settings) as served:
            follower = served.followers["vehicle"]
            assert follower.state == "waiting"
            port = int(follower.url.rpartition(":")[2])
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
                out.connect(("127.0.0.1", port))
                out.send(b"noise")
                driving = asyncio.create_task(drive(lambda x: out.send(native(x)), served.route_s))
                states = await seen(served, 12)
                driving.cancel()
            assert (follower.state, follower.malformed) == ("following", 1)
            for when in states:
                assert when.map_T_base.position_m[0] == pytest.approx(when.time_s, abs=0.05)
                assert when.velocity_mps == pytest.approx([1.0, 0.0, 0.0], abs=0.2)

    run(work())


def test_pings_are_where_a_library_call_puts_the_vehicle(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        path = LivePath(FramePose(np.array([0.0, 0.0, -2.0]), np.eye(3)))
        outputs = [output_named(f"native@udp:127.0.0.1:{free_port()}")]
        sent: list[bytes] = []
        outputs[0].link.send = sent.append  # type: ignore[method-assign, assignment]
        settings = ServeSettings(follow={"vehicle": path}, outputs=outputs)
        async with ServedScenario(floor_scenario(), settings) as served:

            def put(x_m: float) -> None:
                pose = FramePose(np.array([x_m, 0.0, -2.0]), np.eye(3))
                path.update(x_m, pose, np.array([1.0, 0.0, 0.0]))

            driving = asyncio.create_task(drive(put, served.route_s))
            states = await seen(served, 12)
            driving.cancel()
        for when in states:
            assert when.map_T_base.position_m[0] == pytest.approx(when.time_s, abs=0.02)
        # The odometry goes the same way, with its noise.
        records = [decode_native(data) for data in sent[-5:]]
        places = [
            one.position_m[0]
            for one in records
            if isinstance(one, Odometry) and one.position_m is not None
        ]
        assert np.diff(places) == pytest.approx([0.02] * 4, abs=0.03)

    run(work())


def test_a_pose_is_predicted_only_over_the_simulation(floor_scenario: MakeScenario) -> None:
    """The vehicle swings; half a second ahead it would be somewhere else."""

    def place_m(time_s: float) -> float:
        return 0.5 * math.sin(math.pi * time_s)

    async def work() -> None:
        path = LivePath(FramePose(np.array([0.0, 0.0, -2.0]), np.eye(3)))

        def put(time_s: float) -> None:
            speed_mps = 0.5 * math.pi * math.cos(math.pi * time_s)
            pose = FramePose(np.array([place_m(time_s), 0.0, -2.0]), np.eye(3))
            path.update(time_s, pose, np.array([speed_mps, 0.0, 0.0]))

        async with ServedScenario(floor_scenario(), ServeSettings(follow={"vehicle": path})) as one:
            driving = asyncio.create_task(drive(put, one.route_s))
            states = await seen(one, 8, replace(QUICK, ping_rate=PingRate.LOWEST))
            driving.cancel()
        errors_m = [abs(w.map_T_base.position_m[0] - place_m(w.time_s)) for w in states]
        assert max(errors_m) < 0.2, errors_m

    run(work())


def test_an_autopilot_is_connected_to_asked_and_connected_to_again() -> None:
    async def work() -> None:
        asked: list[int] = []
        link = common.MAVLink(None, 1, 1)

        async def autopilot(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(common.MAVLink_attitude_message(1000, 0, 0, 0, 0, 0, 0).pack(link))
            position = common.MAVLink_local_position_ned_message(1000, 3, 4, 5, 0, 0, 0)
            writer.write(position.pack(link))
            requests = common.MAVLink(None).parse_buffer(await reader.read(1000)) or []
            asked.extend(int(one.param1) for one in requests)
            writer.close()

        async with await asyncio.start_server(autopilot, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            path = LivePath(FramePose(np.zeros(3), np.eye(3)))
            clock = asyncio.get_running_loop().time
            follower = PoseFollower(f"mavlink+tcp://127.0.0.1:{port}", path, Vehicle(), clock)
            await follower.open()
            while len(asked) < 6:  # noqa: ASYNC110 two connections
                await asyncio.sleep(0.02)
            await follower.close()
        assert asked[:3] == [30, 32, 33]
        assert path.pose(clock()).position_m == pytest.approx([4.0, 3.0, -5.0])

    run(work())


def test_an_autopilot_whose_numbers_are_not_finite_is_followed_on() -> None:
    async def work() -> None:
        link = common.MAVLink(None, 1, 1)
        bad = [
            common.MAVLink_attitude_message(1000, math.inf, 0, 0, 0, 0, 0),
            common.MAVLink_attitude_quaternion_message(1000, math.inf, 0, 0, 0, 0, 0, 0),
            common.MAVLink_local_position_ned_message(1000, math.nan, 0, 0, 0, 0, 0),
        ]
        good = [
            common.MAVLink_attitude_message(1000, 0, 0, 0, 0, 0, 0),
            common.MAVLink_local_position_ned_message(1000, 3, 4, 5, 0, 0, 0),
        ]
        connections, gone = 0, asyncio.Event()

        async def autopilot(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            nonlocal connections
            connections += 1
            for message in (*bad, *good):
                writer.write(message.pack(link))
                await writer.drain()
                await asyncio.sleep(0.01)
            await reader.read()  # until the follower goes
            writer.close()
            await writer.wait_closed()
            gone.set()

        async with await asyncio.start_server(autopilot, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            path = LivePath(FramePose(np.zeros(3), np.eye(3)))
            clock = asyncio.get_running_loop().time
            follower = PoseFollower(f"mavlink+tcp://127.0.0.1:{port}", path, Vehicle(), clock)
            await follower.open()
            while follower.records < len(good):  # noqa: ASYNC110 over TCP
                await asyncio.sleep(0.02)
            await follower.close()
            await gone.wait()
        assert (follower.malformed, connections) == (len(bad), 1)
        assert path.pose(clock()).position_m == pytest.approx([4.0, 3.0, -5.0])

    run(work())


def test_two_vehicles_are_served_and_driven_apart(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        one = floor_scenario()
        other = replace(one, name="two/sonar", vehicle=Vehicle("two", size_m=(0.4, 0.3, 0.2)))
        follow = {"two": LivePath(FramePose(np.array([5.0, 0.0, -2.0]), np.eye(3)))}
        settings = ServeSettings(follow=follow)
        async with ServedScenario(replace(one, others=(other,)), settings) as served:
            first, second = served.sonars
            assert first.port != second.port
            assert second.device.source_id == first.device.source_id + 1
            places = []
            for sonar in served.sonars:
                states: list[TransmitState] = []
                sonar.device.on_ping = lambda _, when, states=states: states.append(when)
                await sonar.device.look()
                places.append(states[0].map_T_base.position_m[0])
            assert places[0] == pytest.approx(-1.0, abs=0.3)
            assert places[1] == 5.0

    run(work())


@pytest.mark.parametrize(
    ("follow", "reason"),
    [
        ({"vehicle": "udp://127.0.0.1"}, "is not a link; use udp://HOST:PORT"),
        ({"vehicle": "serial:/dev/ttyUSB0"}, "is not a link"),
        ({"vehicle": "udp://127.0.0.1:99999"}, "is not a link"),
        ({"rov": "udp://127.0.0.1:0"}, "no vehicle is called 'rov'; there are vehicle"),
    ],
)
def test_what_cannot_be_followed_is_refused(
    floor_scenario: MakeScenario, follow: dict[str, str], reason: str
) -> None:
    with pytest.raises(SonarSimError, match=reason):
        ServedScenario(floor_scenario(), ServeSettings(follow=follow))


def test_a_port_that_is_taken_is_named(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            url = f"udp://127.0.0.1:{taken.getsockname()[1]}"
            served = ServedScenario(floor_scenario(), ServeSettings(follow={"vehicle": url}))
            with contextlib.ExitStack() as stack:
                stack.enter_context(pytest.raises(SonarSimError, match=f"{url}: cannot listen"))
                await served.__aenter__()

    run(work())
