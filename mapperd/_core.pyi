"""The C++ map core. Arrays are C-contiguous; every call over a millisecond releases the GIL."""

import numpy as np
from numpy.typing import NDArray

BLOCK_EDGE: int
"""Voxels along one edge of a block (8)."""

class IwloParams:
    """The IWLO rule's constants (`iwlo.*`, `adaptive.*`, `filtering.*`).

    Raises:
        ValueError: a value is not finite, out of range, or needs more than 65535 pings to settle.
    """

    def __init__(
        self,
        *,
        L_occ: float = 3.5,  # noqa: N803 the rule's names
        L_free: float = -3.0,  # noqa: N803
        L_min: float = -10.0,  # noqa: N803
        L_max: float = 10.0,  # noqa: N803
        sharpness: float = 3.0,
        decay_rate: float = 0.1,
        min_alpha: float = 0.1,
        intensity_threshold: float = 35.0,
        intensity_max: float = 255.0,
        adaptive_update: bool = True,
        adaptive_threshold: float = 0.5,
        adaptive_max_ratio: float = 0.3,
        protect_occupied: bool = True,
    ) -> None: ...
    def occupied_weight(self, intensity: float) -> float:
        """w(I): 0 at or below the threshold, else the sigmoid of the normalised intensity."""

    def update(
        self,
        log_odds: float,
        count: int,
        *,
        occupied: bool,
        weight: float = 1.0,
        factor: float = 1.0,
    ) -> tuple[float, int]:
        """One voxel's state after one ping; `weight` is w(I), `factor` multiplies the step."""

class PingStats:
    """What one ping changed, in voxels."""

    occupied: int
    free: int
    blocks_visited: int
    blocks_created: int

class VoxelMap:
    """Hash of 8x8x8 blocks of voxels: log-odds (float32) and observation count (uint16).

    Raises:
        ValueError: `resolution_m` is not finite and positive.
    """

    def __init__(self, resolution_m: float, iwlo: IwloParams) -> None: ...
    @property
    def resolution_m(self) -> float: ...
    @property
    def block_count(self) -> int: ...
    @property
    def memory_bytes(self) -> int: ...
    def integrate_projective(
        self,
        intensity: NDArray[np.float32],
        bearings_rad: NDArray[np.float64],
        range_resolution_m: float,
        map_T_sonar: NDArray[np.float64],  # noqa: N803 frames are named
        *,
        vertical_aperture_rad: float,
        min_range_m: float = 0.5,
        carve_no_return: bool = False,
        aggregation: str = "occupied_first",
    ) -> PingStats:
        """Integrate one ping, exactly: each voxel is projected into the ping once.

        Args:
            intensity: (rows, beams), 0..255, row 0 nearest, column 0 the most negative bearing.
            bearings_rad: (beams,), strictly increasing, positive to starboard, within +-90 deg.
            range_resolution_m: thickness of a row; row k spans k..k+1 times this.
            map_T_sonar: (4, 4) rigid transform, sonar x forward, y port, z up.
            vertical_aperture_rad: full aperture.
            min_range_m: nothing is learnt nearer than this.
            carve_no_return: beams without a return free their whole length.
            aggregation: "occupied_first" or "mean".

        Raises:
            ValueError: an argument has the wrong shape, is not finite, or the pose would leave
                the map's reach.
        """

    def integrate_rays(
        self,
        intensity: NDArray[np.float32],
        bearings_rad: NDArray[np.float64],
        range_resolution_m: float,
        map_T_sonar: NDArray[np.float64],  # noqa: N803
        *,
        vertical_aperture_rad: float,
        min_range_m: float = 0.5,
        angular_cone_width: float = 0.5,
    ) -> PingStats:
        """Integrate one ping by sampled sub-rays; arguments as above."""

    def voxels(
        self, min_log_odds: float = ..., max_log_odds: float = ...
    ) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.uint16]]:
        """Known voxels with min_log_odds < L < max_log_odds, in a fixed order.

        Returns:
            centres (N, 3) in metres in the map frame, log-odds (N,), observation counts (N,).
        """

    def blocks(self) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.uint16]]:
        """All blocks, sorted by key: keys (M, 3), log-odds and counts (M, 512), x fastest."""

    def query(
        self, points_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
        """Log-odds and counts (N,) at points (N, 3); unknown is (0, 0)."""

    def octomap_bt(self, occupied_log_odds: float, free_log_odds: float) -> bytes:
        """The map as an OctoMap binary tree: occupied above, free below, the rest unknown.

        Raises:
            ValueError: a voxel lies outside OctoMap's 16-bit reach.
        """

    def clear(self) -> None: ...
