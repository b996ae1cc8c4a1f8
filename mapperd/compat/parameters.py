"""sonar_3d_reconstruction's way to declare, read and change parameters, over our settings.

A node declares parameters, reads them, and has a callback that calls a handler of the mapper for
each that changed. Here the node is a thin view of the store of settings: values, limits and
what may change while running are the settings' own, and callbacks receive every change from any
source. A callback that refuses undoes the change.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from mapperd.config.aliases import IGNORED
from mapperd.config.catalog import Parameter, parameters, value_of
from mapperd.config.live import ConfigStore, Refused
from mapperd.config.tree import Config
from mapperd.errors import ConfigError

__all__ = [
    "CROSSTALK_PARAMS",
    "MAPPER_PARAMS",
    "ROBOT_DETECTION_PARAMS",
    "UPDATES",
    "VISUALIZER_PARAMS",
    "WORLD_INIT_PARAMS",
    "ParameterDef",
    "ParameterManager",
    "ParameterNode",
    "SetParametersResult",
    "UpdateHandlers",
]

HANDLERS = {
    "filtering.min_range": "update_min_range",
    "filtering.intensity_threshold": "update_intensity",
    "mapping.occupied_threshold": "update_occupied_threshold",
    "mapping.angular_cone_width": "update_angular_cone",
    "processing.frame_skip": "update_frame_skip",
}
"""Methods that sonar_3d_reconstruction has; other parameters are `update_` and their own name."""


@dataclass(frozen=True, slots=True)
class ParameterDef:
    """A parameter as a node declares it.

    Attributes:
        name: such as `iwlo.sharpness`.
        default: default value.
        description: what it does.
        read_only: it cannot change at run time.
        handler: method of the mapper that takes a new value; "" for read-only ones, and for those
            of the node itself, which reads them.
    """

    name: str
    default: Any
    description: str
    read_only: bool
    handler: str


@dataclass(frozen=True, slots=True)
class SetParametersResult:
    """Whether a change holds, and why not."""

    successful: bool
    reason: str = ""


FIXED: dict[str, Any] = {
    "octree.dynamic_expansion": True,
    "octree.use_cpp_backend": True,
    "visualization.pointcloud_publish_rate": 10.0,
    "visualization.show_opencv_visualization": False,
}
"""Published parameters without effect: a node reads their published defaults."""

OF_THE_NODE = ("time_sync", "slam_quality", "frames", "topics", "visualization")
"""Sections that no mapper has handlers for."""

Callback = Callable[[Mapping[str, Any]], SetParametersResult]


def _definitions(*sections: str) -> tuple[ParameterDef, ...]:
    fixed = (
        ParameterDef(name, value, f"No effect: {IGNORED[name]}.", read_only=True, handler="")
        for name, value in FIXED.items()
        if name.partition(".")[0] in sections
    )
    settings = (
        ParameterDef(
            one.name,
            one.default,
            one.description,
            not one.dynamic,
            _handler(one),
        )
        for one in parameters().values()
        if one.name.partition(".")[0] in sections
    )
    return (*settings, *fixed)


def _handler(setting: Parameter) -> str:
    if not setting.dynamic or setting.name.partition(".")[0] in OF_THE_NODE:
        return ""
    return HANDLERS.get(setting.name, f"update_{setting.name.replace('.', '_')}")


MAPPER_PARAMS = _definitions(
    "sonar",
    "filtering",
    "mounting",
    "octree",
    "mapping",
    "iwlo",
    "adaptive",
    "outofcore",
    "processing",
    "time_sync",
    "slam_quality",
    "frames",
    "topics",
    "visualization",
)
CROSSTALK_PARAMS = _definitions("crosstalk")
ROBOT_DETECTION_PARAMS = _definitions("terrain_detection", "robot_detection")
WORLD_INIT_PARAMS = _definitions("world_init")
VISUALIZER_PARAMS = _definitions(
    "octree", "mapping", "outofcore", "frames", "topics", "visualization"
)


class ParameterNode:
    """What has declared parameters.

    Args:
        store: the settings behind them.
    """

    def __init__(self, store: ConfigStore) -> None:
        self._store = store
        self._declared: dict[str, ParameterDef] = {}

    def declare_parameter(self, definition: ParameterDef) -> Any:  # noqa: ANN401 any setting
        """Make a parameter known to the node; returns its value.

        Raises:
            ConfigError: there is no such setting, it may not change while running though the
                definition forbids it, or it is already declared.
        """
        name = definition.name
        setting = parameters().get(name)
        if setting is None and name not in FIXED:
            raise ConfigError(f"{name}: there is no such setting", f"$.{name}")
        if name in self._declared:
            raise ConfigError(f"{name}: is declared already", f"$.{name}")
        if not definition.read_only and not (setting and setting.dynamic):
            raise ConfigError(f"{name}: cannot change while running", f"$.{name}")
        self._declared[name] = definition
        return self.get_parameter(name)

    def has_parameter(self, name: str) -> bool:
        """Whether a parameter is declared."""
        return name in self._declared

    def get_parameter(self, name: str) -> Any:  # noqa: ANN401 any setting
        """The value in force.

        Raises:
            ConfigError: it is not declared.
        """
        if name not in self._declared:
            raise ConfigError(f"{name}: is not declared", f"$.{name}")
        return FIXED[name] if name in FIXED else value_of(self._store.current, name)

    def set_parameters(self, changes: Mapping[str, Any]) -> SetParametersResult:
        """Change parameters, all or none."""
        reasons = {}
        for name in changes:
            if name not in self._declared:
                reasons[name] = "is not declared"
            elif self._declared[name].read_only:
                reasons[name] = "is read-only"
        if not reasons:
            result = self._store.apply(changes, "parameters")
            reasons = dict(result.reasons) if isinstance(result, Refused) else {}
        reason = "; ".join(f"{name}: {why}" for name, why in reasons.items())
        return SetParametersResult(not reasons, reason)

    def add_on_set_parameters_callback(self, callback: Callback) -> None:
        """Call a callback with every change of the declared parameters."""
        names = [name for name, one in self._declared.items() if not one.read_only]
        last = {name: self.get_parameter(name) for name in names}

        def take(config: Config) -> None:
            new = {name: value_of(config, name) for name in names}
            changes = {name: value for name, value in new.items() if value != last[name]}
            if not changes:
                return
            result = callback(changes)
            if not result.successful:
                raise ConfigError(result.reason, f"$.{next(iter(changes))}")
            last.update(changes)

        self._store.follow(names, take)


class ParameterManager:
    """The three things that one does with a list of definitions."""

    @staticmethod
    def declare_all(node: ParameterNode, definitions: Iterable[ParameterDef]) -> None:
        """Declare them.

        Raises:
            ConfigError: as `ParameterNode.declare_parameter`.
        """
        for definition in definitions:
            node.declare_parameter(definition)

    @staticmethod
    def get_all(node: ParameterNode, definitions: Iterable[ParameterDef]) -> dict[str, Any]:
        """Their values, by name.

        Raises:
            ConfigError: one is not declared.
        """
        return {one.name: node.get_parameter(one.name) for one in definitions}

    @staticmethod
    def create_callback(
        node: ParameterNode,
        definitions: Iterable[ParameterDef],
        mapper: object,
    ) -> Callback:
        """A callback that gives each new value to its handler.

        A handler that raises `ValueError` or `ConfigError` is tried again after the others, whose
        values may allow its own. If it still does, the others are given the old values again and
        the change is refused.

        Args:
            node: where the old values are.
            definitions: whose handlers; other parameters are passed over.
            mapper: has the handlers.

        Raises:
            ConfigError: the mapper lacks one of them.
        """
        handlers: dict[str, Callable[[Any], None]] = {}
        for one in definitions:
            if one.handler and not one.read_only:
                handler = getattr(mapper, one.handler, None)
                if handler is None:
                    raise ConfigError(f"{one.name}: the mapper has no {one.handler}", one.name)
                handlers[one.name] = handler
        held = {name: node.get_parameter(name) for name in handlers}

        def callback(changes: Mapping[str, Any]) -> SetParametersResult:
            mine = {name: value for name, value in changes.items() if name in handlers}
            done, reason = _handed_over(mine, handlers)
            if reason:
                _handed_over({name: held[name] for name in reversed(done)}, handlers)
                return SetParametersResult(successful=False, reason=reason)
            held.update(mine)
            return SetParametersResult(successful=True)

        return callback


def _handed_over(
    values: Mapping[str, Any], handlers: Mapping[str, Callable[[Any], None]]
) -> tuple[list[str], str]:
    """Call handlers; return the names whose handlers accepted, and the first reason of a refusal.

    Handlers that refuse are called again after the others.
    """
    done: list[str] = []
    while len(done) < len(values):
        before, reason = len(done), ""
        for name in (name for name in values if name not in done):
            try:
                handlers[name](values[name])
                done.append(name)
            except (ValueError, ConfigError) as error:
                reason = reason or str(error)
        if len(done) == before:
            return done, reason
    return done, ""


UPDATES = frozenset(
    one.name for one in (*MAPPER_PARAMS, *CROSSTALK_PARAMS, *ROBOT_DETECTION_PARAMS) if one.handler
)
"""Settings that a mapper may change while it maps."""


def _update_of(name: str) -> "Callable[[UpdateHandlers, Any], None]":
    def update(self: "UpdateHandlers", value: Any) -> None:  # noqa: ANN401 any setting
        self.update({name: value})

    update.__doc__ = f"Set `{name}` for the images to come; as `update`."
    return update


class UpdateHandlers:
    """The handlers of `MAPPER_PARAMS`, `CROSSTALK_PARAMS` and `ROBOT_DETECTION_PARAMS`."""

    def update(self, changes: Mapping[str, Any]) -> None:
        """Change settings, all or none.

        Raises:
            ConfigError: a setting that is unknown or not live, or a value that is not allowed.
        """
        raise NotImplementedError

    update_min_range = _update_of("filtering.min_range")
    update_intensity = _update_of("filtering.intensity_threshold")
    update_filtering_noise_factor = _update_of("filtering.noise_factor")
    update_mounting_orientation_roll = _update_of("mounting.orientation.roll")
    update_mounting_orientation_pitch = _update_of("mounting.orientation.pitch")
    update_mounting_orientation_yaw = _update_of("mounting.orientation.yaw")
    update_occupied_threshold = _update_of("mapping.occupied_threshold")
    update_mapping_free_threshold = _update_of("mapping.free_threshold")
    update_mapping_aggregation = _update_of("mapping.aggregation")
    update_mapping_carve_no_return = _update_of("mapping.carve_no_return")
    update_mapping_integrator = _update_of("mapping.integrator")
    update_mapping_detail = _update_of("mapping.detail")
    update_mapping_threads = _update_of("mapping.threads")
    update_mapping_within_ping_motion = _update_of("mapping.within_ping_motion")
    update_mapping_max_swath_voxels = _update_of("mapping.max_swath_voxels")
    update_angular_cone = _update_of("mapping.angular_cone_width")
    update_frame_skip = _update_of("processing.frame_skip")
    update_crosstalk_enabled = _update_of("crosstalk.enabled")
    update_crosstalk_morpho_enabled = _update_of("crosstalk.morpho_enabled")
    update_crosstalk_morpho_kernel_size = _update_of("crosstalk.morpho_kernel_size")
    update_crosstalk_morpho_kernel_shape = _update_of("crosstalk.morpho_kernel_shape")
    update_crosstalk_azimuth_enabled = _update_of("crosstalk.azimuth_enabled")
    update_crosstalk_azimuth_threshold = _update_of("crosstalk.azimuth_threshold")
    update_crosstalk_fft_enabled = _update_of("crosstalk.fft_enabled")
    update_crosstalk_filter_width = _update_of("crosstalk.filter_width")
    update_crosstalk_filter_strength = _update_of("crosstalk.filter_strength")
    update_crosstalk_dc_preserve_ratio = _update_of("crosstalk.dc_preserve_ratio")
    update_terrain_detection_min_threshold = _update_of("terrain_detection.min_threshold")
    update_terrain_detection_max_threshold = _update_of("terrain_detection.max_threshold")
    update_robot_detection_enabled = _update_of("robot_detection.enabled")
    update_robot_detection_min_threshold = _update_of("robot_detection.min_threshold")
    update_robot_detection_min_samples = _update_of("robot_detection.min_samples")
    update_robot_detection_keep_out = _update_of("robot_detection.keep_out")
    update_robot_detection_expire_sec = _update_of("robot_detection.expire_sec")
