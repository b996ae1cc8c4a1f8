"""Hard cases of a ping's way into the map: its samples."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapperd.imaging.ping_image import display_units
from tests.stability.iwlo_oracle import Rule, WholeRule
from tests.stability.pings import Look, at, cells, empty, fan, same, wall


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32])
def test_full_scale_of_any_width_is_255(kind: type[np.unsignedinteger]) -> None:
    """Samples of 8, 16 and 32 bits mean the same, and full scale is what the sigmoid ends at.

    Naively a sample of 32 bits is held in single precision before it is divided: its last eight
    bits are gone, and 35 of 255 is on either side of the threshold.
    """
    full = int(np.iinfo(kind).max)
    samples = np.array([[0, full // 255, 35 * (full // 255), full - 1, full]], kind)
    exact = samples.astype(np.float64) * 255 / full
    got = display_units(samples, full)
    assert got[0, -1] == 255.0
    assert got[0, 0] == 0.0
    assert got[0, 2] == 35.0
    assert got.astype(np.float64) == pytest.approx(exact, rel=2**-24)
    assert (np.diff(got[0]) >= 0).all()
    whole = (np.arange(256, dtype=np.uint64) * (full // 255)).astype(kind)
    assert (display_units(whole[None], full) == np.arange(256)).all()


def test_an_image_of_16_bits_maps_as_its_8_bits_do() -> None:
    """Half of the fleet sends 16 bits: a mixed survey is one map.

    Naively 16 bits are shifted down by eight, and each sample loses up to a whole step of 255.
    """
    eight = np.round(wall()).astype(np.uint8)
    sixteen = eight.astype(np.uint16) * 257
    maps = [Look(image=display_units(s, int(np.iinfo(s.dtype).max))) for s in (eight, sixteen)]
    assert same(maps[0].into(empty()), maps[1].into(empty()))


def test_the_smallest_sample_of_all_is_a_return_above_a_threshold_of_0() -> None:
    """A float image may hold denormals, and a threshold of 0 calls all above it returns.

    Naively a library has set the processor to flush denormals to 0, and echo and silence are one.
    """
    tiny = np.where(wall() > 0, np.float32(1e-45), np.float32(0))
    assert tiny.max() > 0
    voxels = Look(image=tiny).into(empty(intensity_threshold=0.0))
    assert voxels.class_counts(0.0, 0.0)[0] > 100
    units = WholeRule(Rule())
    least = units.full_of(2) * units.unit
    assert voxels.voxels()[1].max() == least
    assert abs(least - 3.5 / (1 + math.exp(1.5))) <= units.unit / 2  # it is rounded once


def test_an_image_of_full_scale_is_a_wall_at_the_nearest_row() -> None:
    """A sonar lifted out of the water, or one that hears another, is white all over.

    Naively each sample is a surface, and there is free water between none of them: or the water
    before the first return is carved to the end of the range.
    """
    look = Look(image=np.full((60, 33), 255, np.float32))
    voxels = look.into(empty())
    occupied, free, _ = voxels.class_counts(0.0, 0.0)
    assert free == 0
    assert occupied > 1000
    units = WholeRule(Rule())
    most = units.full_of(255) * units.unit
    assert voxels.voxels()[1].max() == most
    # Rounded three times to half a unit: the least step, the slope over all codes, their product.
    assert abs(most - 3.5 / (1 + math.exp(-1.5))) <= 1.5 * units.unit
    for _ in range(5):
        look.into(voxels)
    assert voxels.voxels()[1].max() == 10.0


def test_an_image_of_silence_makes_no_map_and_no_memory() -> None:
    """A sonar in open water for a night sends empty pings, ten a second.

    Naively beams without a return carve their whole length, and a wall out of hearing goes.
    """
    silence = Look(image=np.zeros((60, 33), np.float32))
    voxels = empty()
    memory = voxels.memory_bytes
    for _ in range(100):
        silence.into(voxels)
    assert (voxels.memory_bytes, voxels.block_count) == (memory, 0)
    known = Look().into(voxels).encode_map()
    silence.into(voxels)
    assert voxels.encode_map() == known


def test_a_sample_at_the_threshold_is_water_and_the_next_float_a_return() -> None:
    """The threshold is strict, and given in double where samples are single precision.

    Naively the threshold is rounded to the samples' precision, below 35.1 here: whether the sample
    that it falls upon is a return is a matter of luck.
    """
    lower = np.float32(35.1)
    upper = np.nextafter(lower, np.float32(99))
    assert float(lower) < 35.1 < float(upper)
    for sample, returns in ((lower, False), (upper, True)):
        image = np.where(wall() > 0, sample, np.float32(0)).astype(np.float32)
        voxels = Look(image=image).into(empty(intensity_threshold=35.1))
        assert (voxels.block_count > 0) == returns


@pytest.mark.parametrize("detail", [0.25, 0.3, 1.0, math.nextafter(1.0, 2.0), 3.7, 8.0])
def test_a_detail_of_any_size_is_finite_and_near(detail: float) -> None:
    """The detail sets the spacing of the evidence grid, finer or coarser than the image's own rows.

    Naively the spacing becomes a whole number of rows: none at all with a detail of 8, and with one
    of 0.25 the rows that do not fill the last step are left out.
    """
    finest = cells(Look(detail=8.0).into(empty()))
    got = cells(Look(detail=detail).into(empty()))
    assert np.isfinite(list(got.values())).all()
    common = finest.keys() & got.keys()
    assert len(common) > 0.9 * len(finest.keys() | got.keys())
    off = np.array([abs(got[key] - finest[key]) for key in common])
    assert np.median(off) <= 0.1 / detail


def test_one_bright_sample_in_a_voxel_of_a_million_is_not_lost() -> None:
    """A fine sonar in a coarse map: a voxel holds thousands of samples, one of them a return.

    Naively the mean over samples rounds a part of 1e-4 away, or lets it stand for the whole voxel:
    2 % of the volume is the least that counts.
    """
    image = np.zeros((400, 257), np.float32)
    image[200, 128] = 255
    look = Look(image=image, bearings_rad=fan(257), row_m=0.01, pose=at(0.05, 0.05, 0.05))
    coarse = look.into(empty(1.0))
    assert coarse.class_counts(0.0, 0.0)[0] == 0
    fine = look.into(empty(0.02))
    assert 0 < fine.class_counts(0.0, 0.0)[0] < 2000


def test_a_mean_of_both_kinds_lies_between_them_at_all_weights() -> None:
    """With `aggregation: mean` a voxel takes the average of its free and its occupied part.

    Naively the two sums are divided by their volumes apart, and a voxel of 1e-9 free volume takes
    a whole free step.
    """
    rng = np.random.default_rng(8)
    image = np.where(rng.uniform(size=(60, 33)) < 0.2, 255, 0).astype(np.float32)
    mean = cells(Look(image=image, aggregation="mean").into(empty()))
    step = 3.5 / (1 + math.exp(-1.5))
    values = np.array(list(mean.values()))
    assert np.isfinite(values).all()
    assert values.min() >= -3.0 - 1e-6
    assert values.max() <= step + 1e-6
    assert ((values > -2.9) & (values < step - 0.1)).sum() > 100
