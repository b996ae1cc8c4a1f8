"""Mean echo power of each cell: Lambert's law, summed over every patch of surface in it."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.casting import Fan, Hits
from sonar_sim.pattern import vertical_two_way_power
from sonar_sim.sonar import SonarSettings

MAX_EXTENT = 0.5
"""A ray's footprint is drawn no longer than this part of its range: it would be no plane there."""


def echo_power(
    hits: Hits, fan: Fan, sonar: SonarSettings, absorption_db_per_m: float
) -> NDArray[np.float64]:
    """Sum the patches' echoes in each range row and column, before the azimuth beam pattern.

    Args:
        hits: what the rays met.
        fan: the rays.
        sonar: settings.
        absorption_db_per_m: one way.

    Returns:
        Power (rows, fan.columns) relative to the source's at 1 m: spreading, absorption, vertical
        pattern and scattering; 1 would be a target of 0 dB at 1 m on the axis.
    """
    power = _ray_power(hits, fan, sonar, absorption_db_per_m)
    ray, row, share = _rows_covered(hits, fan, sonar)
    summed: NDArray[np.float64] = np.bincount(
        row * fan.columns + fan.column[hits.ray[ray]],
        weights=power[ray] * share,
        minlength=sonar.rows * fan.columns,
    ).astype(np.float64)
    return summed.reshape(sonar.rows, fan.columns)


def _ray_power(
    hits: Hits, fan: Fan, sonar: SonarSettings, absorption_db_per_m: float
) -> NDArray[np.float64]:
    """Echo of each ray's patch.

    Lambert scatters mu cos²i a unit area, the patch covers R² dOmega / cos i, and spreading takes
    R^-4: mu cos i dOmega / R² remains.
    """
    direction = fan.directions[hits.ray]
    cos_incidence = np.abs(np.sum(hits.normal * direction, axis=1))
    vertical = vertical_two_way_power(direction[:, 2], sonar.vertical_width_rad)
    absorbed = 10.0 ** (-0.2 * absorption_db_per_m * hits.range_m)
    scattered = hits.mu * cos_incidence * fan.solid_angle_sr[hits.ray]
    power: NDArray[np.float64] = scattered * vertical * absorbed / np.square(hits.range_m)
    return power


def _range_extents(hits: Hits, fan: Fan) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far a ray's cell reaches in range over its patch's plane, across and along the fan.

    On the plane n.p = const the range is R = const / (n.d), so dR = -R (n.dd) / (n.d).
    """
    x, y, z = fan.directions[hits.ray].T
    nx, ny, nz = hits.normal.T
    facing = nx * x + ny * y + nz * z
    reach = hits.range_m / np.maximum(np.abs(facing), 1e-6)
    # d = (sqrt(1 - s² - w²), -s, w): dx/ds = -s/x = y/x and dx/dw = -w/x = -z/x.
    across = reach * np.abs(nx * y / x - ny) * fan.sine_step
    along = reach * np.abs(nz - nx * z / x) * fan.up_step
    longest = MAX_EXTENT * hits.range_m
    return np.minimum(across, longest), np.minimum(along, longest)


def _rows_covered(
    hits: Hits, fan: Fan, sonar: SonarSettings
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Share each ray's power among the rows that its footprint covers.

    A grazing floor is crossed by neighbouring rays many rows apart; power put where the rays meet
    it alone would draw stripes, which no number of rays in reach removes.

    Returns:
        Pairs of a hit's index and a row, and the share of the hit's power in that row.
    """
    row_m = sonar.range_resolution_m
    across_m, along_m = _range_extents(hits, fan)
    half_m = (across_m + along_m) / 2.0
    first = np.floor((hits.range_m - half_m) / row_m).astype(np.int64)
    last = np.floor((hits.range_m + half_m) / row_m).astype(np.int64)
    edges = last - first + 2
    ends = np.cumsum(edges)
    ray = np.repeat(np.arange(len(edges)), edges)
    row = np.arange(len(ray)) - np.repeat(ends - edges - first, edges)
    wide, narrow = np.maximum(across_m, along_m), np.minimum(across_m, along_m)
    below = _share_below(row * row_m - hits.range_m[ray], wide[ray], narrow[ray])
    share = np.diff(below, append=0.0)
    # The step from a ray's last edge to the next ray's first one is no row.
    inside = (row >= 0) & (row < sonar.rows)
    inside[ends - 1] = False
    return ray[inside], row[inside], share[inside]


def _share_below(
    offset_m: NDArray[np.float64], wide_m: NDArray[np.float64], narrow_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Share of a footprint nearer than an offset from its middle.

    The footprint is a parallelogram, whose ranges are the sum of two uniform spreads: a trapezoid.
    Its distribution is the mean of the wide spread's over the narrow one.
    """
    wide = np.maximum(wide_m, 1e-9)
    narrow = np.maximum(narrow_m, 1e-9)
    ramp = _ramp_integral(offset_m + narrow / 2.0, wide) - _ramp_integral(
        offset_m - narrow / 2.0, wide
    )
    share: NDArray[np.float64] = np.clip(ramp / narrow, 0.0, 1.0)
    return share


def _ramp_integral(
    offset_m: NDArray[np.float64], width_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Integral from -inf of the distribution function of a uniform spread about 0."""
    inside = np.clip(offset_m + width_m / 2.0, 0.0, width_m)
    beyond = np.maximum(offset_m - width_m / 2.0, 0.0)
    integral: NDArray[np.float64] = np.square(inside) / (2.0 * width_m) + beyond
    return integral
