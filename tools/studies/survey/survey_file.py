"""The survey file of the dives, and the settings that they are mapped with."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

VOXEL_M = 0.1
ORIGIN = {"latitude": 53.5, "longitude": 8.1}

SETTINGS: dict[str, Any] = {
    "octree": {"voxel_resolution": VOXEL_M},
    "mounting": {
        "position": {"x": 0.3, "y": 0.0, "z": -0.4},
        "orientation": {"roll": 0.0, "pitch": 90.0, "yaw": 0.0},
    },
}
"""Those of config/survey.yaml, but for coarser voxels, and how the simulated sonar is mounted."""

CONFIGURATION = "mapperd.yaml"


def write_survey(folder: Path, recordings: Sequence[Path], name: str = "survey.yaml") -> Path:
    """Write a survey file and, beside it, the configuration that it names.

    Args:
        folder: of both; recordings are named from here.
        recordings: one a dive, called by their stems.
        name: of the survey file.
    """
    configuration = folder / CONFIGURATION
    configuration.write_text(yaml.safe_dump(SETTINGS, sort_keys=False), encoding="utf-8")
    survey: Mapping[str, Any] = {
        "configuration": CONFIGURATION,
        "origin": ORIGIN,
        "dives": [
            {"name": recording.stem, "recording": str(recording.relative_to(folder))}
            for recording in recordings  # all in the frame of the beacons that they navigate by
        ],
    }
    path = folder / name
    path.write_text(yaml.safe_dump(survey, sort_keys=False), encoding="utf-8")
    return path
