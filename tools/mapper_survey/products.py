"""What can be made of a survey's map, and how."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from mapper_survey.errors import SurveyError
from mapper_survey.surface import CELL_VOXELS, RULES, Rule
from mapper_survey.windows import WINDOW_BRICKS
from mapperd.config.tree import Config
from mapperd.export.cells import Heights
from mapperd.geometry.geodesy import Origin, local_projection, utm_zone

__all__ = ["PRODUCTS", "Options", "check_products", "crs_of"]

PRODUCTS = {
    "grid": "depth.tif",
    "cloud": "cloud.laz",
    "soundings": "soundings.xyz",
    "positions": "positions.xyz",
}
"""Names of products, and their files."""


@dataclass(frozen=True, slots=True)
class Options:
    """How products are made.

    Attributes:
        config: its thresholds say what is occupied; None takes the defaults.
        cell_voxels: columns of voxels along the edge of a grid's cell.
        rule: what stands for a cell.
        vertical_uncertainty_m: standard deviation of heights by navigation and tide.
        altitude_m: height of the map's zero above what depths are below.
        heights: which voxels count, in the map's z.
        window_bricks: along the edge of what is in memory at a time.

    Raises:
        SurveyError: a number is not allowed.
    """

    config: Config | None = None
    cell_voxels: int = 1
    rule: Rule = "shoalest"
    vertical_uncertainty_m: float = 0.0
    altitude_m: float = 0.0
    heights: Heights = field(default_factory=Heights)
    window_bricks: int = WINDOW_BRICKS

    def __post_init__(self) -> None:
        allowed = ", ".join(map(str, CELL_VOXELS))
        if self.cell_voxels not in CELL_VOXELS:
            raise SurveyError(f"cell_voxels: {self.cell_voxels} is not allowed; allowed: {allowed}")
        if self.rule not in RULES:
            raise SurveyError(f"rule: {self.rule!r} is none; allowed: {', '.join(RULES)}")
        if not (math.isfinite(self.altitude_m) and 0 <= self.vertical_uncertainty_m < math.inf):
            raise SurveyError(
                "altitude_m must be a number, and vertical_uncertainty_m one from 0 on"
            )


def check_products(products: Sequence[str], *, known: bool) -> None:
    """Refuse what cannot be made.

    Args:
        products: by their names.
        known: whether somebody said where on Earth the map is.

    Raises:
        SurveyError: no such product, or one that needs an origin.
    """
    unknown = [product for product in products if product not in PRODUCTS]
    if unknown or not products:
        asked = ", ".join(unknown) or "nothing"
        raise SurveyError(f"no such product: {asked}; allowed: {', '.join(PRODUCTS)}")
    if "positions" in products and not known:
        raise SurveyError("positions need an origin: say where on Earth the map's zero lies")


def crs_of(product: str, origin: Origin | None) -> str:
    """The system of coordinates that a product's file is in, for a person."""
    if origin is None:
        return "none: nobody said where on Earth the map is"
    if product == "grid":
        return local_projection(origin).name
    if product == "positions":
        return "WGS 84, EPSG:4326, longitude first"
    zone = utm_zone(origin)
    return f"{zone.name}, EPSG:{zone.epsg}"
