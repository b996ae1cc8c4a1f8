"""A pose that somebody gives: how sure it is may be left out."""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from mapperd.geometry.gaussian import PlanarGaussian

__all__ = ["STD_XY_M", "STD_YAW_RAD", "PoseRequest"]

STD_XY_M = 0.5
STD_YAW_RAD = math.pi / 12
"""Of a pose that is given without: what RViz gives with a pose that is drawn by hand."""

Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]
Angle = Annotated[float, Meta(ge=-100, le=100)]
Deviation = Annotated[float, Meta(ge=0, le=1e6)]
Covariance = Annotated[float, Meta(ge=-1e12, le=1e12)]
Row = tuple[Covariance, Covariance, Covariance]


class PoseRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """The vehicle's place and heading on the map, as it comes from outside.

    Attributes:
        x_m, y_m, yaw_rad: mean; the heading counter-clockwise from x.
        std_xy_m, std_yaw_rad: standard deviations; None is `STD_XY_M`, `STD_YAW_RAD`.
        covariance: of (x, y, yaw), instead of both.
        frame: that the pose is in; empty is the map's.
    """

    x_m: Metres
    y_m: Metres
    yaw_rad: Angle
    std_xy_m: Deviation | None = None
    std_yaw_rad: Deviation | None = None
    covariance: tuple[Row, Row, Row] | None = None
    frame: Annotated[str, Meta(max_length=64)] = ""

    def gaussian(self) -> PlanarGaussian:
        """The pose as the filter takes it.

        Raises:
            ValueError: the covariance is none, a number is not finite, or both a covariance and a
                standard deviation are given.
        """
        return PlanarGaussian(self.x_m, self.y_m, self.yaw_rad, self._covariance())

    def _covariance(self) -> np.ndarray:
        if self.covariance is not None:
            if self.std_xy_m is not None or self.std_yaw_rad is not None:
                raise ValueError("a covariance or standard deviations, not both")
            return np.array(self.covariance)
        xy_m = STD_XY_M if self.std_xy_m is None else self.std_xy_m
        yaw_rad = STD_YAW_RAD if self.std_yaw_rad is None else self.std_yaw_rad
        return np.diag([xy_m**2, xy_m**2, yaw_rad**2])
