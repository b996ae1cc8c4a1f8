"""The Earth flattened for files that survey programs read: transverse Mercator, WGS-84."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.geodesy import ECCENTRICITY2, EQUATOR_M, FLATTENING, Origin

__all__ = ["TransverseMercator", "local_projection", "utm_zone"]

Floats = NDArray[np.float64]

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
        told = ",".join(f'PARAMETER["{key}",{value!r}]' for key, value in parameters.items())
        code = f',AUTHORITY["EPSG","{self.epsg}"]' if self.epsg else ""
        return (
            f'PROJCS["{self.name}",{WGS84_WKT},PROJECTION["Transverse_Mercator"],{told},'
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
