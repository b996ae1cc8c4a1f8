"""Live, trustworthy 3D maps from Oculus multibeam imaging sonars.

Everything of `__all__` is imported when first asked for, so that importing this package costs
nothing.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapperd.compat.flat_config import SonarMapperConfig
    from mapperd.compat.octree_mapper import OctreeMapper, ProbabilityUpdater
    from mapperd.compat.parameters import (
        CROSSTALK_PARAMS,
        MAPPER_PARAMS,
        ROBOT_DETECTION_PARAMS,
        VISUALIZER_PARAMS,
        WORLD_INIT_PARAMS,
        ParameterDef,
        ParameterManager,
        ParameterNode,
    )
    from mapperd.compat.sonar_to_3d import SonarTo3DMapper
    from mapperd.geometry.gaussian import PlanarGaussian
    from mapperd.imaging.filter_chain import CrosstalkFilter
    from mapperd.localization.localizer import Localizer
    from mapperd.localization.map_filter import MapFilter
    from mapperd.localization.maps import GridMap
    from mapperd.localization.scan import scan_of_ranges
    from mapperd.mapping.queries import MemoryStats

__all__ = [
    "CROSSTALK_PARAMS",
    "MAPPER_PARAMS",
    "ROBOT_DETECTION_PARAMS",
    "VISUALIZER_PARAMS",
    "WORLD_INIT_PARAMS",
    "CrosstalkFilter",
    "GridMap",
    "Localizer",
    "MapFilter",
    "MemoryStats",
    "OctreeMapper",
    "ParameterDef",
    "ParameterManager",
    "ParameterNode",
    "PlanarGaussian",
    "ProbabilityUpdater",
    "SonarMapperConfig",
    "SonarTo3DMapper",
    "__version__",
    "scan_of_ranges",
]

__version__ = "0.2.0"

_MODULES = {
    "GridMap": "mapperd.localization.maps",
    "Localizer": "mapperd.localization.localizer",
    "MapFilter": "mapperd.localization.map_filter",
    "PlanarGaussian": "mapperd.geometry.gaussian",
    "scan_of_ranges": "mapperd.localization.scan",
    "OctreeMapper": "mapperd.compat.octree_mapper",
    "ProbabilityUpdater": "mapperd.compat.octree_mapper",
    "SonarTo3DMapper": "mapperd.compat.sonar_to_3d",
    "CrosstalkFilter": "mapperd.imaging.filter_chain",
    "MemoryStats": "mapperd.mapping.queries",
    "SonarMapperConfig": "mapperd.compat.flat_config",
    **dict.fromkeys(
        (
            "CROSSTALK_PARAMS",
            "MAPPER_PARAMS",
            "ROBOT_DETECTION_PARAMS",
            "VISUALIZER_PARAMS",
            "WORLD_INIT_PARAMS",
            "ParameterDef",
            "ParameterManager",
            "ParameterNode",
        ),
        "mapperd.compat.parameters",
    ),
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
