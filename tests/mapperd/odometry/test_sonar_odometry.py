"""Sonar odometry against scenes of points, whose image from any place is known exactly."""

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sonar_sim import Mounting, load_scenario, sonar_preset
from sonar_sim.capture import EPOCH_NS, CaptureSettings, write_capture
from sonar_sim.geometry.trajectory import Motion, Trajectory, Waypoint

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, Reject
from mapperd.geometry.frames import pose_from_rpy, rotation_from_rpy
from mapperd.imaging.ping_image import PingImage
from mapperd.odometry.fusion import FusedPose
from mapperd.odometry.sonar_odometry import (
    GroundMotion,
    SonarOdometry,
    SonarOdometryState,
    sonar_odometry,
)
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PosedPing, SessionDecoder, SessionDecoderState
from mapperd.pipeline.ingest import SONAR
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.store.checkpoint import decode_state, encode_state
from oculus_driver.recording import Chunk, open_recording
from tests.mapperd.conftest import make_odometry, make_ping
from tests.mapperd.session.test_as_recorded import Event, mapped_live, replayed

Floats = NDArray[np.float64]

ROWS, BEAMS, ROW_M = 320, 192, 0.03125
BEARINGS_CDEG = np.linspace(-6000, 6000, BEAMS).round().astype(np.int16)
BEARINGS_RAD = np.radians(BEARINGS_CDEG / 100)
S = 10**9
START_NS = 1_700_000_000 * S
STEP_NS = S // 5
SETTINGS = """
mounting: {position: {x: 0.4, y: 0.1, z: 0.0}, orientation: {pitch: PITCH}}
octree: {voxel_resolution: 0.2}
time_sync: {max_gap_sec: 0.5}
odometry:
  sources: [{name: vehicle, link: "udp://127.0.0.1:52200"}]
  owners: {position: none, attitude: vehicle, velocity: sonar}
  sonar: {enabled: true}
"""


def config_of(pitch_deg: float = 0.0, more: str = "") -> Config:
    return config_from_text(SETTINGS.replace("PITCH", str(pitch_deg)) + more)


def made(pitch_deg: float = 0.0) -> SonarOdometry:
    odometry = sonar_odometry(config_of(pitch_deg))
    assert odometry is not None
    return odometry


class Scene:
    """Points all around, that echo alike.

    Args:
        seed: of their places and of the noise.
        points: number of them.
        below: tangent of the angle below the sonar at which each of them is seen from the origin.
    """

    def __init__(self, seed: int = 1, points: int = 900, below: float = 0.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.points_m = self.rng.uniform(-14, 14, (points, 3))
        self.points_m[:, 2] = -below * np.hypot(*self.points_m[:, :2].T)
        self.pitch_deg = 0.0

    def image(
        self,
        x: float,
        y: float,
        rpy_deg: tuple[float, float, float] = (0, 0, 0),
        noise: float = 8.0,
    ) -> NDArray[np.uint8]:
        """Return what a sonar at (0.4, 0.1, 0) of a base at (x, y, 0) sees."""
        base = pose_from_rpy((x, y, 0.0), rpy_deg).map_T_base
        sonar = base @ pose_from_rpy((0.4, 0.1, 0.0), (0, self.pitch_deg, 0)).map_T_base
        at = (self.points_m - sonar[:3, 3]) @ sonar[:3, :3]
        row = np.linalg.norm(at, axis=1) / ROW_M - 0.5
        beam = np.interp(
            -np.arctan2(at[:, 1], at[:, 0]),
            BEARINGS_RAD,
            np.arange(BEAMS),
            left=-9,
            right=BEAMS + 9,
        )
        image = self.rng.rayleigh(noise, (ROWS, BEAMS)) if noise else np.zeros((ROWS, BEAMS))
        for i, j in zip(row, beam, strict=True):
            if not (0 <= i < ROWS - 1 and 0 <= j < BEAMS - 1):
                continue
            rows = np.arange(max(0, int(i) - 6), min(ROWS, int(i) + 8))
            beams = np.arange(max(0, int(j) - 4), min(BEAMS, int(j) + 6))
            spot = np.exp(-((rows - i) ** 2) / 8)[:, None] * np.exp(-((beams - j) ** 2) / 2.5)
            image[np.ix_(rows, beams)] += 150 * spot
        return np.clip(image.round(), 0, 255).astype(np.uint8)

    def ping(self, *where: Any, **more: Any) -> PingImage:
        return seen(self.image(*where, **more))


def seen(image: NDArray[np.uint8]) -> PingImage:
    return PingImage(image.astype(np.float32), BEARINGS_RAD, ROW_M)


def motion_of(result: tuple[GroundMotion, int] | Reject) -> GroundMotion:
    assert not isinstance(result, Reject), result
    return result[0]


def level(yaw_deg: float = 0.0) -> Floats:
    return rotation_from_rpy(0.0, 0.0, yaw_deg)


@pytest.mark.parametrize(
    "displacement_m",
    [(0.13, 0.0), (-0.13, 0.0), (0.0, 0.13), (0.0, -0.13), (0.11, -0.07), (0.0, 0.0)],
)
def test_shift_is_found_to_a_fraction_of_a_cell(displacement_m: tuple[float, float]) -> None:
    scene, odometry = Scene(), made()
    odometry.take(scene.ping(0.0, 0.0), START_NS, level())
    motion = motion_of(odometry.take(scene.ping(*displacement_m), START_NS + STEP_NS, level()))
    np.testing.assert_allclose(
        motion.velocity_mps * 0.2, displacement_m, atol=0.008
    )  # an eighth of a cell
    assert motion.yaw_rate_radps == 0


def test_surge_is_along_the_heading_in_the_middle() -> None:
    """While turning from 90 to 96 degrees the base moves to 93 degrees."""
    scene, odometry = Scene(), made()
    odometry.take(scene.ping(0, 0, (0, 0, 90)), START_NS, level(90))
    x, y = 0.15 * math.cos(math.radians(93)), 0.15 * math.sin(math.radians(93))
    motion = motion_of(odometry.take(scene.ping(x, y, (0, 0, 96)), START_NS + STEP_NS, level(96)))
    np.testing.assert_allclose(motion.velocity_mps * 0.2, (0.15, 0), atol=0.01)
    assert motion.yaw_rate_radps == pytest.approx(math.radians(30))
    (record,) = motion.records(1)
    assert record.stamp_ns == START_NS + STEP_NS // 2
    assert record.velocity_east_north_mps is not None
    np.testing.assert_allclose(record.velocity_east_north_mps * 0.2, (x, y), atol=0.01)


def test_a_turn_about_the_base_is_no_way() -> None:
    """The sonar, 0.4 m before it, moves by 7 cm."""
    scene, odometry = Scene(), made()
    odometry.take(scene.ping(0, 0, (0, 0, 0)), START_NS, level(0))
    motion = motion_of(odometry.take(scene.ping(0, 0, (0, 0, 10)), START_NS + STEP_NS, level(10)))
    np.testing.assert_allclose(motion.velocity_mps * 0.2, (0, 0), atol=0.01)


@pytest.mark.parametrize("turn_deg", [2.6, -2.6])
def test_without_an_attitude_the_turn_is_found_too(turn_deg: float) -> None:
    scene, odometry = Scene(), made()
    odometry.take(scene.ping(0.0, 0.0), START_NS)
    motion = motion_of(odometry.take(scene.ping(0.1, 0, (0, 0, turn_deg)), START_NS + STEP_NS))
    assert math.degrees(motion.yaw_rate_radps) * 0.2 == pytest.approx(turn_deg, abs=0.2)
    half = math.radians(turn_deg / 2)
    way = (0.1 * math.cos(half), -0.1 * math.sin(half))
    np.testing.assert_allclose(motion.velocity_mps * 0.2, way, atol=0.015)
    assert 0 < math.sqrt(motion.covariance[2, 2]) * 0.2 < math.radians(1)
    (record,) = motion.records(1, heading=True)
    assert record.map_q_base is not None
    np.testing.assert_allclose(record.map_q_base, level(turn_deg / 2), atol=0.003)


@pytest.mark.parametrize("tilt_deg", [(6.0, 0.0), (0.0, 6.0), (-4.0, -5.0)])
def test_roll_and_pitch_are_taken_out(tilt_deg: tuple[float, float]) -> None:
    scene, odometry = Scene(), made()
    odometry.take(scene.ping(0.0, 0.0), START_NS, level())
    tilted = scene.ping(0.1, 0.05, (*tilt_deg, 0))
    q = rotation_from_rpy(*tilt_deg, 0.0)
    motion = motion_of(odometry.take(tilted, START_NS + STEP_NS, q))
    np.testing.assert_allclose(motion.velocity_mps * 0.2, (0.1, 0.05), atol=0.012)


def looking_down(pitch_deg: float, displacement_m: tuple[float, float]) -> Floats:
    """Return the measured way among echoes of the upper edge, half of 14 degrees above the axis."""
    scene = Scene(below=math.tan(math.radians(pitch_deg - 7)))
    odometry, scene.pitch_deg = made(pitch_deg=pitch_deg), pitch_deg
    odometry.take(scene.ping(0.0, 0.0), START_NS, level())
    motion = motion_of(odometry.take(scene.ping(*displacement_m), START_NS + STEP_NS, level()))
    return motion.velocity_mps * 0.2


def test_a_sonar_that_looks_down_sees_the_same_way() -> None:
    np.testing.assert_allclose(looking_down(20, (0.15, 0.0)), (0.15, 0.0), atol=0.01)
    # Points of a floor seem farther than they are, by 1 / cos of 28 degrees.
    surge_m, sway_m = looking_down(35, (0.0, 0.24)).tolist()
    assert abs(surge_m) < 0.01
    assert 0.24 < sway_m < 0.24 / math.cos(math.radians(28))


def test_what_moves_with_the_vehicle_does_not_hold_it() -> None:
    """Rings, a step of the gain, a wide glow."""
    scene, odometry = Scene(), made()

    def spoilt(x: float) -> PingImage:
        image = scene.image(x, 0.0).astype(np.float64)
        for row in range(40, ROWS, 13):
            image[row : row + 3] += 150
        image[200:] *= 1.5
        image += 60 * np.exp(-((np.arange(ROWS)[:, None] - 170) ** 2) / 5000)
        return seen(np.clip(image, 0, 255).astype(np.uint8))

    odometry.take(spoilt(0.0), START_NS, level())
    motion = motion_of(odometry.take(spoilt(0.15), START_NS + STEP_NS, level()))
    np.testing.assert_allclose(motion.velocity_mps * 0.2, (0.15, 0), atol=0.012)


def steps_of(odometry: SonarOdometry, pings: Iterable[PingImage]) -> list[Any]:
    return [odometry.take(one, START_NS + k * STEP_NS, level()) for k, one in enumerate(pings)]


def test_silent_without_texture() -> None:
    """Noise, and noise in the light of a floor, alike in all pings."""
    rng = np.random.default_rng(3)
    glow = 1 + 6 * np.exp(-((np.arange(ROWS)[:, None] - 200) ** 2) / 3000)
    for light in (np.ones((ROWS, 1)), glow, np.zeros((ROWS, 1))):
        odometry = made()
        noise = (rng.rayleigh(12, (ROWS, BEAMS)) * light for _ in range(20))
        results = steps_of(odometry, (seen(one.clip(0, 255).astype(np.uint8)) for one in noise))
        assert all(isinstance(one, Reject) for one in results)
        assert odometry.silent["no_texture"] == 19


def test_silent_where_all_texture_lies_along_the_way() -> None:
    """A straight wall to port, without ends: surge has no measure."""
    scene = Scene()
    scene.points_m = np.zeros((1, 3))
    wall = np.arange(-40.0, 40.0, 0.11)
    results = []
    odometry = made()
    for k in range(8):
        jitter = scene.rng.uniform(-0.05, 0.05, len(wall))
        scene.points_m = np.stack([wall + jitter, np.full(len(wall), 5.0), 0 * wall], axis=1)
        results.append(odometry.take(scene.ping(0.15 * k, 0.0), START_NS + k * STEP_NS, level()))
    assert all(isinstance(one, Reject) for one in results)


def test_a_ping_of_another_range_begins_again() -> None:
    scene, odometry = Scene(), made()
    odometry.take(scene.ping(0.0, 0.0), START_NS, level())
    other = PingImage(scene.ping(0.1, 0).intensity, BEARINGS_RAD, 2 * ROW_M)
    changed = odometry.take(other, START_NS + STEP_NS, level())
    assert isinstance(changed, Reject)
    assert changed.reason == "changed_ping"
    back = odometry.take(other, START_NS + STEP_NS, level())
    assert isinstance(back, Reject)
    assert back.reason == "back_in_time"


def test_silent_where_the_sonar_looks_down() -> None:
    scene, odometry = Scene(), made(pitch_deg=90)
    results = steps_of(odometry, [scene.ping(0.1 * k, 0) for k in range(3)])
    assert {one.reason for one in results} == {"looks_down"}


def test_motion_over_lost_pings_is_told_in_parts() -> None:
    """So that dead reckoning sees no gap."""
    scene, odometry = Scene(), made()
    noise = scene.rng.rayleigh(12, (ROWS, BEAMS)).clip(0, 255).astype(np.uint8)
    pings = [scene.ping(0, 0), scene.ping(0.1, 0), seen(noise), scene.ping(0.3, 0)]
    found = [
        odometry.records(ping, START_NS + k * STEP_NS, level()) for k, ping in enumerate(pings)
    ]
    assert [len(one) for one in found] == [0, 1, 0, 2]
    stamps = [(record.stamp_ns - START_NS) / STEP_NS for record in found[3]]
    assert stamps == [1.5, 2.5]
    for record in found[3]:
        assert record.velocity_east_north_mps is not None
        np.testing.assert_allclose(record.velocity_east_north_mps, (0.5, 0), atol=0.05)


def test_covariance_says_how_wrong_it_is() -> None:
    """The normalised error squared has the mean 2 where the covariance is right, less if careful.

    The errors of two pings against one keyframe are alike in part; the covariance takes them as
    independent.
    """
    errors = []
    for seed in range(4):
        scene, odometry = Scene(seed=seed, points=400), made()
        points_m = scene.points_m
        rng = np.random.default_rng(seed)
        places = np.cumsum(rng.uniform((0.0, -0.05), (0.15, 0.05), (16, 2)), axis=0)
        for k, (x, y) in enumerate(places):
            # A quarter of the points does not echo, another one in each ping.
            scene.points_m = points_m[rng.random(len(points_m)) < 0.75]
            result = odometry.take(scene.ping(x, y, noise=15.0), START_NS + k * STEP_NS, level())
            if isinstance(result, Reject):
                continue
            motion, steps = result
            off = motion.velocity_mps - (places[k] - places[k - steps]) / (0.2 * steps)
            errors.append(float(off @ np.linalg.solve(motion.covariance[:2, :2], off)))
    assert len(errors) > 40
    assert 0.1 < float(np.mean(errors)) < 1.0


def test_state_continues_anywhere() -> None:
    scene = Scene()
    pings = [scene.ping(0.12 * k, 0.02 * k) for k in range(9)]

    def told(result: Any) -> Any:
        if isinstance(result, Reject):
            return result
        motion, steps = result
        values = motion.velocity_mps.tobytes(), motion.covariance.tobytes(), motion.yaw_rad
        return motion.from_ns, motion.to_ns, steps, *values

    whole = [told(one) for one in steps_of(made(), pings)]
    for cut in range(len(pings)):
        first = made()
        steps_of(first, pings[:cut])
        saved = encode_state(first.state())
        again = made()
        again.restore(decode_state(saved, SonarOdometryState))
        assert encode_state(again.state()) == saved
        rest = [
            told(again.take(pings[k], START_NS + k * STEP_NS, level()))
            for k in range(cut, len(pings))
        ]
        assert rest == whole[cut:]


def test_settings() -> None:
    assert sonar_odometry(Config()) is None
    with pytest.raises(ConfigError, match="sonar"):
        config_from_text("odometry: {owners: {velocity: sonar}}")
    with pytest.raises(ConfigError, match="sonar"):
        config_from_text("odometry: {sources: [{name: sonar}], sonar: {enabled: true}}")
    assert config_from_text("odometry: {sources: [{name: sonar}]}").odometry.sources[0].name


def track(k: int) -> tuple[float, float, float]:
    """A vehicle that goes north at 0.5 m/s and turns slowly."""
    return 0.0, 0.1 * k, 90.0 + 0.5 * k


def stream(pings: int, *, scene: Scene | None = None) -> list[tuple[int, str, bytes]]:
    """A dive of 5 pings a second with attitudes alone, ten a second: time, link, bytes."""
    scene = scene or Scene()
    found: list[tuple[int, str, bytes]] = []
    for k in range(pings):
        x, y, yaw_deg = track(k)
        t_ns = START_NS + k * STEP_NS
        for half in (0, 1):
            q = tuple(level(yaw_deg + 0.25 * half).tolist())
            record = make_odometry(p=None, q=q)
            found.append((t_ns + half * STEP_NS // 2, "vehicle", record))
        data = make_ping(
            k + 1,
            start_time=50 + 0.2 * k,
            image=scene.image(x, y, (0, 0, yaw_deg)),
            range_m=ROWS * ROW_M,
            range_resolution_m=ROW_M,
            bearings_cdeg=BEARINGS_CDEG,
        )
        # Of the sound in the middle of the image at t_ns: it arrives when all of it is back.
        arrival_ns = t_ns + round(ROWS * ROW_M / 1500 * S)
        middle = len(data) // 2
        found.append((arrival_ns, SONAR, data[:middle]))
        found.append((arrival_ns + 10**6, SONAR, data[middle:]))
    return sorted(found, key=lambda one: one[0])


def chunk_of(t_ns: int, link: str, data: bytes) -> Chunk:
    return Chunk(link, "oculus" if link == SONAR else "odometry-native", t_ns, data)


def decoder_of(config: Config) -> SessionDecoder:
    return SessionDecoder(
        config, OdometryPoses(config), PipelineCounters(), confirm=False, obey=True
    )


def posed(work: Iterable[Any]) -> list[Any]:
    found: list[Any] = []
    for one in work:
        assert isinstance(one, PosedPing)
        pose = one.pose
        if isinstance(pose, FusedPose):
            arrays = pose.pose.position_m, pose.pose.map_q_base, pose.covariance
            found.append((one.number, *(array.tobytes() for array in arrays), pose.segment))
        else:
            found.append((one.number, pose))
    return found


def test_poses_without_any_source_of_velocity() -> None:
    """Within 3 % of the way; a ping waits for the next one, and for nothing else."""
    config, pings = config_of(), 40
    decoder = decoder_of(config)
    found: list[PosedPing] = []
    behind = []
    for t_ns, link, data in stream(pings):
        found += [
            one for one in decoder.feed(chunk_of(t_ns, link, data)) if isinstance(one, PosedPing)
        ]
        behind.append(decoder.waiting)
    assert max(behind[40:]) <= 3
    found += [one for one in decoder.end() if isinstance(one, PosedPing)]
    assert len(found) == pings
    places = {one.number: one.pose for one in found}
    first, last = places[2], places[pings - 2]
    assert isinstance(first, FusedPose)
    assert isinstance(last, FusedPose)
    way = (last.pose.position_m - first.pose.position_m)[:2]
    truth = np.subtract(track(pings - 2)[:2], track(2)[:2])
    assert float(np.hypot(*(way - truth))) < 0.03 * float(np.hypot(*truth))
    std_m = math.sqrt(last.covariance[0, 0])
    assert 0.01 < std_m < 0.5
    assert isinstance(decoder.poses, OdometryPoses)
    bridge = decoder.poses.odometry
    assert bridge.received == bridge.accepted + sum(bridge.rejects.values())
    assert bridge.status()["sonar"]["motions"] > pings - 3


def test_off_by_default() -> None:
    config = config_of(more="").odometry
    plain = config_from_text(
        SETTINGS.replace("PITCH", "0")
        .replace("sonar: {enabled: true}", "")
        .replace("velocity: sonar", "velocity: ''")
    )
    assert config.sonar.enabled
    decoder = decoder_of(plain)
    work = [one for chunk in stream(4) for one in decoder.feed(chunk_of(*chunk))] + decoder.end()
    reasons = {
        one.pose.reason
        for one in work
        if isinstance(one, PosedPing) and isinstance(one.pose, Reject)
    }
    assert reasons == {"no_position"}
    assert isinstance(decoder.poses, OdometryPoses)
    assert decoder.poses.odometry.sonar is None


def test_cut_anywhere_the_poses_are_the_same() -> None:
    config = config_of()
    chunks = [chunk_of(*one) for one in stream(8)]
    whole = decoder_of(config)
    outs: list[Any] = []
    saves: list[tuple[int, bytes]] = []
    for chunk in chunks:
        saves.append((len(outs), encode_state(whole.state())))
        outs += posed(whole.feed(chunk))
    outs += posed(whole.end())
    for at, (before, saved) in list(enumerate(saves))[::3]:
        again = decoder_of(config)
        again.restore(decode_state(saved, SessionDecoderState))
        assert encode_state(again.state()) == saved
        rest = [one for chunk in chunks[at:] for one in again.feed(chunk)] + again.end()
        assert posed(rest) == outs[before:], at


def test_a_state_of_other_settings_is_refused() -> None:
    saved = decoder_of(config_of()).state()
    other = decoder_of(Config())
    with pytest.raises(ValueError, match=r"odometry\.sonar"):
        other.restore(saved)


def test_damaged_pings_are_not_registered() -> None:
    decoder = decoder_of(config_of())
    for t_ns, link, data in stream(6):
        chunk = chunk_of(t_ns, link, data)
        decoder.feed(Chunk(chunk.link, chunk.encoding, t_ns, data, damaged=link == SONAR))
    decoder.end()
    assert isinstance(decoder.poses, OdometryPoses)
    sonar = decoder.poses.odometry.sonar
    assert sonar is not None
    assert sonar.motions == 0
    assert not sonar.silent


def test_another_mounting_begins_again() -> None:
    scene, odometry = Scene(), made()
    odometry.take(scene.ping(0.0, 0.0), START_NS, level())
    odometry.reconfigure(config_of(pitch_deg=0.0))
    motion_of(odometry.take(scene.ping(0.1, 0.0), START_NS + STEP_NS, level()))
    odometry.reconfigure(config_of(pitch_deg=3.0))
    fresh = odometry.take(scene.ping(0.2, 0.0), START_NS + 2 * STEP_NS, level())
    assert isinstance(fresh, Reject)
    assert fresh.reason == "first_ping"


@pytest.mark.usefixtures("no_picture")
@pytest.mark.parametrize("attitude", ["vehicle", "sonar"])
def test_recording_gives_the_map_of_the_live_session(tmp_path: Path, attitude: str) -> None:
    """Also where the mounting was changed on the way."""
    folder = tmp_path / "recordings"
    more = (
        "device: {address: 127.0.0.1}\nbehind: {max_wait: 1.0}\n"
        f"recording: {{folder: '{folder}', max_file: 1, free_floor: 0}}\n"
    )
    text = SETTINGS.replace("PITCH", "0") + more
    config = config_from_text(text.replace("attitude: vehicle", f"attitude: {attitude}"))
    events = [
        Event(t_ns, link, data, gap=i == 0) for i, (t_ns, link, data) in enumerate(stream(14))
    ]
    events.insert(30, Event(events[30].t_ns, "settings", changes={"mounting.orientation.yaw": 5.0}))
    sonar_map, counters = mapped_live(config, events, at_once=0.5, step_ns=10**7, room=64 << 20)
    summary = replayed(folder, tmp_path / "out")
    assert summary["pings_mapped"] == counters.pings_mapped > 8
    assert summary["pings_dropped"] == counters.pings_dropped
    assert summary["map_sha256"] == sonar_map.sha256()


@pytest.mark.slow
def test_drift_in_a_simulated_harbour(tmp_path: Path) -> None:
    """Along the quay without a DVL: at most 5 % of the way."""
    x_m, y_m, z_m = -9.0, -3.0, -3.0
    corners = [(x_m, y_m, 0.0), (7.5, y_m, 0.0), (9.0, -1.5, 90.0), (9.0, -0.5, 90.0)]
    scenario = replace(
        load_scenario("harbour"),
        sonar=sonar_preset("M750d", 1, demanded_range_m=20.0, gain_percent=52.0, beams=256),
        mounting=Mounting((0.4, 0.1, 0.0), pitch_deg=15.0),
        trajectory=Trajectory(
            [Waypoint(x, y, z_m, yaw_deg) for x, y, yaw_deg in corners], Motion(0.6, 20.0)
        ),
        ping_rate_hz=3.0,
    )
    write_capture(tmp_path / "dive.mcap", scenario, CaptureSettings(seed=4, processes=1))
    text = SETTINGS.replace("PITCH", "15").replace("vehicle", "odometry")
    decoder = decoder_of(config_from_text(text))
    with open_recording(tmp_path / "dive.mcap") as chunks:
        work = [one for chunk in chunks for one in decoder.feed(chunk)]
    work += decoder.end()
    at_s, found_m = [], []
    for one in work:
        if isinstance(one, PosedPing) and isinstance(one.pose, FusedPose):
            assert one.t_ns is not None
            at_s.append((one.t_ns - EPOCH_NS) / 1e9)
            found_m.append(one.pose.pose.position_m[:2])
    truth_m = np.array([scenario.trajectory.pose(t).position_m[:2] for t in at_s])
    displacement_m = float(np.hypot(*np.diff(truth_m, axis=0).T).sum())
    drift_m = np.hypot(*((np.array(found_m) - found_m[0]) - (truth_m - truth_m[0])).T)
    assert displacement_m > 15
    assert len(at_s) > 0.9 * len(work)
    assert float(drift_m.max()) < 0.05 * displacement_m
