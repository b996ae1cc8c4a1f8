from collections.abc import Mapping
from typing import Any

import pytest

from mapperd import SonarTo3DMapper
from mapperd.compat.parameters import (
    CROSSTALK_PARAMS,
    FIXED,
    MAPPER_PARAMS,
    OF_THE_NODE,
    ROBOT_DETECTION_PARAMS,
    VISUALIZER_PARAMS,
    WORLD_INIT_PARAMS,
    ParameterDef,
    ParameterManager,
    ParameterNode,
    SetParametersResult,
)
from mapperd.config.catalog import parameters, value_of
from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore, Refused
from mapperd.config.tree import Config
from mapperd.errors import ConfigError

MIN_RANGE, THRESHOLD = "filtering.min_range", "filtering.intensity_threshold"
FILTERING = [one for one in MAPPER_PARAMS if one.name.startswith("filtering.")]


class Mapper:
    """Takes what the handlers of `filtering` give it; no threshold above 100."""

    def __init__(self) -> None:
        self.reported: list[tuple[str, float]] = []

    def update_min_range(self, value: float) -> None:
        self.reported.append(("min_range", value))

    def update_intensity(self, value: float) -> None:
        if value > 100:
            raise ValueError("too high for me")
        self.reported.append(("intensity", value))

    def update_filtering_noise_factor(self, value: float) -> None:
        self.reported.append(("noise_factor", value))


def following() -> tuple[ParameterNode, ConfigStore, Mapper]:
    store, mapper = ConfigStore(Layered()), Mapper()
    node = ParameterNode(store)
    ParameterManager.declare_all(node, MAPPER_PARAMS)
    callback = ParameterManager.create_callback(node, FILTERING, mapper)
    node.add_on_set_parameters_callback(callback)
    return node, store, mapper


def test_lists_hold_the_settings_as_they_are() -> None:
    lists = (MAPPER_PARAMS, CROSSTALK_PARAMS, ROBOT_DETECTION_PARAMS, WORLD_INIT_PARAMS)
    for one in (one for each in lists for one in each if one.name not in FIXED):
        setting = parameters()[one.name]
        assert (one.default, one.description) == (setting.default, setting.description)
        assert one.read_only != setting.dynamic
        of_the_mapper = not one.name.startswith(OF_THE_NODE)
        assert bool(one.handler) == (of_the_mapper and not one.read_only)
    assert MAPPER_PARAMS[0].name == "sonar.horizontal_fov"
    handlers = {one.name: one.handler for one in MAPPER_PARAMS}
    assert handlers[THRESHOLD] == "update_intensity"
    assert handlers["iwlo.sharpness"] == ""


def test_declared_parameters_are_read_together() -> None:
    node = ParameterNode(ConfigStore(Layered()))
    ParameterManager.declare_all(node, MAPPER_PARAMS)
    values = ParameterManager.get_all(node, MAPPER_PARAMS)
    assert list(values) == [one.name for one in MAPPER_PARAMS]
    assert values["octree.voxel_resolution"] == 0.05
    assert values["octree.use_cpp_backend"] is True
    refused = node.set_parameters({"octree.use_cpp_backend": False})
    assert refused.reason == "octree.use_cpp_backend: is read-only"
    with pytest.raises(ConfigError, match=r"crosstalk\.enabled: is not declared"):
        ParameterManager.get_all(node, CROSSTALK_PARAMS)


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        (ParameterDef("octree.size", 1, "", read_only=True, handler=""), "no such setting"),
        (FILTERING[0], "is declared already"),
        (
            ParameterDef("iwlo.L_occ", 3.5, "", read_only=False, handler="x"),
            "cannot change while running",
        ),
    ],
)
def test_what_cannot_be_declared_is_refused(definition: ParameterDef, words: str) -> None:
    node = ParameterNode(ConfigStore(Layered()))
    node.declare_parameter(FILTERING[0])
    with pytest.raises(ConfigError, match=words):
        node.declare_parameter(definition)


def test_handlers_hear_of_changes_anyone_who_makes_them() -> None:
    node, store, mapper = following()
    assert node.set_parameters({MIN_RANGE: 1.0, THRESHOLD: 50}) == SetParametersResult(True)  # noqa: FBT003
    assert isinstance(store.apply({THRESHOLD: 60}, "broker"), Applied)
    assert mapper.reported == [("min_range", 1.0), ("intensity", 50), ("intensity", 60)]
    assert node.get_parameter(THRESHOLD) == 60


def test_handler_that_refuses_undoes_all() -> None:
    node, store, mapper = following()
    result = node.set_parameters({MIN_RANGE: 1.0, THRESHOLD: 200})
    assert not result.successful
    assert "too high for me" in result.reason
    assert mapper.reported == [("min_range", 1.0), ("min_range", 0.5)]
    assert store.current == Config()
    assert node.set_parameters({MIN_RANGE: 1.0}).successful
    assert mapper.reported[-1] == ("min_range", 1.0)
    assert not node.set_parameters({MIN_RANGE: 2.0, THRESHOLD: 200}).successful
    assert mapper.reported[-2:] == [("min_range", 2.0), ("min_range", 1.0)]


def test_every_handler_is_a_method_of_the_mapper() -> None:
    store, mapper = ConfigStore(Layered()), SonarTo3DMapper({"voxel_resolution": 0.2})
    node = ParameterNode(store)
    definitions = (*MAPPER_PARAMS, *CROSSTALK_PARAMS, *ROBOT_DETECTION_PARAMS)
    ParameterManager.declare_all(node, definitions)
    callback = ParameterManager.create_callback(node, definitions, mapper)
    node.add_on_set_parameters_callback(callback)
    values = {
        MIN_RANGE: 1.0,
        THRESHOLD: 50.0,
        "mounting.orientation.pitch": 30.0,
        "mapping.free_threshold": 0.75,  # above occupied_threshold as it was
        "mapping.occupied_threshold": 0.8,
        "mapping.angular_cone_width": 1.0,
        "mapping.integrator": "rays",
        "processing.frame_skip": 2,
        "crosstalk.enabled": True,
        "crosstalk.morpho_kernel_shape": "cross",
        "terrain_detection.max_threshold": 170.0,
        "robot_detection.enabled": True,
        "time_sync.policy": "latest",  # of the node
    }
    assert node.set_parameters(values) == SetParametersResult(True)  # noqa: FBT003
    for name, value in values.items():
        assert value_of(store.current, name) == value
        if not name.startswith(OF_THE_NODE):
            assert value_of(mapper.config, name) == value, name
    assert not node.set_parameters({"robot_detection.min_threshold": 100}).successful
    assert mapper.config.robot_detection.min_threshold == 180


def test_parameters_of_the_visualizer_are_settings() -> None:
    node = ParameterNode(ConfigStore(Layered()))
    ParameterManager.declare_all(node, VISUALIZER_PARAMS)
    assert node.has_parameter("mapping.occupied_threshold")
    assert not node.has_parameter(MIN_RANGE)


def test_refusal_elsewhere_takes_the_handlers_back() -> None:
    node, store, mapper = following()

    def no(_: Config) -> None:
        if store.current.filtering.min_range == 1:
            raise ConfigError("no", "$.filtering.min_range")

    store.follow(["filtering"], no)
    assert isinstance(store.apply({MIN_RANGE: 1}, "x"), Refused)
    assert mapper.reported == [("min_range", 1.0), ("min_range", 0.5)]
    assert node.get_parameter(MIN_RANGE) == 0.5


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"iwlo.sharpness": 1.0}, "iwlo.sharpness: is read-only"),
        ({"crosstalk.enabled": True}, "crosstalk.enabled: is not declared"),
        ({MIN_RANGE: -1}, "filtering.min_range: -1 is not allowed; allowed: a number >= 0"),
        ({"processing.frame_skip": 2}, "nothing that runs follows this setting"),
    ],
)
def test_other_changes_are_refused_with_their_reason(
    changes: Mapping[str, Any], reason: str
) -> None:
    store = ConfigStore(Layered())
    node = ParameterNode(store)
    ParameterManager.declare_all(node, MAPPER_PARAMS)
    result = node.set_parameters(changes)
    assert not result.successful
    assert reason in result.reason
    assert store.current == Config()


def test_mapper_without_a_handler_is_refused_at_once() -> None:
    node = ParameterNode(ConfigStore(Layered()))
    ParameterManager.declare_all(node, MAPPER_PARAMS)
    with pytest.raises(ConfigError, match=r"min_range: .*update_min_range"):
        ParameterManager.create_callback(node, FILTERING, object())
