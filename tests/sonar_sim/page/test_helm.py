"""The pilot's keys, and what the page draws of a ping."""

import numpy as np
import pytest
from sonar_sim.geometry.live_path import LivePath
from sonar_sim.geometry.pose import FramePose
from sonar_sim.geometry.trajectory import Motion, Route, Trajectory, Waypoint
from sonar_sim.page.helm import KEYS, Helm
from sonar_sim.page.scene_view import IMAGE_TURN, PingPictures, ping_of
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.water import Water
from sonar_sim.wire import ping_message

CALM = Motion(speed_mps=0.5, sway_deg=0.0, heave_m=0.0)


class Bridge:
    """A helm with a clock of its own."""

    def __init__(self) -> None:
        path = Trajectory([Waypoint(0, 0, -3, 0), Waypoint(20, 0, -3, 0)], CALM)
        self.now_s = 0.0
        self.live = LivePath(path.pose(0.0))
        self.helm = Helm(Route(path, "stay"), self.live, lambda: self.now_s)

    def sail(self, seconds: float) -> np.ndarray:
        for _ in range(round(seconds / 0.05)):
            self.now_s += 0.05
            self.helm.advance(self.now_s)
        return self.live.pose(self.now_s).position_m


def test_the_path_is_followed_until_a_key_takes_over_and_waits_meanwhile() -> None:
    bridge = Bridge()
    assert bridge.sail(10.0)[0] == pytest.approx(5.0, abs=0.05)
    bridge.helm.press("H")
    assert bridge.helm.mode == "keys"
    below = bridge.sail(5.0)
    assert below == pytest.approx([5.0, 0.0, -3.0 - 0.3 * (5.0 - 0.6)], abs=0.03)
    bridge.helm.press("space")
    stopped = bridge.sail(5.0)
    assert bridge.sail(1.0) == pytest.approx(stopped, abs=0.01)
    bridge.helm.steer("path")
    assert bridge.live.pose(bridge.now_s).position_m == pytest.approx([5.0, 0.0, -3.0], abs=0.05)
    assert bridge.sail(2.0)[0] == pytest.approx(6.0, abs=0.05)


def test_the_opposite_key_stops_and_then_turns() -> None:
    helm = Bridge().helm
    speeds = []
    for key in ("I", "I", "K", "K", "K"):
        helm.press(key)
        speeds.append(helm.command.ahead_mps)
    assert speeds == [0.6, 0.6, 0.0, -0.6, -0.6]
    helm.press("J")
    helm.press("U")
    helm.press("Y")
    command = helm.command
    assert command.turn_rps > 0.0, "to port"
    assert (command.port_mps, command.up_mps) == pytest.approx((0.36, 0.3))
    helm.speed_mps = 1.2
    assert helm.command.port_mps == pytest.approx(0.72)


def test_each_key_has_its_own_meaning() -> None:
    assert len(set(KEYS.values())) == len(KEYS) == 9


def message_with_echo(row: int, beam: int) -> bytes:
    sonar = SonarSettings(demanded_range_m=4.0, beams=256, forced_rows=200)
    image = np.zeros((200, 256), np.uint8)
    image[row - 2 : row + 3, beam - 3 : beam + 4] = 255
    return ping_message(
        image, ping_id=3, start_time_s=1.0, heading_deg=0.0, sonar=sonar, water=Water()
    )


@pytest.mark.parametrize(("row", "beam"), [(100, 127), (150, 200), (60, 40)])
def test_a_picture_shows_an_echo_at_its_place(row: int, beam: int) -> None:
    ping = ping_of(message_with_echo(row, beam))
    assert ping is not None
    pictures = PingPictures()
    texture, width_m, height_m = pictures.texture(ping)
    place = np.argwhere(texture[..., 3] > 200).mean(axis=0) + 0.5
    ahead_m = height_m * (1.0 - place[0] / texture.shape[0])
    right_m = width_m * (place[1] / texture.shape[1] - 0.5)
    range_m = (row + 0.5) * 0.02
    bearing = ping.bearings_rad[beam]
    assert (right_m, ahead_m) == pytest.approx(
        (range_m * np.sin(bearing), range_m * np.cos(bearing)), abs=0.05
    )
    assert texture[0, 0, 3] == 0, "clear outside of the fan"
    panel = pictures.panel(ping)
    assert panel.dtype == np.uint8
    assert panel.max() > 200


def test_a_message_that_is_no_ping_has_no_picture() -> None:
    assert ping_of(b"nothing" * 20) is None


def test_the_picture_lies_in_the_fans_plane() -> None:
    at = FramePose(np.zeros(3), np.eye(3))
    turned = (at @ FramePose(np.zeros(3), IMAGE_TURN)).rotation
    assert turned @ [1.0, 0.0, 0.0] == pytest.approx([0.0, -1.0, 0.0]), "right is starboard"
    assert turned @ [0.0, 1.0, 0.0] == pytest.approx([-1.0, 0.0, 0.0]), "down is astern"
    assert np.linalg.det(IMAGE_TURN) == pytest.approx(1.0)
