"""Live, trustworthy 3D maps from Oculus multibeam imaging sonars.

`SonarTo3DMapper`, `OctreeMapper` and `ProbabilityUpdater` are imported when first asked for, so
that importing this package costs nothing.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapperd.octree_mapper import OctreeMapper
    from mapperd.probability_updater import ProbabilityUpdater
    from mapperd.sonar_to_3d import SonarTo3DMapper

__all__ = ["OctreeMapper", "ProbabilityUpdater", "SonarTo3DMapper"]

_MODULES = {
    "OctreeMapper": "mapperd.octree_mapper",
    "ProbabilityUpdater": "mapperd.probability_updater",
    "SonarTo3DMapper": "mapperd.sonar_to_3d",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
