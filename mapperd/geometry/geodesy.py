"""Places on Earth (WGS-84): east, north, up of an origin, and transverse Mercator."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Origin", "TransverseMercator", "local_projection", "utm_zone"]

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
        """Create from a position in degrees."""
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


UTM_SCALE = 0.9996
UTM_EAST_M = 500_000.0
UTM_SOUTH_M = 10_000_000.0

_N = FLATTENING / (2.0 - FLATTENING)

RECTIFYING_M = EQUATOR_M / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)

SERIES = (
    _N / 2 - 2 * _N**2 / 3 + 5 * _N**3 / 16 + 41 * _N**4 / 180,
    13 * _N**2 / 48 - 3 * _N**3 / 5 + 557 * _N**4 / 1440,
    61 * _N**3 / 240 - 103 * _N**4 / 140,
    49561 * _N**4 / 161280,
)
"""Krueger's (1912), to the fourth order in the third flattening, as in IOGP guidance note 7-2."""

WGS84_WKT = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,'
    'AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,'
    'AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],'
    'AUTHORITY["EPSG","4326"]]'
)


@dataclass(frozen=True, slots=True)
class TransverseMercator:
    """A projected system of coordinates, in metres.

    Attributes:
        name: for people.
        latitude_deg, longitude_deg: of its natural origin.
        scale: along the central meridian.
        east_m, north_m: coordinates of the natural origin.
        epsg: its code; 0 without one.
    """

    name: str
    latitude_deg: float
    longitude_deg: float
    scale: float = 1.0
    east_m: float = 0.0
    north_m: float = 0.0
    epsg: int = 0

    def project(self, latitude_rad: Floats, longitude_rad: Floats) -> tuple[Floats, Floats]:
        """East and north of places; within 3000 km of the central meridian to a millimetre."""
        turned = longitude_rad - math.radians(self.longitude_deg)
        turned = (turned + math.pi) % (2 * math.pi) - math.pi
        conformal = _conformal(latitude_rad)
        north = np.arctan2(conformal, np.cos(turned))
        east = np.arcsinh(np.sin(turned) / np.hypot(conformal, np.cos(turned)))
        along, across = north.copy(), east.copy()
        for k, factor in enumerate(SERIES, 1):
            along += factor * np.sin(2 * k * north) * np.cosh(2 * k * east)
            across += factor * np.cos(2 * k * north) * np.sinh(2 * k * east)
        size_m = self.scale * RECTIFYING_M
        first = _rectifying(math.radians(self.latitude_deg))
        return self.east_m + size_m * across, self.north_m + size_m * (along - first)

    @property
    def wkt(self) -> str:
        """As well-known text of version 1, which LAS asks for."""
        parameters = {
            "latitude_of_origin": self.latitude_deg,
            "central_meridian": self.longitude_deg,
            "scale_factor": self.scale,
            "false_easting": self.east_m,
            "false_northing": self.north_m,
        }
        text = ",".join(f'PARAMETER["{key}",{value!r}]' for key, value in parameters.items())
        code = f',AUTHORITY["EPSG","{self.epsg}"]' if self.epsg else ""
        return (
            f'PROJCS["{self.name}",{WGS84_WKT},PROJECTION["Transverse_Mercator"],{text},'
            'UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH]'
            f"{code}]"
        )


def utm_zone(origin: Origin) -> TransverseMercator:
    """The zone of an origin, by its longitude alone: a map over an edge stays in one zone."""
    longitude_deg = math.degrees(origin.longitude_rad)
    # Of a place a digit west of -180, the first remainder is rounded to 360: there is no zone 61.
    zone = int((longitude_deg + 180.0) % 360.0 // 6) % 60 + 1
    south = origin.latitude_rad < 0
    return TransverseMercator(
        f"WGS 84 / UTM zone {zone}{'S' if south else 'N'}",
        0.0,
        6.0 * zone - 183.0,
        UTM_SCALE,
        UTM_EAST_M,
        UTM_SOUTH_M if south else 0.0,
        32600 + 100 * south + zone,
    )


def local_projection(origin: Origin) -> TransverseMercator:
    """One whose zero is the origin: its coordinates are the map's, at the sea's surface.

    They differ by up to distance^3 / 3 R^2, 8 mm at 10 km, and below the surface by
    depth * distance / R, because plumb lines meet: 16 mm at 1 km under 100 m of water.
    """
    latitude_deg = math.degrees(origin.latitude_rad)
    longitude_deg = math.degrees(origin.longitude_rad)
    name = f"WGS 84 / mapperd local {latitude_deg:.7f} {longitude_deg:.7f}"
    return TransverseMercator(name, latitude_deg, longitude_deg)


def _conformal(latitude_rad: Floats) -> Floats:
    """Tangent of the conformal latitude.

    By the tangent of the latitude, finite and sharp at the poles too, where the isometric latitude
    is infinite and near which it loses its digits (Karney, Journal of Geodesy 85, 2011, eq. 7).
    """
    eccentricity = math.sqrt(ECCENTRICITY2)
    tangent = np.tan(latitude_rad)
    sigma = np.sinh(eccentricity * np.arctanh(eccentricity * np.sin(latitude_rad)))
    return np.asarray(tangent * np.hypot(1.0, sigma) - sigma * np.hypot(1.0, tangent))


def _rectifying(latitude_rad: float) -> float:
    """Way from the equator along a meridian, as an angle."""
    conformal = math.atan(float(_conformal(np.array(latitude_rad))))
    return conformal + sum(
        factor * math.sin(2 * k * conformal) for k, factor in enumerate(SERIES, 1)
    )
