"""How far it is down to what lies below the vehicle."""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from sonar_sim.geometry.pose import Pose
from sonar_sim.scene.scene import Scene


class Altimeter:
    """One ray along the vehicle's own downward axis; moving objects are taken where they begin."""

    def __init__(self, scene: Scene) -> None:
        triangles = scene.triangles_m.astype(np.float32)
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, triangles) if len(triangles) else None

    def altitude_m(self, map_T_base: Pose) -> float | None:  # noqa: N803 frames are named
        """Distance to the first surface below; None where nothing is."""
        if self._mesh is None:
            return None
        found = self._scene.run(
            map_T_base.position_m[None].astype(np.float32),
            -map_T_base.rotation[:, 2][None].astype(np.float32),
            output=True,
        )
        return float(found["tfar"][0]) if found["primID"][0] >= 0 else None
