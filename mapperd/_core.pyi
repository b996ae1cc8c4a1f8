"""The C++ map core. Arrays are C-contiguous; every call over a millisecond releases the GIL."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

BLOCK_EDGE: int
"""Voxels along one edge of a block."""

LOG_ODDS_UNIT: float
"""Log-odds are held in whole units of this, 2**-24."""

MAP_FILE_MAGIC: bytes
"""How the bytes of `VoxelMap.encode_map` begin."""

BRICK_VOXELS: int
"""Voxels along one edge of a brick, the unit of `VoxelMap.bricks_since`."""

Key: TypeAlias = tuple[int, int, int]

class IwloParams:
    """The IWLO rule's constants (`iwlo.*`, `adaptive.*`, `filtering.*`).

    Raises:
        ValueError: a value is not finite, out of range, needs more than 65535 pings to settle, or
            adaptive_min_ratio is above adaptive_max_ratio.
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
        adaptive_min_ratio: float = 0.25,
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

class PingMotion:
    """How the sonar moves while its ping is in the water.

    Args:
        linear_mps: (3,), of the sonar, map frame.
        angular_radps: (3,), sonar frame.
        valid_s: after transmission, when map_T_sonar holds.
        speed_of_sound_mps: turns ranges into times.

    What cannot be is refused when it is integrated.
    """

    def __init__(
        self,
        *,
        linear_mps: NDArray[np.float64],
        angular_radps: NDArray[np.float64],
        valid_s: float,
        speed_of_sound_mps: float,
    ) -> None: ...

class PingStats:
    """What one ping changed, in voxels."""

    occupied: int
    free: int
    blocks_visited: int
    blocks_created: int

class VoxelMap:
    """Hash of blocks of voxels: log-odds (whole units of 2**-24) and observation counts.

    Any number of threads may read while one writes: each call sees, or makes, one whole state of
    the map, and waits for its turn without the GIL.

    Raises:
        ValueError: `resolution_m` is not finite and positive.
    """

    def __init__(self, resolution_m: float, iwlo: IwloParams) -> None: ...
    @property
    def resolution_m(self) -> float: ...
    @property
    def revision(self) -> int:
        """Counts up with every change of the map."""

    @property
    def block_count(self) -> int: ...
    @property
    def memory_bytes(self) -> int: ...
    def set_intensity_threshold(self, intensity: float) -> None:
        """Set what counts as a return from now on; the voxels stay as they are.

        Raises:
            ValueError: not finite.
        """

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
        error_bound: float = 0.0,
        threads: int = 1,
        motion: PingMotion = ...,
    ) -> PingStats:
        """Integrate one ping: each voxel is projected into the ping once.

        Args:
            intensity: (rows, beams), 0..255, row 0 nearest, column 0 the most negative bearing.
            bearings_rad: (beams,), strictly increasing, positive to starboard, within +-90 deg.
            range_resolution_m: thickness of a row; row k spans k..k+1 times this.
            map_T_sonar: (4, 4) rigid transform, sonar x forward, y port, z up.
            vertical_aperture_rad: full aperture.
            min_range_m: nothing is learnt nearer than this.
            carve_no_return: beams without a return free their whole length.
            aggregation: "occupied_first" or "mean".
            error_bound: log-odds that this ping's step may be off by, in 99 of 100 voxels; 0 for
                the exact integral.
            threads: 1 to 64; the map does not depend on it.
            motion: of the sonar; without any, the ping's bits are those of a sonar at rest.

        Raises:
            ValueError: an argument has the wrong shape or is not finite, the pose is no rigid
                transform, or the motion is faster than a fiftieth of sound or turns the sonar by
                more than a radian before the last row is back.
            IndexError: the ping would leave the map's reach.
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
        motion: PingMotion = ...,
    ) -> PingStats:
        """Integrate one ping by sampled sub-rays; arguments as above."""

    def voxels(
        self, min_log_odds: float = ..., max_log_odds: float = ...
    ) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.uint16]]:
        """Known voxels with min_log_odds < L < max_log_odds, in a fixed order.

        Returns:
            centres (N, 3) in metres in the map frame, log-odds (N,), observation counts (N,).
        """

    def blocks(
        self, begin: int = 0, count: int = ...
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.uint16]]:
        """A slice of the blocks, sorted by key.

        Returns:
            keys (M, 3), log-odds in LOG_ODDS_UNIT and counts, both (M, BLOCK_EDGE**3), x fastest.
        """

    def visit_blocks(
        self,
        visit: Callable[[NDArray[np.int32], NDArray[np.int32], NDArray[np.uint16]], None],
        at_once: int,
    ) -> None:
        """Call `visit` with all blocks in turn, as `blocks` gives them, `at_once` at a time.

        All are of one state: nobody writes to the map meanwhile, and `visit` must not use it.
        """

    def class_counts(self, occupied_log_odds: float, free_log_odds: float) -> tuple[int, int, int]:
        """Observed voxels above the one, below the other, and the rest.

        Raises:
            ValueError: free_log_odds above occupied_log_odds.
        """

    def query(
        self, points_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
        """Log-odds and counts (N,) at points (N, 3); unknown is (0, 0)."""

    def encode_map(self) -> bytes:
        """All of the map, without loss. Equal maps give equal bytes, however they came about."""

    def load_map(self, data: bytes) -> None:
        """Make the map's content that of `encode_map`'s bytes.

        Raises:
            ValueError: not all of a map, or one of another resolution, clamps or settled count;
                the text says what is wrong. The map is as before.
        """

    def octomap_bt(self, occupied_log_odds: float, free_log_odds: float) -> bytes:
        """The map as an OctoMap binary tree: occupied above, free below, the rest unknown.

        Raises:
            ValueError: the limits are out of order.
            IndexError: a voxel lies outside OctoMap's 16-bit reach.
        """

    def octomap_ot(self) -> bytes:
        """The map as a full OctoMap tree: the log-odds of every known voxel, without counts.

        Raises:
            IndexError: a voxel lies outside OctoMap's 16-bit reach.
        """

    def load_octomap(self, data: bytes, *, max_voxels: int = ...) -> None:
        """Make the map's content that of a `.bt` or `.ot` file.

        Every count becomes 1. Log-odds are clamped to L_min and L_max; those of a `.bt` are
        OctoMap's own, -2 for free and 3.5 for occupied, within L_min and L_max.

        Args:
            data: the whole file.
            max_voxels: limit of memory: all voxels of each cube of 16^3 that the tree touches.
                By default 2^28, about 1.6 GB.

        Raises:
            ValueError: no whole tree of this resolution, or over `max_voxels`; the text says what
                and at which byte. The map is as before.
        """

    def known_count(self) -> int:
        """Voxels that were ever observed."""

    def classify(
        self, points_m: NDArray[np.float64], occupied_log_odds: float, free_log_odds: float
    ) -> NDArray[np.int8]:
        """1 occupied (above), 0 free (below), -1 unknown, at points (N, 3).

        Raises:
            ValueError: points that are not finite; free_log_odds above occupied_log_odds.
        """

    def classify_box(
        self,
        low_m: NDArray[np.float64],
        high_m: NDArray[np.float64],
        occupied_log_odds: float,
        free_log_odds: float,
    ) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """The same for all voxels whose centres lie in low <= centre < high.

        Returns:
            (nx, ny, nz), and the centre (3,) of the first voxel.

        Raises:
            ValueError: corners not finite or not in order; over 2**27 voxels.
        """

    def ray_cast_depth(
        self,
        origins_m: NDArray[np.float64],
        directions: NDArray[np.float64],
        max_range_m: float,
        occupied_log_odds: float,
    ) -> NDArray[np.float64]:
        """Distances (N,) to where rays enter the first occupied voxel; -1 where they meet none.

        Raises:
            ValueError: not finite, a direction of length 0, a range over a million voxels.
        """

    def distance_field(
        self,
        low_m: NDArray[np.float64],
        high_m: NDArray[np.float64],
        max_distance_m: float,
        occupied_log_odds: float,
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Distances between voxel centres, to the nearest occupied voxel, truncated.

        Returns:
            (nx, ny, nz) in metres, and the centre (3,) of the first voxel.

        Raises:
            ValueError: bad corners, max_distance_m not above 0 or over 255 voxels, over 2**27
                voxels in the box with max_distance_m around it.
        """

    def distance_slice(
        self,
        low_m: NDArray[np.float64],
        high_m: NDArray[np.float64],
        z_m: float,
        max_distance_m: float,
        occupied_log_odds: float,
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """The layer that holds z_m, (nx, ny, 1); corners (2,)."""

    def occupied_in(
        self, low_m: NDArray[np.float64], high_m: NDArray[np.float64], occupied_log_odds: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.uint16]]:
        """Occupied voxels of a box: centres (N, 3), log-odds (N,), counts (N,)."""

    def observe(
        self,
        points_m: NDArray[np.float64],
        intensities: NDArray[np.float64],
        occupied: NDArray[np.bool_],
        weights: NDArray[np.float64] | None = None,
    ) -> None:
        """One IWLO observation a point, in their order; weights (N,) multiply the steps.

        Raises:
            ValueError: wrong shapes, not finite, negative, beyond the reach; nothing is changed.
        """

    def add_log_odds(
        self,
        points_m: NDArray[np.float64],
        steps: NDArray[np.float64],
        *,
        low: float,
        high: float,
    ) -> None:
        """Add steps (N,); they stop at low and high. Raises as `observe`."""

    def set_log_odds(self, points_m: NDArray[np.float64], log_odds: NDArray[np.float64]) -> None:
        """Set values (N,), inside the map's clamps. Raises as `observe`."""

    def add_ray(
        self,
        origin_m: NDArray[np.float64],
        end_m: NDArray[np.float64],
        *,
        hit: float,
        miss: float,
        low: float,
        high: float,
    ) -> None:
        """Step `miss` in the voxels of a segment, `hit` in its last. Raises as `observe`."""

    def merge(self, *others: VoxelMap) -> None:
        """Add the evidence of other maps: log-odds summed, then clamped; counts summed, saturated.

        Neither the order of the others, nor which of all the maps takes them, changes the result.

        Raises:
            ValueError: another resolution, clamp or settled count, or the map itself; nothing is
                changed.
        """

    def with_rule(self, iwlo: IwloParams) -> VoxelMap:
        """A copy under another rule: log-odds inside its clamps, counts up to its settled one."""

    @property
    def is_in_tiles(self) -> bool:
        """Whether `cut_into_tiles` was called: not all of the map need be here."""

    def cut_into_tiles(self, tile_bricks: int, fetch: Callable[[list[Key]], None]) -> None:
        """From now on hold only tiles, cubes of bricks, that somebody put here.

        Args:
            tile_bricks: along an edge.
            fetch: is told the tiles that a ping is about to change, in ascending order, and
                returns when they are here; what it raises refuses the ping, which leaves the map
                as it was. No lock of the map is held meanwhile.

        What is not here reads as unknown. Raises RuntimeError for a map that has content.
        """

    def bricks_since(self, revision: int) -> tuple[int, list[tuple[Key, int, bytes]]]:
        """Bricks that changed after a revision, all of one state of the map.

        Returns:
            the map's revision; (key, revision, bytes) a brick. A brick's key is its first voxel's
            index divided by `BRICK_VOXELS`.
        """

    def put_bricks(self, bricks: list[tuple[Key, bytes]], tiles: list[Key] = ...) -> None:
        """Replace the content of bricks, and count tiles as being here.

        Raises:
            ValueError: bytes that are no brick of such a map; the map is as before.
            RuntimeError: a brick in a tile that is not here; the map is as before.
        """

    def drop_tiles(self, tiles: list[Key]) -> None:
        """Forget tiles, whatever they hold."""

    def raise_revision(self, least: int) -> None:
        """Make the map's revision at least this."""

    def clear(self) -> None: ...
