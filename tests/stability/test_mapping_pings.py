"""Hard cases of a ping's way into the map: its geometry."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from tests.stability.pings import Look, at, cells, empty, fan, same, wall

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""A turn by 90 degrees about z, without a rounding."""


@pytest.mark.parametrize("kind", [{}, {"detail": 4.0}, {"aggregation": "mean"}])
def test_a_tank_and_an_ocean_of_one_shape_give_the_same_bits(kind: dict[str, object]) -> None:
    """Voxels of 0.4 mm in a tank and of 100 m at sea are one scene, if all lengths go with them.

    Naively a small number of metres is added somewhere to be safe, and is a fourth of a voxel in
    the tank, or lost at sea.
    """
    usual = Look(**kind)  # type: ignore[arg-type]
    expected = usual.into(empty(0.1))
    assert expected.known_count() > 1000
    for scale in (2.0**-8, 2.0**10):
        scaled = usual.but(row_m=0.05 * scale, min_range_m=0.3 * scale, pose=usual.pose.copy())
        scaled.pose[:3, 3] *= scale
        assert same(scaled.into(empty(0.1 * scale)), expected)


def test_a_quarter_turn_of_the_sonar_turns_the_map() -> None:
    """The evidence of a ping for a voxel does not depend on the sonar's heading.

    Naively a bearing is taken as atan(y / x), which divides by 0 abeam and knows no astern.
    """
    look = Look(pose=at(0.05, 0.05, 0.05))
    before = cells(look.into(empty()))
    turned, pose = before, look.pose
    for _ in range(4):
        pose = at(0.05, 0.05, 0.05, QUARTER @ pose[:3, :3])
        turned = {(-y, x, z): value for (x, y, z), value in turned.items()}
        got = cells(look.but(pose=pose).into(empty()))
        assert got.keys() == turned.keys()
        assert max(abs(got[key] - turned[key]) for key in got) < 1e-5


@pytest.mark.parametrize("detail", [1.0, 4.0])
@pytest.mark.parametrize("beams", [8, 32, 40])
def test_a_mirrored_image_gives_a_mirrored_map(beams: int, detail: float) -> None:
    """Port and starboard are alike: a mirrored image makes a mirrored map.

    Naively a beam has the voxels from its bearing to the next one's, and the whole map is half a
    beam off to one side.
    """
    # The grid takes one cosine for eight beams: groups, too, are to be each other's image. And no
    # voxel's centre is to lie on the axis, where two columns of the grid are equally near.
    look = Look(image=wall(beams=beams), bearings_rad=fan(beams), pose=at(0.05, 0.0, 0.05))
    flipped = look.but(image=np.ascontiguousarray(look.image[:, ::-1]), detail=detail)
    before = cells(look.but(detail=detail).into(empty()))
    after = cells(flipped.into(empty()))
    assert len(before) > 1000
    assert {(x, -1 - y, z): value for (x, y, z), value in after.items()} == before


@pytest.mark.parametrize("y", [0.0, 0.05])
def test_a_mirrored_image_of_33_beams_gives_a_mirrored_map_of_classes(y: float) -> None:
    """Beams need not be whole groups of eight, nor the sonar lie on a face of the grid.

    Naively the middle of the last group is reckoned with beams that are not there, and one side of
    the fan is wider than the other.
    """
    # Of one intensity all weights are alike, whatever footprint they are the mean of.
    image = np.where(wall() > 100, np.float32(200), np.float32(0)).astype(np.float32)
    look = Look(image=image, pose=at(0.05, y, 0.05))
    before = cells(look.into(empty()))
    after = cells(look.but(image=np.ascontiguousarray(image[:, ::-1])).into(empty()))
    mirrored = {(x, -j if y > 0 else -1 - j, z): value for (x, j, z), value in after.items()}
    common = before.keys() & mirrored.keys()
    assert len(common) > 1000
    differ = before.keys() ^ mirrored.keys()
    differ |= {key for key in common if before[key] != mirrored[key]}
    classes = {key: value > 0 for key, value in before.items()}
    around = list(itertools.product((-1, 0, 1), repeat=3))
    beside = {
        (x, j, z)
        for x, j, z in before.keys() | mirrored.keys()
        if len({classes.get((x + a, j + b, z + c)) for a, b, c in around}) > 1
    }
    assert differ <= beside
    # Groups of beams 0 to 7 and of 32 alone are each other's image: footprints differ by
    # 0.54 (cos 0.70 - cos 0.9) = 0.077 edges, and so does the place where a class ends.
    assert len(differ) <= 0.077 * len(beside)


def test_a_sonar_that_looks_astern_has_no_seam_at_180_degrees() -> None:
    """A sonar that looks along -x has half of its beams on each side of heading ±180°.

    Naively bearings in the map's frame are compared without a wrap: the beams of one side are a
    whole turn off, and the map has a gap along -x.
    """
    astern = np.diag([-1.0, -1.0, 1.0])
    ahead = cells(Look(pose=at(0.05, 0.05, 0.05)).into(empty()))
    behind = cells(Look(pose=at(0.05, 0.05, 0.05, astern)).into(empty()))
    assert {(-x, -y, z) for x, y, z in ahead} == set(behind)
    assert max(abs(behind[-x, -y, z] - ahead[x, y, z]) for x, y, z in ahead) < 1e-5


def test_a_fan_of_half_a_turn_sees_what_is_abeam() -> None:
    """Bearings of ±90° are allowed, and their beams look straight to port and starboard.

    Naively a beam's direction is its tangent, which is 1.6e16 at 90° and of the other sign a last
    bit beyond.
    """
    look = Look(image=wall(beams=65), bearings_rad=fan(65, math.pi / 2), pose=at(0.05, 0.05, 0.05))
    found = cells(look.into(empty()))
    assert {key for key in found if key[1] == 15 and key[0] in (0, 1)}
    assert {key for key in found if key[1] == -15 and key[0] in (0, 1)}
    assert not [key for key in found if key[0] < -2]


@pytest.mark.parametrize(("rows", "beams"), [(1, 1), (1, 2), (1, 33), (60, 1), (60, 2)])
def test_an_image_of_one_row_or_one_beam_is_mapped_or_refused(rows: int, beams: int) -> None:
    """A single beam has no neighbour that gives its width, a single row none before it.

    Naively the width is half the distance to the next beam, read from beyond the table's end.
    """
    image = np.full((rows, beams), 200, np.float32)
    bearings = fan(beams) if beams > 1 else np.zeros(1)
    look = Look(image=image, bearings_rad=bearings, row_m=1.5 if rows == 1 else 0.05)
    if beams == 1:
        with pytest.raises(ValueError, match="two beams"):
            look.into(empty())
        return
    log_odds = look.into(empty()).voxels()[1]
    assert len(log_odds) > 0
    assert np.isfinite(log_odds).all()


def test_beams_that_all_but_coincide_leave_no_hole() -> None:
    """A table of bearings may hold two beams that differ by the last bit alone.

    Naively the beam between is of width 0, and what is divided by that is infinite.
    """
    bearings = fan()
    bearings[17] = math.nextafter(bearings[16], 1.0)
    bearings[18] = math.nextafter(bearings[17], 1.0)
    look = Look(image=np.where(wall() > 0, np.float32(200), np.float32(0)), bearings_rad=bearings)
    found, usual = cells(look.into(empty())), cells(look.but(bearings_rad=fan()).into(empty()))
    assert np.isfinite(list(found.values())).all()
    # Who fills the space does not matter where all beams see the same.
    assert found.keys() == usual.keys()
    assert max(abs(found[key] - usual[key]) for key in found) < 1e-3


def test_a_range_of_less_than_a_voxel_marks_no_more_than_it_fills() -> None:
    """A coarse map for a survey, and a sonar held before a wall: the whole fan is in a few voxels.

    Naively each sample marks the voxel it falls into, and 2000 of them make it sure.
    """
    look = Look(image=np.full((60, 33), 200, np.float32), row_m=0.01, min_range_m=0.0)
    voxels = look.into(empty(10.0))
    assert voxels.known_count() == 0
    near = look.but(row_m=0.2, aperture_rad=1.0).into(empty(4.0))
    assert near.voxels()[2].max() == 1
    assert near.voxels()[1].max() < 3.5


@pytest.mark.parametrize("turned_by", [1e-9, 3e-7])
def test_a_pose_that_drifted_off_its_rotation_maps_as_the_rotation(turned_by: float) -> None:
    """A rotation multiplied a million times is off a true rotation by some 1e-10 to 1e-7.

    Naively it is refused as invalid, or its stretch is taken for lengths and the voxels at the end
    of the range are others.
    """
    drifted = np.eye(3) * (1 + turned_by)
    look = Look(pose=at(0.013, 0.021, -0.034))
    exact = cells(look.into(empty()))
    got = cells(look.but(pose=at(0.013, 0.021, -0.034, drifted)).into(empty()))
    common = exact.keys() & got.keys()
    assert len(common) > 0.999 * len(exact.keys() | got.keys())
    assert np.median([abs(got[key] - exact[key]) for key in common]) < 1e-5


def test_free_water_does_not_depend_on_the_order_of_pings() -> None:
    """Recordings of two sonars may be merged in either order, and free water be the same.

    Naively each step is rounded as a float when it is added, and sums of floats depend on their
    order.
    """
    looks = [
        Look(
            image=np.zeros((60, 33), np.float32),
            pose=at(0.1 * k, -0.07 * k, 0.03 * k),
            carve_no_return=True,
        )
        for k in range(6)
    ]
    forwards, backwards = empty(), empty()
    for look in looks:
        look.into(forwards)
    for look in reversed(looks):
        look.into(backwards)
    assert forwards.known_count() > 1000
    assert same(forwards, backwards)
    assert forwards.encode_map() == backwards.encode_map()


@pytest.mark.parametrize("detail", [1.0, 4.0])
def test_planes_through_the_corners_of_voxels_cut_them_alike(detail: float) -> None:
    """A sonar in a corner of the grid, with beams and an aperture that end along its diagonals.

    Naively a corner in a plane is on one side or the other by a rounding: voxels that mirror each
    other are free on one side of the sonar and untouched on the other.
    """
    sines = np.linspace(-math.sin(math.pi / 4), math.sin(math.pi / 4), 9)
    image = np.zeros((20, 9), np.float32)
    image[15] = 200
    look = Look(
        image=image,
        bearings_rad=np.arcsin(sines),
        row_m=0.1,
        pose=np.eye(4),
        aperture_rad=math.pi / 2,
        detail=detail,
    )
    found = cells(look.into(empty()))
    assert np.isfinite(list(found.values())).all()
    for y, z in ((-1, 1), (1, -1), (-1, -1)):
        mirrored = {
            (i, j if y > 0 else -1 - j, k if z > 0 else -1 - k): value
            for (i, j, k), value in found.items()
        }
        common = found.keys() & mirrored.keys()
        assert len(common) > 0.995 * len(found)
        off = np.array([abs(found[key] - mirrored[key]) for key in common])
        assert off.max() < 0.2
