"""Multipath: a calm surface or a smooth wall reflects echoes; ghosts appear."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.echoes import COLUMNS, GRAZING, Echoes
from sonar_sim.effects.effect import Cost, Effect, EffectParameter, RuleResult, by_level
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.planes import MirrorPlane, coherence
from sonar_sim.effects.preview import PingPreview
from sonar_sim.geometry.matmul import rows_dot
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.mirror import reaches_mirror
from sonar_sim.propagation.physics import Mirror, Physics

MIN_REFLECTION = 0.01
"""Of pressure: a bounce that keeps less is 40 dB down."""
NEAR_M = 0.02
"""How near a ray must come to the point it was sent to."""


@dataclass(frozen=True, slots=True, eq=False)
class Ghosts:
    """What a plane adds.

    Attributes:
        mirror: the plane with the coherence of its strongest ghosts.
        picture: expected power of a pixel, (rows, COLUMNS).
    """

    mirror: Mirror
    picture: NDArray[np.float64]


def mirror_ghosts(view: PingPreview, planes: Sequence[MirrorPlane]) -> list[Ghosts | None]:
    """Compute the ghosts in each plane; None if no ghost is in range."""
    near = _may_mirror(view, planes) if planes else ()
    return [
        _ghosts_in(view, plane) if may else None for plane, may in zip(planes, near, strict=True)
    ]


def _may_mirror(view: PingPreview, planes: Sequence[MirrorPlane]) -> NDArray[np.bool_]:
    """Bound of which planes may have ghosts in range, (P,)."""
    sonar_m = view.map_T_sonar.position_m
    low_m, high_m = np.array([p.low_m for p in planes]), np.array([p.high_m for p in planes])
    # A bounce is no farther off than half of the whole way there and back.
    away_m = np.linalg.norm(np.clip(sonar_m, low_m, high_m) - sonar_m, axis=1)
    corner_m = np.maximum(np.abs(low_m - sonar_m), np.abs(high_m - sonar_m)) + NEAR_M
    farthest_m = np.minimum(2.0 * view.sonar.range_m, np.linalg.norm(corner_m, axis=1))
    normal = np.array([p.normal for p in planes])
    height_m = np.abs(np.sum((sonar_m - np.array([p.point_m for p in planes])) * normal, axis=1))
    steepest = np.array([_steepest_cosine(plane, _wave_number_per_m(view)) for plane in planes])
    may: NDArray[np.bool_] = (away_m <= view.sonar.range_m) & (height_m <= farthest_m * steepest)
    return may


def _wave_number_per_m(view: PingPreview) -> float:
    return 2.0 * math.pi * view.sonar.frequency_hz / view.speed_of_sound_mps


def _ghosts_in(view: PingPreview, plane: MirrorPlane) -> Ghosts | None:
    sonar_m, echoes = view.map_T_sonar.position_m, view.echoes
    side = math.copysign(1.0, float((sonar_m - plane.point_m) @ plane.normal))
    normal = side * plane.normal
    sonar_height_m = float((sonar_m - plane.point_m) @ normal)
    # The way to the image of a point is as long as that by the mirror, and as steep.
    height_m = rows_dot(echoes.point_m, normal) - float(plane.point_m @ normal)
    bounced_m = np.sqrt(np.square(echoes.range_m) + np.maximum(4.0 * sonar_height_m * height_m, 0))
    cos_bounce = np.maximum((sonar_height_m + height_m) / bounced_m, GRAZING)
    gamma = abs(plane.reflection) * coherence(
        _wave_number_per_m(view), plane.roughness_m, cos_bounce
    )
    usable = (height_m > NEAR_M) & (gamma > MIN_REFLECTION)
    usable &= (echoes.range_m + bounced_m) / 2.0 < view.sonar.range_m
    its = np.flatnonzero(usable)
    if len(its) == 0:
        return None
    away = echoes.point_m[its] - 2.0 * height_m[its, None] * normal - sonar_m
    away /= bounced_m[its, None]
    local = away @ view.map_T_sonar.rotation
    foot_m = sonar_m + away * (sonar_height_m / cos_bounce[its])[:, None]
    there = np.all((foot_m > plane.low_m - NEAR_M) & (foot_m < plane.high_m + NEAR_M), axis=1)
    some = np.flatnonzero(there & (local[:, 0] > 0.0))
    if len(some) == 0:
        return None
    some = some[_bounces(view, plane, foot_m[some])]
    image_m = sonar_m - 2.0 * sonar_height_m * normal
    past_m = (sonar_height_m + NEAR_M) / cos_bounce[its[some]]
    some = some[_free(view, image_m, echoes.point_m[its[some]], past_m)]
    if len(some) == 0:
        return None
    its, local, away = its[some], local[some], away[some]
    bounced_m, gamma = bounced_m[its], gamma[its]
    echoes, power = echoes.take(its), view.echo_power[its]
    pattern = vertical_two_way_power(local[:, 2], view.sonar.vertical_width_rad)
    pattern = np.sqrt(pattern / np.maximum(view.pattern[its], 1e-12))
    ratio = np.square(gamma) * _ratio(view, echoes, pattern, away, bounced_m)
    column = _column(view, local)
    beside = np.clip(column, 0, COLUMNS - 1)
    inside = column == beside
    half = replace(echoes, range_m=(echoes.range_m + bounced_m) / 2.0)
    whole = replace(echoes, range_m=bounced_m, column=beside)
    # There by one way and back by the other, and the other way round: alike in phase.
    same = np.where(beside == echoes.column, 2.0, 1.0)
    picture = view.grid.picture(half, power * ratio * same)
    picture += view.grid.picture(replace(half, column=beside), power * ratio * same * inside)
    picture += view.grid.picture(whole, power * ratio**2 * inside)
    weight = power * ratio
    mean_gamma = float(np.sum(gamma * weight) / max(np.sum(weight), 1e-300))
    return Ghosts(
        Mirror(
            plane.point_m,
            normal,
            math.copysign(mean_gamma, plane.reflection),
            plane.surface,
            plane.low_m,
            plane.high_m,
        ),
        picture,
    )


def _steepest_cosine(plane: MirrorPlane, wave_number_per_m: float) -> float:
    """Cosine of incidence above which the plane keeps less than `MIN_REFLECTION`."""
    margin = math.log(max(abs(plane.reflection), MIN_REFLECTION) / MIN_REFLECTION) / 2.0
    phase = wave_number_per_m * plane.roughness_m
    return 1.0 if phase**2 <= margin else math.sqrt(margin) / phase


def _ratio(
    view: PingPreview,
    echoes: Echoes,
    pattern: NDArray[np.float64],
    away: NDArray[np.float64],
    bounced_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Power by the mirrored way over the direct way, one way: range, pattern, incidence.

    Args:
        view: of one pose.
        echoes: some of the view's.
        pattern: one-way power by the vertical pattern, mirrored over direct, (N,).
        away: directions in which they are mirrored, map frame, (N, 3).
        bounced_m: length of the mirrored way, (N,).
    """
    point = ~np.any(echoes.normal, axis=1)
    facing = np.abs(np.sum(echoes.normal * away, axis=1)) / np.maximum(
        echoes.cos_incidence, GRAZING
    )
    absorbed = 10.0 ** (-0.1 * view.water_db_per_m * (bounced_m - echoes.range_m))
    ratio: NDArray[np.float64] = (
        np.square(echoes.range_m / bounced_m) * pattern * np.where(point, 1.0, facing) * absorbed
    )
    return ratio


def _column(view: PingPreview, local: NDArray[np.float64]) -> NDArray[np.int64]:
    step = view.grid.sine[1] - view.grid.sine[0]
    column: NDArray[np.int64] = np.floor((-local[:, 1] - view.grid.sine[0]) / step + 0.5).astype(
        np.int64
    )
    return column


def _bounces(
    view: PingPreview, plane: MirrorPlane, foot_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the sonar sees the plane's own surface at points of the plane."""
    sonar_m = view.map_T_sonar.position_m
    way = foot_m - sonar_m
    length = np.linalg.norm(way, axis=1)
    direction = way / np.maximum(length, 1e-9)[:, None]
    reach_m = 2.0 * view.sonar.range_m
    met = view.meshes.cast(sonar_m, direction.astype(np.float32), view.time_s, reach_m, 1)
    mirror = Mirror(plane.point_m, plane.normal, plane.reflection, plane.surface)
    return reaches_mirror(view.meshes, mirror, met.face, met.range_m, length)


def _free(
    view: PingPreview,
    image_m: NDArray[np.float64],
    end_m: NDArray[np.float64],
    past_m: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Whether nothing stands between a mirror and points, seen from the sonar's image.

    Args:
        view: of one pose.
        image_m: the sonar's image, map frame, (3,).
        end_m: the points, (N, 3).
        past_m: range behind the mirror at which each ray begins, (N,).
    """
    way = end_m - image_m
    length = np.linalg.norm(way, axis=1)
    direction = way / np.maximum(length, 1e-9)[:, None]
    met = view.meshes.cast(
        image_m,
        direction.astype(np.float32),
        view.time_s,
        2.0 * view.sonar.range_m,
        threads=1,
        near_m=past_m.astype(np.float32),
    )
    end_of_free_m = past_m + (length - past_m) * 0.98 - NEAR_M
    free: NDArray[np.bool_] = met.range_m > end_of_free_m
    return free


_GHOSTS_CACHE: WeakKeyDictionary[Echoes, list[Ghosts]] = WeakKeyDictionary()


def decide_multipath(view: PingPreview, tolerance: Tolerance) -> RuleResult:
    """On if the ghosts in all planes together show."""
    if not view.planes:
        return RuleResult(on=False, reason="no plane is smooth enough to mirror", predicted_db=0.0)
    found = _ghosts(view)
    picture = view.picture + ghost_picture(view)
    strongest = max((abs(g.mirror.reflection) for g in found), default=0.0)
    reason = f"{len(found)} of {len(view.planes)} planes mirror, reflecting up to {strongest:.2g}"
    # Of a small mirror the coarse rays find few ghosts.
    anywhere = replace(tolerance, share=0.0)
    return by_level(view.change_db(picture, anywhere), tolerance, reason)


def ghost_picture(view: PingPreview) -> NDArray[np.float64]:
    """Expected power of a pixel by the ghosts in all planes, (rows, COLUMNS)."""
    return sum((g.picture for g in _ghosts(view)), np.zeros_like(view.picture))


def _ghosts(view: PingPreview) -> list[Ghosts]:
    known = _GHOSTS_CACHE.get(view.echoes)
    if known is None:
        found = mirror_ghosts(view, view.planes)
        known = _GHOSTS_CACHE[view.echoes] = [ghosts for ghosts in found if ghosts is not None]
    return known


def configure_multipath(physics: Physics, view: PingPreview) -> None:
    """List the planes that have ghosts in range."""
    physics.mirrors = tuple(ghosts.mirror for ghosts in _ghosts(view))


MULTIPATH = Effect(
    name="multipath",
    does="repeats echoes behind themselves, by way of the surface or a wall",
    needs="planes of at least 0.2 m², smooth against the wavelength",
    formula="images at (d + b) / 2, coherent, and b; G exp(-2 k² h² cos² i) a bounce",
    source="Eckart 1953; Lloyd's mirror",
    rule="the ghosts of a coarse picture change any pixel by more than the tolerance",
    cost=Cost.CAST,
    parameters=(
        EffectParameter("sea.rms_height_m", "m", "standard deviation of the surface's height"),
        EffectParameter("material.reflection", "1", "of pressure, signed"),
        EffectParameter("material.roughness_m", "m", "standard deviation of a wall's height"),
    ),
    decide=decide_multipath,
    configure=configure_multipath,
    anywhere=True,
)
