"""Cameras that follow the vehicle in browsers that report their cameras late."""

import contextlib
from collections import deque
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.viewer.tools import BEHIND_M, Cameras

Floats = NDArray[np.float64]


class LateBrowser:
    """A browser whose reports of its camera may arrive late."""

    client_id = 7

    def __init__(self) -> None:
        self.up_direction: Any = (0.0, 0.0, 1.0)
        self.look_at: Any = np.zeros(3)
        self.camera = self
        self.atomic = contextlib.nullcontext
        self._position: Floats = np.full(3, 3.0)
        self._reports: deque[tuple[Floats, Floats]] = deque()

    @property
    def position(self) -> Floats:
        """As viser's: the target moves with it."""
        return self._position

    @position.setter
    def position(self, position: Floats) -> None:
        self.look_at = self.look_at + (position - self._position)
        self._position = np.asarray(position)

    def report(self) -> None:
        """Show what the server set, and have the oldest report arrive there."""
        self._reports.append((self._position, self.look_at))
        self._position, self.look_at = self._reports.popleft()

    def zoom(self, factor: float) -> None:
        """Move towards the target."""
        self._position = self.look_at + factor * (self._position - self.look_at)

    def fall_behind(self, poses: int) -> None:
        """Have all later reports arrive that number of poses late."""
        self._reports.extend([(self._position, self.look_at)] * poses)


@pytest.mark.parametrize("late", [0, 1, 7])
def test_a_camera_stays_with_the_vehicle_however_late_a_browser_reports(late: int) -> None:
    browser: Any = LateBrowser()
    cameras = Cameras()
    cameras.choose(browser, "follow", np.zeros(3), 0.0)
    browser.zoom(0.5)
    browser.fall_behind(late)
    for step in range(1, 50):
        vehicle = np.array([0.3 * step, 0.1 * step, -2.0])
        cameras.follow([browser], vehicle, 0.0)
        np.testing.assert_allclose(browser.look_at, vehicle, atol=1e-9)
        np.testing.assert_allclose(browser.position, vehicle + 0.5 * BEHIND_M, atol=1e-9)
        browser.report()
