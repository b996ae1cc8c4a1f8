"""Hard cases of the particle filter: maps, and particles where no map is."""

from __future__ import annotations

import numpy as np
import pytest

from mapperd.localization.particle_filter import (
    Beams,
    Endpoints,
    FreeSpace,
    HitModel,
    LikelihoodField,
    ParticleFilter,
    RangeMap,
)
from tests.mapperd.localization.filter_cases import (
    BEAM,
    HIT,
    beam_likelihood,
    endpoints,
    field_likelihood,
    grid,
    pose,
    rule,
)

AHEAD = Beams(bearing_rad=np.zeros(1), range_m=np.array([3.0]), quality=np.ones(1))


def test_map_without_free_cells() -> None:
    """Starting anywhere needs a free cell; a map without one is refused and the cloud stays.

    Naively drawing until a free cell comes never ends, and the last of no cells lies before the
    list.
    """
    for value in (100, -1, 50):
        full = grid(np.full((5, 5), value, np.int8), 0.5)
        with pytest.raises(ValueError, match="no free cell"):
            FreeSpace(full)
    particles = ParticleFilter(rule(), 1)
    particles.start_about(pose(0, 0, 0), np.eye(3))
    before = particles.poses
    with pytest.raises(ValueError, match="no free cell"):
        particles.start_anywhere(FreeSpace(full))
    assert (particles.poses == before).all()


def test_map_without_obstacles() -> None:
    """With nothing to spread distances from, each cell is far from everything.

    Naively distances that nobody filled in stay 0, and all water looks like a wall.
    """
    field = LikelihoodField.of_grid(grid(np.zeros((5, 5), np.int8), 0.5), HIT)
    assert field.values() == pytest.approx(HIT.density(2.0))
    ranges = RangeMap(grid(np.zeros((100, 100), np.int8), 0.5))
    assert ranges.cast(np.array([[25.0, 25.0, 0.3]]), 20.0) == pytest.approx(20.0)


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (5, 0)])
def test_map_without_cells(shape: tuple[int, int]) -> None:
    """A map of no rows or no columns is refused.

    Naively the column of a cell is its index modulo a width of 0: the program dies.
    """
    with pytest.raises(ValueError, match="cells"):
        grid(np.zeros(shape, np.int8), 0.5)


@pytest.mark.parametrize("resolution_m", [0.0, -1.0, np.nan, np.inf])
def test_map_of_no_resolution(resolution_m: float) -> None:
    """A cell edge of zero, below zero, or no number is refused.

    Naively places are divided by it: every cell's number is infinite, or NaN.
    """
    with pytest.raises(ValueError, match="resolution"):
        grid(np.zeros((5, 5), np.int8), resolution_m)


def test_particle_off_the_map() -> None:
    """A particle that left the map is weighed like one in open water.

    Naively it gets 1 / r_max, more than particles in mapped water: leaving is rewarded, and the
    cloud drifts off.
    """
    water = grid(np.zeros((50, 50), np.int8), 0.5)
    field = LikelihoodField.of_grid(water, HIT)
    inside = field_likelihood(field, pose(12, 12, 0), endpoints((1, 0)))
    outside = field_likelihood(field, pose(-500, 12, 0), endpoints((1, 0)))
    assert outside == pytest.approx(inside, rel=1e-12)
    ranges = RangeMap(water)
    nothing = beam_likelihood(ranges, pose(-500, 12, 0), AHEAD, BEAM)
    assert nothing == pytest.approx(BEAM_BACKGROUND**3, rel=1e-12)
    assert nothing <= beam_likelihood(ranges, pose(2, 12, 0), AHEAD, BEAM)


BEAM_BACKGROUND = 0.5 / 20.0


def test_particle_within_an_obstacle() -> None:
    """At an expected range of 0, half the Gaussian and all short readings are cut off.

    Naively their parts of the density are divided by a width of 0.
    """
    wall = grid(np.full((50, 50), 100, np.int8), 0.5)
    likelihood = beam_likelihood(RangeMap(wall), pose(12, 12, 0), AHEAD, BEAM)
    assert likelihood == pytest.approx(BEAM_BACKGROUND**3, rel=1e-6)


def test_particle_in_unknown_space() -> None:
    """Unknown cells stop a ray only where that is asked for.

    Naively unknown counts as occupied, every ray is 0 long, and all particles are alike.
    """
    occupancy = np.full((50, 50), -1, np.int8)
    occupancy[:, 40] = 100
    ray = np.array([[12.0, 12.0, 0.0]])
    assert RangeMap(grid(occupancy, 0.5)).cast(ray, 20.0) == pytest.approx(8.0)
    assert RangeMap(grid(occupancy, 0.5), unknown_blocks=True).cast(ray, 20.0) == pytest.approx(0)


def test_coordinates_far_from_the_origin() -> None:
    """A map at UTM coordinates is read as sharply as one at the origin.

    Naively, in single precision, places at 7e6 m are whole half metres.
    """
    occupancy = np.zeros((50, 50), np.int8)
    occupancy[:, 40] = 100
    far = grid(occupancy, 0.1, (6.5e6, -7.0e6, 0.0))
    ray = np.array([[6.5e6 + 1.0, -7.0e6 + 2.5, 0.0]])
    assert RangeMap(far).cast(ray, 4.9) == pytest.approx(3.0, abs=1e-6)
    field = LikelihoodField.of_grid(far, HIT)
    seen = field_likelihood(field, ray[0], endpoints((3.05, 0.0)))
    assert seen == pytest.approx(1 + HIT.density(0) ** 3, rel=1e-6)


@pytest.mark.parametrize("place", [1e18, -1e300])
def test_huge_coordinates(place: float) -> None:
    """Particles whose cell numbers fit no integer are off the map, and stay numbers.

    Naively the conversion to an integer is undefined: some cell or other is read, or memory
    beyond the map.
    """
    particles = ParticleFilter(rule(50, 300), 1)
    particles.start_about(pose(place, place, 0), np.eye(3))
    field = LikelihoodField.of_grid(grid(np.zeros((5, 5), np.int8), 0.5), HIT)
    particles.weigh_field(field, endpoints((1, 1), (2, 2)), "product")
    particles.weigh_beams(RangeMap(grid(np.zeros((5, 5), np.int8), 0.5)), AHEAD, BEAM)
    particles.resample()
    particles.modes()
    assert np.isfinite(particles.weights).all()
    assert np.isfinite(particles.estimate().mean).all()


def test_grazing_rays() -> None:
    """Rays along a wall's face end where they meet it, to a tenth of a millimetre.

    Naively a march of fixed steps, or a slope divided by 1e-9, ends early or slips through the
    wall.
    """
    occupancy = np.zeros((100, 400), np.int8)
    occupancy[50] = 100
    ranges = RangeMap(grid(occupancy, 0.1))
    for angle in (1e-9, 1e-6, 1e-3, 0.1):
        ray = np.array([[1.0, 4.9, angle]])
        exact = 0.1 / np.sin(angle)
        assert ranges.cast(ray, 35.0)[0] == pytest.approx(min(35.0, exact), abs=1e-4)


def test_rays_between_diagonal_cells() -> None:
    """No ray slips between two occupied cells that touch at a corner.

    Naively a standard line of cells goes from one free cell to the next across the corner.
    """
    occupancy = np.eye(40, dtype=np.int8)[::-1].copy() * 100
    ranges = RangeMap(grid(occupancy, 0.5))
    rays = np.array([[2.0, 2.0, yaw] for yaw in np.linspace(0.4, 1.1, 301)])
    found = ranges.cast(rays, 30.0)
    assert ((found > 0) & (found < 20)).all()


def test_layers_of_a_field_and_ends_above_and_below() -> None:
    """Ends of beams above the top layer or below the lowest are outside the field.

    Naively the layer's number is cast from 1e300 and memory beyond the field is read.
    """
    distances = np.zeros((4, 4, 4), np.float32)
    distances[0, 0, 0] = np.nan
    model = HitModel(z_hit=0.5, z_rand=0.5, sigma_hit_m=0.2, max_range_m=20, max_distance_m=2)
    field = LikelihoodField.of_distances(distances, np.array([0.5, 0.5, 0.5]), 1.0, model)
    for z in (-1e300, -0.01, 4.01, 1e300):
        ends = Endpoints(np.array([[[1.0, 1.0, z]]]), np.ones(1))
        got = field_likelihood(field, pose(1, 1, 0), ends, "product")
        assert got == pytest.approx(field.background, rel=1e-9)


def test_distances_that_nobody_knows_and_beyond_the_truncation() -> None:
    """An unknown distance is as likely as one beyond the truncation, and as what is off the map.

    Naively one is NaN, the other an underflow, and a beam that ends there decides everything.
    """
    model = HitModel(z_hit=1.0, z_rand=0.0, sigma_hit_m=1.0, max_range_m=20, max_distance_m=2)
    distances = np.full((3, 3, 2), 1e9, np.float32)
    distances[0, 0, 0], distances[1, 1, 1], distances[2, 2, 0] = np.nan, 0.5, np.inf
    field = LikelihoodField.of_distances(distances, np.array([0.5, 0.5, 0.5]), 1.0, model)
    wanted = np.full((3, 3), model.density(2.0))
    assert field.background == pytest.approx(model.density(2.0))
    assert field.values(0) == pytest.approx(wanted)
    wanted[1, 1] = model.density(0.5)
    assert field.values(1) == pytest.approx(wanted)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -1e-9, 1e16])
def test_given_likelihoods_that_are_invalid(wrong: float) -> None:
    """Values of a field that are not numbers, negative or infinite are refused.

    Naively one NaN in a corner waits for the particle whose beam ends there.
    """
    values = np.full((5, 5), 0.1, np.float32)
    LikelihoodField.of_values(values, 0.5, pose(0, 0, 0), 0.1)
    values[4, 4] = wrong
    with pytest.raises(ValueError, match="finite and not negative"):
        LikelihoodField.of_values(values, 0.5, pose(0, 0, 0), 0.1)
    with pytest.raises(ValueError, match="finite and not negative"):
        LikelihoodField.of_values(np.ones_like(values), 0.5, pose(0, 0, 0), wrong)


@pytest.mark.parametrize("yaw", [0.0, 1e-300, -1e-300])
def test_a_ray_exactly_along_an_axis(yaw: float) -> None:
    """A ray whose direction has a part of exactly 0 runs through a passage of one cell.

    Naively it is divided by: the next edge to that side lies at minus infinity, and the ray stays
    in its first cell.
    """
    occupancy = np.full((3, 40), 100, np.int8)
    occupancy[1, :35] = 0
    ranges = RangeMap(grid(occupancy, 0.5))
    rays = np.array([[1.25, y, yaw] for y in (0.501, 0.75, 0.999)])
    assert ranges.cast(rays, 30.0) == pytest.approx(16.25, abs=1e-8)
