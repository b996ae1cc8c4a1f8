"""Places on Earth in the map, and back: east, north and up of an origin, WGS-84."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Origin"]

Floats = NDArray[np.float64]

EQUATOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the map's zero lies on Earth, at the sea's surface.

    Attributes:
        latitude_rad: north positive.
        longitude_rad: east positive.
    """

    latitude_rad: float
    longitude_rad: float

    @classmethod
    def of_degrees(cls, latitude_deg: float, longitude_deg: float) -> "Origin":
        """At a place that is said in degrees."""
        return cls(math.radians(latitude_deg), math.radians(longitude_deg))

    def enu_m(self, latitude_rad: float, longitude_rad: float, height_m: float) -> Floats:
        """East, north and up (3,) of a place, in the plane that touches the Earth at the origin."""
        sin_lat, cos_lat = math.sin(self.latitude_rad), math.cos(self.latitude_rad)
        sin_lon, cos_lon = math.sin(self.longitude_rad), math.cos(self.longitude_rad)
        way = _geocentric(latitude_rad, longitude_rad, height_m) - _geocentric(
            self.latitude_rad, self.longitude_rad, 0.0
        )
        axes = np.array(
            [
                [-sin_lon, cos_lon, 0.0],
                [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
                [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
            ]
        )
        return np.asarray(axes @ way, dtype=np.float64)

    def places(self, enu_m: Floats) -> tuple[Floats, Floats]:
        """Latitudes and longitudes (N,) in radians of points (N, 3) east, north and up of here."""
        sin_lat, cos_lat = math.sin(self.latitude_rad), math.cos(self.latitude_rad)
        sin_lon, cos_lon = math.sin(self.longitude_rad), math.cos(self.longitude_rad)
        east, north, up = np.asarray(enu_m, dtype=np.float64).T
        centre = _geocentric(self.latitude_rad, self.longitude_rad, 0.0)
        outwards = cos_lat * up - sin_lat * north
        return _geodetic(
            centre[0] + cos_lon * outwards - sin_lon * east,
            centre[1] + sin_lon * outwards + cos_lon * east,
            centre[2] + cos_lat * north + sin_lat * up,
        )


def _geocentric(latitude_rad: float, longitude_rad: float, height_m: float) -> Floats:
    """Earth-centred, Earth-fixed coordinates (3,), m."""
    sine = math.sin(latitude_rad)
    normal_m = EQUATOR_M / math.sqrt(1.0 - ECCENTRICITY2 * sine * sine)
    across_m = (normal_m + height_m) * math.cos(latitude_rad)
    return np.array(
        [
            across_m * math.cos(longitude_rad),
            across_m * math.sin(longitude_rad),
            (normal_m * (1.0 - ECCENTRICITY2) + height_m) * sine,
        ]
    )


def _geodetic(x_m: Floats, y_m: Floats, z_m: Floats) -> tuple[Floats, Floats]:
    """Latitudes and longitudes of Earth-centred points near the surface.

    Bowring's formula (Survey Review 23, 1976), by the reduced latitude: exact to the last digits
    of a double on the Earth and in its seas.
    """
    across_m = np.hypot(x_m, y_m)
    polar_m = EQUATOR_M * (1.0 - FLATTENING)
    second2 = ECCENTRICITY2 / (1.0 - ECCENTRICITY2)
    reduced = np.arctan2(z_m, (1.0 - FLATTENING) * across_m)
    latitude = np.arctan2(
        z_m + second2 * polar_m * np.sin(reduced) ** 3,
        across_m - ECCENTRICITY2 * EQUATOR_M * np.cos(reduced) ** 3,
    )
    return latitude, np.arctan2(y_m, x_m)
