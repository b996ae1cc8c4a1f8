"""Places on Earth and their projections, judged by PROJ."""

import math

import numpy as np
import pyproj
import pytest

from mapperd.geometry.geodesy import Origin, TransverseMercator, local_projection, utm_zone

PLACES = [(53.5, 9.9), (-41.2, 174.9), (0.0, 0.01), (71.0, 179.999), (-0.5, -180.0), (82.9, 5.0)]

ORIGINS = pytest.mark.parametrize(
    "origin", [Origin.of_degrees(*place) for place in PLACES], ids=map(str, PLACES)
)


def points(seed: int) -> np.ndarray:
    """East, north and up within 20 km, and 200 m of the surface."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (200, 3)) * (20_000, 20_000, 200)


def by_proj(origin: Origin, enu_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Latitudes and longitudes in degrees, by PROJ's topocentric and geocentric systems."""
    lat_deg, lon_deg = math.degrees(origin.latitude_rad), math.degrees(origin.longitude_rad)
    there = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +lat_0={lat_deg!r} +lon_0={lon_deg!r} +h_0=0 "
        "+ellps=WGS84 +step +inv +proj=cart +ellps=WGS84"
    )
    longitude, latitude, _ = there.transform(enu_m[:, 0], enu_m[:, 1], enu_m[:, 2], radians=True)
    return np.degrees(latitude), np.degrees(longitude)


@ORIGINS
def test_places_are_those_of_proj(origin: Origin) -> None:
    enu_m = points(3)
    latitude, longitude = map(np.degrees, origin.places(enu_m))
    expected_latitude, expected_longitude = by_proj(origin, enu_m)
    assert np.abs(latitude - expected_latitude).max() < 1e-12
    assert np.abs((longitude - expected_longitude + 180) % 360 - 180).max() < 1e-12


def test_places_are_the_way_back() -> None:
    origin = Origin.of_degrees(-33.9, 151.2)
    for point in points(4)[:20]:
        latitude, longitude = origin.places(point[None])
        there_m = origin.enu_m(latitude[0], longitude[0], 0.0)
        drop_m = np.hypot(*point[:2]) * abs(point[2] - there_m[2]) / 6.3e6
        assert np.abs(there_m[:2] - point[:2]).max() <= drop_m + 1e-6


@ORIGINS
@pytest.mark.parametrize("kind", [utm_zone, local_projection])
def test_projected_places_are_those_of_proj(origin: Origin, kind: object) -> None:
    assert callable(kind)
    projection: TransverseMercator = kind(origin)
    system = pyproj.CRS.from_wkt(projection.wkt)
    latitude, longitude = origin.places(points(5))
    east_m, north_m = projection.project(latitude, longitude)
    to_it = pyproj.Transformer.from_crs(4326, system, always_xy=True)
    expected = to_it.transform(np.degrees(longitude), np.degrees(latitude))
    assert np.abs(east_m - expected[0]).max() < 1e-5
    assert np.abs(north_m - expected[1]).max() < 1e-5


@ORIGINS
def test_zone_is_the_one_of_its_code(origin: Origin) -> None:
    zone = utm_zone(origin)
    assert pyproj.CRS.from_wkt(zone.wkt) == pyproj.CRS.from_epsg(zone.epsg)
    assert pyproj.CRS.from_epsg(zone.epsg).name == zone.name
    bounds = pyproj.CRS.from_epsg(zone.epsg).area_of_use
    assert bounds is not None
    longitude_deg = (math.degrees(origin.longitude_rad) + 180) % 360 - 180
    assert bounds.west <= longitude_deg <= bounds.east
    assert (bounds.south >= 0) == (origin.latitude_rad >= 0)


@ORIGINS
def test_local_coordinates_are_the_maps(origin: Origin) -> None:
    enu_m = points(6) / 20 * (1, 1, 0)
    east_m, north_m = local_projection(origin).project(*origin.places(enu_m))
    off_m = np.hypot(east_m - enu_m[:, 0], north_m - enu_m[:, 1])
    allowed_m = np.hypot(*enu_m[:, :2].T) ** 3 / (3 * 6.33e6**2)
    assert (off_m <= allowed_m + 1e-8).all()
