"""How much of a difference between two pictures does not matter."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Tolerance:
    """What a user is ready to overlook.

    Attributes:
        level_db: difference of a pixel's expected level.
        cells: displacement, in rows or beams.
        share: of the picture's pixels, the most that may differ by more than `level_db`; effects
            that cost next to nothing are granted none.
        texture: difference of the speckle's coefficient of variation, or of its correlation
            between neighbouring rows or beams.
        brighter_db: by how much the rules take a ping to be brighter than their coarse picture of
            it, to see how sure they are.
    """

    level_db: float = 0.5
    cells: float = 0.5
    share: float = 0.001
    texture: float = 0.05
    brighter_db: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what decides nothing."""
        if not (self.level_db > 0.0 and self.cells > 0.0 and self.texture > 0.0):
            raise ValueError(f"a tolerance above zero is needed, not {self}")
        if not 0.0 <= self.share < 1.0:
            raise ValueError(f"the share of pixels must be in [0, 1), not {self.share}")
