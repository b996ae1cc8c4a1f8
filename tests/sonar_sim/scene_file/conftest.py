"""Scene files on the disk."""

from collections.abc import Callable
from pathlib import Path

import pytest
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene_file import load_scenario

MINIMUM = """
trajectory:
  waypoints:
    - {position_m: [0, 0, -2]}
    - {position_m: [5, 0, -2]}
"""
FLAT = """
terrain: {relief: {kind: flat, depth_m: 5}, x_m: [-4, 4], y_m: [-3, 3], cell_m: 0.5}
"""
Load = Callable[..., Scenario]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Write a file, the shortest that is valid and what is added to it, and load it."""

    def load_text(text: str = "", *, whole: bool = False) -> Scenario:
        path = tmp_path / "scene.yaml"
        path.write_text(text if whole else MINIMUM + text, encoding="utf-8")
        return load_scenario(path)

    return load_text


@pytest.fixture
def flat() -> str:
    """A level floor, 5 m down, 8 m x 6 m."""
    return FLAT
