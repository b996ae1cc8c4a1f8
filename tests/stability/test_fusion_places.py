"""Hard cases of the fusion of odometry: places on Earth, depths, covariances."""

from __future__ import annotations

import math
from types import SimpleNamespace

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.config.odometry import FormatSettings
from mapperd.errors import Reject
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.geometry.geodesy import Origin, local_projection, utm_zone
from mapperd.odometry.fusion import Fusion
from mapperd.odometry.mavlink_messages import _pressure
from mapperd.odometry.native import NativeRecord, odometry_of
from mapperd.odometry.records import GeoPoint, Odometry, linear_covariance
from tests.mapperd.odometry.conftest import T0, S, fused_at, record

Floats = NDArray[np.float64]
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
POLE = math.pi / 2
ROUND_M = 2e-9
"""Earth-centred coordinates of 6.4e6 m, in doubles."""


def by_40_digits(origin: Origin, latitude: float, longitude: float, height: float) -> list[float]:
    """East, north and up, from the textbook: the oracle knows nothing of ours."""
    with mp.workdps(40):
        a, f = mp.mpf(6378137), 1 / mp.mpf("298.257223563")
        e2 = f * (2 - f)

        def centred(lat: float, lon: float, h: float) -> mp.matrix:
            n = a / mp.sqrt(1 - e2 * mp.sin(lat) ** 2)
            across = (n + h) * mp.cos(lat)
            up = (n * (1 - e2) + h) * mp.sin(lat)
            return mp.matrix([across * mp.cos(lon), across * mp.sin(lon), up])

        lat, lon = mp.mpf(origin.latitude_rad), mp.mpf(origin.longitude_rad)
        d = centred(mp.mpf(latitude), mp.mpf(longitude), mp.mpf(height)) - centred(lat, lon, 0)
        east = -mp.sin(lon) * d[0] + mp.cos(lon) * d[1]
        out = mp.cos(lon) * d[0] + mp.sin(lon) * d[1]
        north = mp.cos(lat) * d[2] - mp.sin(lat) * out
        return [float(east), float(north), float(mp.cos(lat) * out + mp.sin(lat) * d[2])]


@pytest.mark.parametrize("latitude", [POLE, -POLE])
def test_origin_at_a_pole(latitude: float) -> None:
    """At a pole there is a plane with two axes like anywhere else, and places lie in it.

    Naively a metre of longitude is divided by the cosine of 90 degrees, which is 6e-17 or 0.
    """
    origin = Origin(latitude, 0.7)
    for away, longitude in ((1e-6, -3.0), (1e-4, 0.7), (1e-9, 2.0)):
        place = (math.copysign(POLE - away, latitude), longitude, -5.0)
        assert origin.enu_m(*place) == pytest.approx(by_40_digits(origin, *place), abs=ROUND_M)
    there, back = origin.places(np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]]))
    assert abs(there[0]) == pytest.approx(POLE, abs=1e-15)
    assert np.isfinite(back).all()


def test_origin_on_the_antimeridian() -> None:
    """A place 2 cm to the east of longitude 180 lies 2 cm to the east.

    Naively longitudes are subtracted: it lies 40 000 km to the west.
    """
    origin = Origin.of_degrees(-17.0, 180.0)
    for longitude in (-180.0 + 2e-7, 180.0 - 2e-7, -180.0):
        place = (origin.latitude_rad, math.radians(longitude), 0.0)
        got = origin.enu_m(*place)
        assert np.linalg.norm(got) < 0.03
        assert got == pytest.approx(by_40_digits(origin, *place), abs=ROUND_M)


@pytest.mark.parametrize("apart_rad", [0.0, 1e-13, 1e-10, 1e-6, 1e-3])
def test_places_beside_the_origin(apart_rad: float) -> None:
    """A place a micrometre, or 6 km, from the origin is exact to a few nanometres.

    Naively Earth-centred places are subtracted in single precision, which has steps of 0.5 m there.
    """
    for latitude in (0.0, 0.93, -1.57):
        origin = Origin(latitude, -2.1)
        place = (latitude + apart_rad, -2.1 - apart_rad, -30.0)
        assert origin.enu_m(*place) == pytest.approx(by_40_digits(origin, *place), abs=ROUND_M)


@pytest.mark.parametrize("latitude", [POLE, -POLE])
def test_projection_at_a_pole(latitude: float) -> None:
    """A map's grid is right at a pole, and a centimetre beside it.

    Naively the isometric latitude there is infinite, and digits of it are lost all around: until
    this was a test, all places within 6 cm were the pole itself.
    """
    flat = local_projection(Origin(latitude, 0.0))
    east, north = flat.project(np.array([latitude]), np.array([1.0]))
    assert max(abs(east[0]), abs(north[0])) < 1e-8
    for away_m in (0.001, 0.01, 1.0, 100.0):
        with mp.workdps(40):
            e2 = mp.mpf("0.00669437999014131699613723")
            polar = mp.mpf(6378137) / mp.sqrt(1 - e2)
            away = mp.mpf(away_m) / polar
        place = np.array([math.copysign(POLE - float(away), latitude)])
        for longitude in (-2.5, 0.0, 1.0):
            east, north = flat.project(place, np.array([longitude]))
            assert east[0] == pytest.approx(away_m * math.sin(longitude), abs=1e-8)
            toward = -math.copysign(away_m, latitude) * math.cos(longitude)
            assert north[0] == pytest.approx(toward, abs=1e-8)


@pytest.mark.parametrize("longitude_rad", [math.pi, -math.pi, float(np.nextafter(-math.pi, -4))])
def test_zone_at_the_antimeridian(longitude_rad: float) -> None:
    """Longitude 180 east, 180 west, and a digit beyond, lie in a zone that there is.

    Naively the remainder of -3e-14 by 360 is rounded to 360, and the map's zone is the 61st.
    """
    zone = utm_zone(Origin(-0.3, longitude_rad))
    assert zone.epsg == 32701
    east, _ = zone.project(np.array([-0.3]), np.array([longitude_rad]))
    assert abs(east[0] - 500_000.0) < 350_000


def test_way_across_the_antimeridian() -> None:
    """A vehicle that dives over longitude 180 goes straight on, without a jump.

    Naively its longitude falls by 360 degrees, and the map starts again on the other side.
    """
    fusion = Fusion()
    for k in range(11):
        longitude = 180.0 - 5e-6 + k * 1e-6
        wrapped = longitude - 360.0 if longitude > 180.0 else longitude
        geo = GeoPoint(0.0, math.radians(wrapped), None)
        assert (
            fusion.take("gps", record(geo=geo, map_q_base=LEVEL, depth_m=2.0), T0 + k * S) is None
        )
    metres = 6378137.0 * math.radians(1e-6)
    start, end = fused_at(fusion, 0.0), fused_at(fusion, 10.0)
    assert end.segment == start.segment
    way = end.pose.position_m - start.pose.position_m
    assert way == pytest.approx([10 * metres, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("depth_m", [0.0, 0.01, 1.0, 100.0, 11_000.0])
def test_pressure_in_single_precision(depth_m: float) -> None:
    """A depth from a sensor's single-precision hectopascals is off by their step, and no more.

    Naively the surface's pressure is subtracted in single precision too: a wrong digit each time.
    """
    settings = FormatSettings()
    with mp.workdps(30):
        per_m = mp.mpf(settings.water_density) * mp.mpf("9.80665") / 100
        exact = mp.mpf(settings.surface_pressure) + per_m * mp.mpf(depth_m)
    pressure = np.float32(float(exact))
    fields = _pressure(SimpleNamespace(press_abs=float(pressure)), settings)
    assert not isinstance(fields, Reject)
    step_m = float(np.spacing(pressure)) / float(per_m)
    assert fields["depth_m"] == pytest.approx(depth_m, abs=0.51 * step_m + 1e-9)


@pytest.mark.parametrize("hectopascal", [math.nan, math.inf, -math.inf, 0.0, 3.4e38])
def test_pressure_that_cannot_be(hectopascal: float) -> None:
    """A sensor in vacuum, in the Earth's core, or that sends no number has no depth.

    Naively NaN becomes the height of the next ping, or the vehicle flies 10 m above the sea.
    """
    fields = _pressure(SimpleNamespace(press_abs=hectopascal), FormatSettings())
    assert isinstance(fields, Reject)


def record_of(covariance: Floats) -> NativeRecord:
    """By a sender in NED and FRD, as the upper triangle."""
    triangle = tuple(covariance[np.triu_indices(6)].tolist())
    level = (1.0, 0.0, 0.0, 0.0)
    return NativeRecord(v=1, clk="arrival", w="ned", b="frd", p=(0, 0, 0), q=level, pc=triangle)


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_rank_deficient_covariance_of_a_sender(rank: int) -> None:
    """A covariance of lower rank is turned to our axes as it is: symmetric, no variance below 0.

    Naively somebody inverts it, or its root is taken by Cholesky: the daemon dies of one record.
    """
    root = np.random.default_rng(rank).normal(size=(6, rank)) * 0.1
    taken = odometry_of(record_of(root @ root.T))
    assert isinstance(taken, Odometry)
    fusion = Fusion()
    for k in range(3):
        assert fusion.take("ekf", taken, T0 + k * S // 10) is None
    covariance = fused_at(fusion, 0.15).covariance
    assert (covariance == covariance.T).all()
    assert np.linalg.eigvalsh(covariance).min() > -1e-15
    assert covariance[:2, :2][::-1, ::-1] == pytest.approx((root @ root.T)[:2, :2], rel=1e-14)


def test_covariance_that_is_nearly_symmetric() -> None:
    """Halves that differ in the last digits, after many turns, are made equal.

    Naively a check for symmetry refuses our own product, or Cholesky takes one half of it.
    """
    chance = np.random.default_rng(3)
    covariance = np.diag([0.04, 1e-6, 3.0])
    for _ in range(1000):
        turn, _ = np.linalg.qr(chance.normal(size=(3, 3)))
        covariance = turn @ covariance @ turn.T
    assert (covariance != covariance.T).any()
    kept = PlanarGaussian(0.0, 0.0, 0.0, covariance).covariance
    assert (kept == kept.T).all()
    assert np.sort(np.linalg.eigvalsh(kept)) == pytest.approx([1e-6, 0.04, 3.0], rel=1e-6)


@pytest.mark.parametrize("unknown", [1e6, 1e9, 1e12])
def test_unknown_variance_beside_a_small_one(unknown: float) -> None:
    """A sender's "unknown" of 1e12 does not touch the variances that it knows.

    Naively both are turned in one product, and 1e12 times a rounded zero is added to 1e-6.
    """
    matrix = np.diag([unknown, 1e-6, 1e-6, 1e-8, 1e-8, 1e-8])
    taken = odometry_of(record_of(matrix))
    assert isinstance(taken, Odometry)
    assert taken.pose_covariance is not None
    assert np.diag(taken.pose_covariance) == pytest.approx([1e-6, unknown, *np.diag(matrix)[2:]])
    linear = linear_covariance(np.diag([2e6, 1e-6, 1e-6]))
    assert np.diag(linear) == pytest.approx([1e6] * 6)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1e-3])
def test_variance_that_cannot_be(wrong: float) -> None:
    """A variance that is infinite, below 0 or no number refuses its record.

    Naively its root is NaN, and a filter downstream weighs this record with it.
    """
    matrix = np.diag([0.1, 0.1, wrong, 0.1, 0.1, 0.1])
    refused = odometry_of(record_of(matrix))
    assert isinstance(refused, Reject)
    assert refused.reason in ("not_finite", "negative_variance")
