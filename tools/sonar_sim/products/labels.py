"""Names behind the numbers of the ground truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """What the numbers mean.

    Attributes:
        surfaces: names, by place in the scene.
        materials: names of those in the scene, sorted.
        material_of: place in `materials` of each surface, int32 (surfaces,).
    """

    surfaces: tuple[str, ...]
    materials: tuple[str, ...]
    material_of: NDArray[np.int32]

    def material(self, surface: NDArray[np.int32]) -> NDArray[np.int32]:
        """Material of each surface number; what is below 0, nothing or the sea, stays as it is."""
        padded = np.append(self.material_of, np.int32(-1))
        return np.where(surface >= 0, padded[np.maximum(surface, -1)], surface).astype(np.int32)


def labels_of(scene: Scene) -> Labels:
    """Number a scene's surfaces and materials."""
    used = [surface.material.name for surface in scene.surfaces]
    materials = tuple(sorted(set(used)))
    places = [materials.index(name) for name in used]
    return Labels(
        tuple(surface.name for surface in scene.surfaces),
        materials,
        np.array(places, dtype=np.int32),
    )
