"""Every parameter of sonar_3d_reconstruction: name, default, unit, limits, and if it is live."""

from pathlib import Path
from typing import Any

import pytest

from mapperd.config.catalog import Parameter, parameters, value_of
from mapperd.config.layers import Layered, load_files
from mapperd.config.live import Applied, ConfigStore
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.daemon.map_folder import MapFolder
from mapperd.daemon.run import FOLLOWS as SAVES
from mapperd.daemon.sonar_control import SonarControl
from mapperd.errors import ConfigError
from mapperd.imaging.filter_chain import check_filters
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.pipeline.step import Stages
from mapperd.server.map_worker import MapWorker
from mapperd.telemetry.telemetry import Telemetry

ANY = (None, None)
TURN = (-360, 360)
BRIGHTNESS = (0, 255)
SHARE = (0, 1)

PUBLISHED: dict[str, tuple[Any, str, tuple[float | None, float | None], bool]] = {
    "sonar.horizontal_fov": (130.0, "deg", (0, 180), False),
    "sonar.vertical_aperture": (14.0, "deg", (0, 90), False),  # theirs was 20, the one-way width
    "filtering.min_range": (0.5, "m", (0, 100), True),
    "filtering.intensity_threshold": (35, "0-255", BRIGHTNESS, True),
    "mounting.position.x": (0.0, "m", (-100, 100), False),
    "mounting.position.y": (0.0, "m", (-100, 100), False),
    "mounting.position.z": (-0.5, "m", (-100, 100), False),
    "mounting.orientation.roll": (0.0, "deg", TURN, True),
    "mounting.orientation.pitch": (90.0, "deg", TURN, True),
    "mounting.orientation.yaw": (0.0, "deg", TURN, True),
    "octree.voxel_resolution": (0.05, "m", (0.001, 100), False),
    "mapping.occupied_threshold": (0.7, "", SHARE, True),
    "mapping.angular_cone_width": (0.5, "", (0, 100), True),
    "iwlo.L_occ": (3.5, "log-odds", (0, 127), False),
    "iwlo.L_free": (-3.0, "log-odds", (-127, 0), False),
    "iwlo.L_min": (-10.0, "log-odds", (-127, 0), False),
    "iwlo.L_max": (10.0, "log-odds", (0, 127), False),
    "iwlo.sharpness": (3.0, "", (0, 1000), False),
    "iwlo.decay_rate": (0.1, "", (0, 1000), False),
    "iwlo.min_alpha": (0.1, "", SHARE, False),
    "iwlo.intensity_max": (255, "0-255", BRIGHTNESS, False),
    "adaptive.update": (True, "", ANY, False),
    "adaptive.threshold": (0.5, "", SHARE, False),
    "adaptive.max_ratio": (0.3, "", SHARE, False),
    "outofcore.use": (False, "", ANY, False),
    "outofcore.map_path": ("", "a path or nothing", ANY, False),  # theirs was a developer's folder
    "outofcore.tile_size": (10.0, "m", (0.01, 10000), False),
    "outofcore.cache_size": (16, "tiles", (1, 1000000), False),
    "crosstalk.enabled": (False, "", ANY, True),
    "crosstalk.morpho_enabled": (True, "", ANY, True),
    "crosstalk.morpho_kernel_size": (5, "rows", (2, 101), True),
    "crosstalk.morpho_kernel_shape": ("rect", "", ANY, True),
    "crosstalk.azimuth_enabled": (True, "", ANY, True),
    "crosstalk.azimuth_threshold": (0.5, "0-1", SHARE, True),
    "terrain_detection.min_threshold": (80, "0-255", BRIGHTNESS, True),
    "terrain_detection.max_threshold": (180, "0-255", BRIGHTNESS, True),
    "robot_detection.enabled": (False, "", ANY, True),
    "robot_detection.min_threshold": (180, "0-255", BRIGHTNESS, True),
    "robot_detection.topic": ("/sonar_robot_detections", "a topic", ANY, False),
    "processing.frame_skip": (1, "pings", (1, 1000), True),
    "frames.sonar": ("sonar_link", "a name", ANY, False),
    "frames.base": ("base_link", "a name", ANY, False),
    "frames.map": ("map", "a name", ANY, False),
    "frames.publish_tf": (True, "", ANY, False),
    "visualization.tile_save_interval": (5.0, "s", (0, 3600), True),
}
"""Default, unit, limits, live; where the published page gives no limits or unit, they are ours."""

OTHERS = {"crosstalk.morpho_kernel_shape": "cross", "crosstalk.morpho_kernel_size": 7}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_parameter_is_there(name: str) -> None:
    default, unit, limits, live = PUBLISHED[name]
    parameter = parameters()[name]
    assert parameter.default == default
    assert type(parameter.default) is type(default) or isinstance(default, int)
    assert (parameter.unit, parameter.dynamic, limits_of(parameter)) == (unit, live, limits)


def limits_of(parameter: Parameter) -> tuple[float | None, float | None]:
    (meta,) = parameter.annotation.__metadata__
    low = meta.ge if meta.ge is not None else meta.gt
    return low, meta.le if meta.le is not None else meta.lt


def another(name: str) -> Any:
    """A value that a live setting may take and that is not its default."""
    default = parameters()[name].default
    if isinstance(default, bool):
        return not default
    if name in OTHERS:
        return OTHERS[name]
    return default + 1 if default >= 1 else default + 0.1


@pytest.mark.parametrize("name", [name for name, (*_, live) in PUBLISHED.items() if live])
def test_published_live_parameter_changes_while_running(name: str) -> None:
    store = ConfigStore(Layered())
    sonar_map = SonarMap(store.current)
    executor = PingExecutor(Stages(sonar_map), MemoryPersistence(sonar_map))
    store.follow((*PingExecutor.FOLLOWS, "visualization"), executor.reconfigure, check_filters)
    result = store.apply({name: another(name)}, "test")
    assert isinstance(result, Applied)
    assert value_of(store.current, name) == another(name)
    assert executor._config is store.current


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "visualization: {pointcloud_publish_rate: 3}",
            "pointcloud_publish_rate has no effect and is ignored (set stream.rate",
        ),
        ("octree: {use_cpp_backend: true}", "(the core is in C++)"),
        ("visualization: {show_opencv_visualization: true}", "(`mapperctl view` shows"),
    ],
)
def test_published_name_without_an_effect_reports_what_to_do_instead(
    tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "mapper.yaml"
    path.write_text(text, encoding="utf-8")
    layered = load_files([path])
    assert layered.config == Config()
    assert words in layered.notice


def test_topics_are_those_of_the_bridge_to_ros() -> None:
    topics = config_from_text("topics: {sonar: /my/sonar, pointcloud: cloud}").topics
    assert (topics.sonar, topics.pointcloud) == ("/my/sonar", "cloud")
    assert (topics.odometry, topics.marker) == ("/fast_lio/odometry", "/sonar_3d_map_markers")
    with pytest.raises(ConfigError, match="topics"):
        config_from_text("topics: {sonar: 'my sonar'}")


def test_a_mistake_beside_ignored_settings_is_named() -> None:
    with pytest.raises(ConfigError, match="topics"):
        config_from_text("topics: {sonar: /my/sonar, sonars: /my/sonar}")


def test_every_live_setting_has_a_follower() -> None:
    ours = (*PingExecutor.FOLLOWS, *Telemetry.FOLLOWS, *MapFolder.FOLLOWS, *MapWorker.FOLLOWS)
    followed = (*ours, *SonarControl.FOLLOWS, *SAVES)
    live = [name for name, one in parameters().items() if one.dynamic]
    assert [name for name in live if not name.startswith(followed)] == []


NODE_FILE = """\
# config/mapper_params.yaml
sonar_3d_mapper:
  ros__parameters:
    # Sonar
    sonar:
      horizontal_fov: 130.0
      vertical_aperture: 20.0

    # Filtering
    filtering:
      min_range: 0.5
      intensity_threshold: 50

    # Mounting
    mounting:
      position:
        x: 0.0
        y: 0.0
        z: -0.5
      orientation:
        roll: 0.0
        pitch: 90.0
        yaw: 0.0

    # Octree
    octree:
      voxel_resolution: 0.1
      use_cpp_backend: true

    # IWLO
    iwlo:
      sharpness: 3.0
      L_occ: 3.5
      L_free: -3.0

    # Out-of-Core (disabled)
    outofcore:
      use: false
"""
"""sonar_3d_reconstruction's own example."""


def test_parameter_file_of_a_node_loads(tmp_path: Path) -> None:
    path = tmp_path / "mapper_params.yaml"
    path.write_text(NODE_FILE, encoding="utf-8")
    layered = load_files([path])
    assert layered.config.sonar.vertical_aperture == 20.0
    assert layered.config.filtering.intensity_threshold == 50
    assert layered.config.octree.voxel_resolution == 0.1
    assert layered.origin_of("iwlo.sharpness") == str(path)
    assert "octree.use_cpp_backend has no effect" in layered.notice


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("ros__parameters: {iwlo: {sharpness: 2}}", "iwlo.sharpness", 2.0),
        ("/**: {ros__parameters: {iwlo.sharpness: 2}}", "iwlo.sharpness", 2.0),
        ("auv: {mapper: {ros__parameters: {iwlo: {sharpness: 2}}}}", "iwlo.sharpness", 2.0),
        ("amcl: {ros__parameters: {max_particles: 300}}", "amcl.max_particles", 300),
        ("amcl: {ros__parameters: {amcl: {max_particles: 300}}}", "amcl.max_particles", 300),
        (
            (
                "a: {ros__parameters: {octree: {voxel_resolution: 0.1}}}\n"
                "b: {ros__parameters: {octree.voxel_resolution: 0.1, amcl: {max_particles: 300}}}"
            ),
            "amcl.max_particles",
            300,
        ),
    ],
)
def test_nodes_are_settings_together(text: str, name: str, value: object) -> None:
    assert value_of(config_from_text(text), name) == value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: {ros__parameters: {iwlo: {sharpnes: 2}}}", "iwlo.sharpnes: .*did you mean sharpness"),
        ("a: {ros__parameters: 3}", "a.ros__parameters: a mapping of sections was expected"),
        ("iwlo: {sharpness: 2}\na: {ros__parameters: {}}", "iwlo: stands beside nodes"),
        (
            (
                "a: {ros__parameters: {iwlo: {sharpness: 1}}}\n"
                "b: {ros__parameters: {iwlo: {sharpness: 2}}}"
            ),
            "b: iwlo.sharpness: is set otherwise in a",
        ),
        ("a: {ros__parameters: {iwlo: 3, iwlo.sharpness: 3}}", "iwlo.sharpness: is set otherwise"),
    ],
)
def test_mistakes_in_files_of_nodes_are_named(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        config_from_text(text)
