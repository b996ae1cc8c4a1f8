"""Scenarios from YAML: the shipped ones by name, others by path."""

from pathlib import Path

from sonar_sim.errors import SceneMissingError
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene_file.build import build_scenario
from sonar_sim.scene_file.yaml_reader import read_scene_file

SHIPPED = Path(__file__).resolve().parent.parent / "scenes"


def scene_names() -> list[str]:
    """Names of the shipped scenes, sorted."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario.

    Args:
        name_or_path: a shipped scene's name, or a file's path (with a folder or an ending).

    Raises:
        SceneError: the scene is missing or invalid; one line with file, place and reason.
    """
    path = Path(name_or_path)
    if path.suffix == "" and path.parent == Path():
        path = SHIPPED / f"{path}.yaml"
        if not path.is_file():
            known = ", ".join(scene_names())
            raise SceneMissingError(f"no scene is named {name_or_path}; use {known}, or a file")
    return build_scenario(path.stem, read_scene_file(path), path.parent)


__all__ = ["SHIPPED", "load_scenario", "scene_names"]
