"""A BlueROV2 that a scripted pilot drives over MAVLink through the harbour.

The simulator is served as docs/guides/simulator.md has it. The pose goes to it and to the daemon,
as to two endpoints of BlueOS; the daemon maps what the sonar hears, and both pages show it.
With the environment variable MAPPERD_PICTURES pictures of both are written into that folder.
"""

import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial import cKDTree
from sonar_sim.scene_file import load_scenario

from tests.mapperd.viewer.view_browser import chromium
from tests.support.peers.autopilot import Autopilot
from tests.support.process import free_ports

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.net, pytest.mark.timeout(900)]

PICTURES = os.environ.get("MAPPERD_PICTURES")
VOXEL_M = 0.1
PATIENCE_S = 240.0
RATE_HZ = 20.0
SPEED_MPS, TURN_DPS = 0.6, 20.0
# East, north, up, heading anticlockwise from east, roll to starboard: along the quay and back.
LEGS = (
    (-6.0, 1.2, -2.6, 0.0, 25.0),
    (6.0, 1.2, -2.6, 0.0, 25.0),
    (6.0, -3.6, -2.6, 0.0, 0.0),
    (5.8, -3.8, -2.6, 180.0, 0.0),
    (-4.5, -3.8, -2.6, 180.0, 0.0),
)
MAPPERCTL = "import sys; from mapperd.cli.mapperctl.command import main; sys.exit(main())"
SIMULATOR = "import sys; from sonar_sim.command import main; sys.exit(main())"


class Pilot(threading.Thread):
    """Drives along the legs in real time, and sends what ArduSub sends of it.

    Args:
        ports: UDP ports of this computer to send to.
    """

    def __init__(self, ports: list[int]) -> None:
        super().__init__(daemon=True)
        self._ports = ports
        corners = np.array(LEGS)
        steps = np.diff(corners, axis=0)
        travel_s = np.linalg.norm(steps[:, :3], axis=1) / SPEED_MPS
        turn_s = np.abs(steps[:, 3:]).max(axis=1) / TURN_DPS
        self._at_s = np.concatenate([[0.0], np.cumsum(np.maximum(travel_s, turn_s))])
        self._corners = corners
        self.duration_s = float(self._at_s[-1])
        self.over = threading.Event()

    def run(self) -> None:
        began_s = time.monotonic()
        vehicle = Autopilot()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not self.over.wait(1.0 / RATE_HZ):
                time_s = time.monotonic() - began_s
                vehicle.boot_ms = 60_000 + round(1e3 * time_s)
                here, before = self._state(time_s), self._state(time_s - 0.1)
                east, north, up, yaw, roll = here
                rate_east, rate_north, rate_up, turning, rolling = (here - before) / 0.1
                heading = math.pi / 2 - math.radians(yaw)
                data = vehicle.attitude(
                    (math.radians(roll), 0.0, math.remainder(heading, math.tau)),
                    (math.radians(rolling), 0.0, -math.radians(turning)),
                ) + vehicle.local_position((north, east, -up), (rate_north, rate_east, -rate_up))
                if round(time_s * RATE_HZ) % round(RATE_HZ) == 0:
                    data = vehicle.heartbeat() + data
                for port in self._ports:
                    out.sendto(data, ("127.0.0.1", port))

    def _state(self, time_s: float) -> np.ndarray:
        return np.array([np.interp(time_s, self._at_s, column) for column in self._corners.T])


@contextmanager
def running(*words: str, log: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """A program, interrupted in the end."""
    with log.open("wb") as out:
        program = subprocess.Popen(  # noqa: S603 our own
            [sys.executable, *words], stdout=out, stderr=subprocess.STDOUT
        )
        try:
            yield program
        finally:
            program.send_signal(signal.SIGINT)
            try:
                program.wait(60.0)
            except subprocess.TimeoutExpired:
                program.kill()
                program.wait()


def wait_for_line(log: Path, text: str) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while text not in log.read_text(encoding="utf-8"):
        assert time.monotonic() < end_s, log.read_text(encoding="utf-8")
        time.sleep(0.1)


def opened(browser: "Browser", url: str) -> "Page":
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(1000 * PATIENCE_S)
    page.goto(url)
    page.wait_for_selector("canvas")
    return page


def keep(page: "Page", name: str) -> None:
    if PICTURES:
        page.screenshot(path=Path(PICTURES) / f"{name}.png")


def text_of(page: "Page") -> str:
    return str(page.evaluate("document.body.textContent"))


def test_a_rov_is_driven_over_mavlink_through_the_harbour(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    udp, tcp = socket.SOCK_DGRAM, socket.SOCK_STREAM
    follow, odometry, status, sonar, page_port, view = free_ports(udp, udp, udp, tcp, tcp, tcp)
    config, sock, dive = tmp_path / "rov.yaml", tmp_path / "m.sock", tmp_path / "dive"
    config.write_text(
        f"octree: {{voxel_resolution: {VOXEL_M}}}\n"
        f"device: {{address: 127.0.0.1, port: {sonar}, range: 5.76}}\n"
        "mounting: {position: {x: 0, y: 0, z: -0.5}, orientation: {roll: 0, pitch: 90, yaw: 0}}\n"
        "odometry:\n  sources:\n"
        f"    - {{name: autopilot, format: mavlink, link: 'udp://127.0.0.1:{odometry}'}}\n"
        f"server: {{socket: {sock}}}\n",
        encoding="utf-8",
    )
    logs = {name: tmp_path / f"{name}.log" for name in ("simulator", "daemon", "view")}
    simulator = (
        *("-c", SIMULATOR, "serve", "harbour", "--no-odometry", "--port", str(sonar)),
        *("--follow", f"mavlink://127.0.0.1:{follow}", "--page", str(page_port)),
        *("--status-to", "127.0.0.1", "--status-port", str(status)),
    )
    daemon = ("-m", "mapperd", "--config", str(config), "--out", str(dive))
    viewer = ("-c", MAPPERCTL, "view", "--socket", str(sock), "--port", str(view))
    pilot = Pilot([follow, odometry])
    with ExitStack() as stack:
        stack.callback(pilot.over.set)
        browser = stack.enter_context(chromium())
        stack.enter_context(running(*simulator, log=logs["simulator"]))
        wait_for_line(logs["simulator"], f"page http://127.0.0.1:{page_port}")
        scene = opened(browser, f"http://127.0.0.1:{page_port}")
        pilot.start()
        wait_for_line(logs["simulator"], "harbour ROV: following")
        stack.enter_context(running(*daemon, log=logs["daemon"]))
        seen: list[str] = []
        end_s = time.monotonic() + pilot.duration_s + 10.0
        while time.monotonic() < end_s:
            scene.wait_for_timeout(5000)
            keep(scene, f"driven-{len(seen)}")
            seen.append(text_of(scene))
        stack.enter_context(running(*viewer, log=logs["view"]))
        wait_for_line(logs["view"], str(view))
        live = opened(browser, f"http://127.0.0.1:{view}")
        end_s = time.monotonic() + PATIENCE_S
        while "cells" not in text_of(live) and time.monotonic() < end_s:
            live.wait_for_timeout(500)
        live.wait_for_timeout(10_000 if PICTURES else 1000)
        keep(live, "driven-map")
    report = logs["simulator"].read_text(encoding="utf-8")
    assert "poses of harbour ROV" in report, report
    assert all("following mavlink" in text for text in seen[1:-1]), seen
    assert len({text.partition("m east")[0] for text in seen}) > 4, "it moved on the page"
    errors_m = distances_m(dive / "map.ply")
    assert len(errors_m) > 3000, logs["daemon"].read_text(encoding="utf-8")
    assert np.median(errors_m) <= VOXEL_M
    assert np.quantile(errors_m, 0.75) <= 2.5 * VOXEL_M, "an echo's elevation is not known"


def distances_m(cloud: Path) -> np.ndarray:
    """From each occupied cell of a map to the harbour's nearest surface, (N,)."""
    plyfile = pytest.importorskip("plyfile")
    points = plyfile.PlyData.read(str(cloud))["vertex"]
    cells = np.stack([points[axis] for axis in "xyz"], axis=1)
    triangles = load_scenario("harbour").scene.triangles_m
    near = np.abs(triangles.mean(axis=1)[:, 0]) < 16.0
    generator = np.random.default_rng(0)
    corners = triangles[near]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    chosen = generator.choice(len(corners), 400_000, p=area / area.sum())
    a, b = np.sqrt(generator.random((400_000, 1))), generator.random((400_000, 1))
    first, second, third = corners[chosen].transpose(1, 0, 2)
    samples = (1.0 - a) * first + a * (1.0 - b) * second + a * b * third
    found: np.ndarray = cKDTree(samples).query(cells)[0]
    return found
