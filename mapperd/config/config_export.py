"""Settings of what is made of a map when it is saved as a file."""

from typing import Annotated

from msgspec import Struct

from mapperd.config.field import rule

__all__ = ["Export"]


class Export(Struct, frozen=True, forbid_unknown_fields=True):
    """Which heights the flat formats look at: `.asc`, `.tif` and `.pgm`."""

    min_z: Annotated[
        float, rule("Voxels whose centres lie lower are left out.", "m", live=True, ge=-1e5, le=1e5)
    ] = -1e5
    max_z: Annotated[
        float,
        rule("Voxels whose centres lie higher are left out.", "m", live=True, ge=-1e5, le=1e5),
    ] = 1e5

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.min_z >= self.max_z:
            raise ValueError(f"min_z {self.min_z:g} is not below max_z {self.max_z:g}")
