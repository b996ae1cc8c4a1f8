"""Texture of speckle in a picture, and displacement of its parts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.image_difference import full_scale, gamma_of
from sonar_sim.scene.sonar import SonarSettings

MIN_STEPS = 3.0
"""Steps of the quantiser under which a pixel's grain is not looked at."""
MIN_PIXELS = 1000
BLOCK = 48
MIN_SEEN = 1.0 / 3.0
"""Minimum part of a block that must be visible to find its displacement."""
REACH = 16
"""Cells within which a block is looked for."""
FOUND = 0.4
"""Correlation from which a block is taken for found."""
FAR_QUANTILE = 0.9
"""Part of the blocks that moved no farther than what counts."""
BROAD = 1.4
"""Correlation of both neighbours together, over the peak's, from which it is broad."""
GRAINED = 0.1
"""Coefficient of variation under which there is no grain to follow."""


@dataclass(frozen=True, slots=True, eq=False)
class SpeckleTexture:
    """A speckled picture divided by its expectation.

    Attributes:
        relative: amplitude over its expected value, 1 where it is not looked at, (rows, beams).
        looked_at: where there is something to see, (rows, beams).
    """

    relative: NDArray[np.float32]
    looked_at: NDArray[np.bool_]

    @property
    def statistics(self) -> tuple[float, float, float]:
        """Coefficient of variation, correlation with the next row, and with the next beam."""
        values = self.relative[self.looked_at]
        if len(values) < MIN_PIXELS:
            return 0.0, 0.0, 0.0
        variation = float(values.std() / values.mean())
        if variation < GRAINED:
            return variation, 0.0, 0.0
        return variation, self._correlation(0), self._correlation(1)

    def _correlation(self, axis: int) -> float:
        first = [slice(None), slice(None)]
        second = [slice(None), slice(None)]
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        both = self.looked_at[tuple(first)] & self.looked_at[tuple(second)]
        pair = self.relative[tuple(first)][both], self.relative[tuple(second)][both]
        return float(np.corrcoef(*pair)[0, 1]) if both.sum() > MIN_PIXELS else 0.0


def speckle_texture(
    speckled: NDArray[np.floating], expected: NDArray[np.floating], sonar: SonarSettings
) -> SpeckleTexture:
    """Divide a picture by its expectation where that is bright enough; amplitudes of full scale."""
    least = (MIN_STEPS / full_scale(sonar)) ** (1.0 / gamma_of(sonar))
    looked_at: NDArray[np.bool_] = (expected > least) & (speckled < 1.0)
    relative = np.ones(expected.shape, dtype=np.float32)
    relative[looked_at] = speckled[looked_at] / expected[looked_at]
    return SpeckleTexture(relative, looked_at)


def merged_texture(grains: Sequence[SpeckleTexture]) -> SpeckleTexture:
    """Pictures of the same surfaces by several seeds as one, below one another."""
    # No block, and no pair of neighbours, is of two pictures.
    fill = ((0, BLOCK - len(grains[0].relative) % BLOCK), (0, 0))
    return SpeckleTexture(
        np.concatenate([np.pad(g.relative, fill, constant_values=1.0) for g in grains]),
        np.concatenate([np.pad(g.looked_at, fill) for g in grains]),
    )


def texture_change(first: SpeckleTexture, second: SpeckleTexture) -> float:
    """Largest difference of coefficient of variation and neighbours' correlations.

    Both are read where both pictures show some grain: what shows in one of them alone is a
    difference of level.
    """
    both = first.looked_at & second.looked_at
    pairs = zip(
        *(SpeckleTexture(g.relative, both).statistics for g in (first, second)), strict=True
    )
    return max(float(abs(a - b)) for a, b in pairs)


def displacement_cells(first: SpeckleTexture, second: SpeckleTexture) -> float | None:
    """How far the second picture's parts have moved, in rows or beams; None if none is found again.

    Blocks are looked for by cross-correlation, and the farthest of nine in ten counts. A
    block that is found nowhere has new speckle, which is no displacement: millimetres of motion
    do that to echoes that share a cell from above and below.
    """
    blocks = [_blocks(grain.relative - 1.0) for grain in (first, second)]
    seen = np.minimum(
        *(_blocks(g.looked_at.astype(np.float32)).mean(axis=(1, 2)) for g in (first, second))
    )
    spread = np.minimum(*(block.std(axis=(1, 2)) for block in blocks))
    good = (seen > MIN_SEEN) & (spread > GRAINED)
    moved = [_moved(a, b) for a, b in zip(blocks[0][good], blocks[1][good], strict=True)]
    found = [cells for cells in moved if cells is not None]
    return float(np.quantile(found, FAR_QUANTILE)) if found else None


def _blocks(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Cut into squares, what is left over is left out, (N, BLOCK, BLOCK)."""
    rows, beams = (n // BLOCK for n in picture.shape)
    cut = picture[: rows * BLOCK, : beams * BLOCK].reshape(rows, BLOCK, beams, BLOCK)
    return cut.swapaxes(1, 2).reshape(-1, BLOCK, BLOCK)


def _moved(first: NDArray[np.float32], second: NDArray[np.float32]) -> float | None:
    a, b = first - first.mean(), second - second.mean()
    size = (2 * BLOCK, 2 * BLOCK)
    spectrum = np.conj(np.fft.rfft2(a, size)) * np.fft.rfft2(b, size)
    correlation = np.fft.irfft2(spectrum, size) / np.sqrt(np.sum(a**2) * np.sum(b**2))
    shifts = np.arange(-REACH, REACH + 1)
    near = correlation[np.ix_(shifts, shifts)]
    row, beam = np.unravel_index(int(np.argmax(near)), near.shape)
    if near[row, beam] < FOUND or not (0 < row < 2 * REACH and 0 < beam < 2 * REACH):
        return None
    off_row = row - REACH + _vertex(near[row - 1 : row + 2, beam])
    off_beam = beam - REACH + _vertex(near[row, beam - 1 : beam + 2])
    return max(abs(float(off_row)), abs(float(off_beam)))


def _vertex(three: NDArray[np.floating]) -> float:
    """Place of a peak from the middle one of three values.

    A broad peak is a parabola. A narrow one is no wider than a cell: its centre of weight is taken.
    """
    left, middle, right = (max(float(value), 0.0) for value in three)
    if left + right < middle * BROAD:
        return (right - left) / (left + middle + right)
    bend = left - 2.0 * middle + right
    return 0.5 * (left - right) / bend if bend < 0.0 else 0.0
