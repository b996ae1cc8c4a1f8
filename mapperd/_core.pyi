"""The C++ map core. Arrays are C-contiguous; every call over a millisecond releases the GIL."""

from collections.abc import Callable
from typing import TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

BLOCK_EDGE: int
"""Voxels along one edge of a block."""

LOG_ODDS_UNIT: float
"""Log-odds in files and in `VoxelMap.blocks` are whole units of this, 2**-24."""

MAP_FILE_MAGIC: bytes
"""How the bytes of `VoxelMap.encode_map` begin."""

BRICK_VOXELS: int
"""Voxels along one edge of a brick, the unit of `VoxelMap.bricks_since`."""

def finished_parts() -> int:
    """Return how many parts of long work all threads have finished: it grows with progress."""

def finish_part() -> None:
    """Count a finished part of long work."""

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
        prior: float = 0.0,
    ) -> None: ...
    @property
    def prior(self) -> float:
        """Log-odds of an unobserved voxel, to which the map's evidence is added."""

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

class ArcParams:
    """The arc rule's constants: `cpp/map/include/mapperd/map/arc_integrator.hpp` defines them."""

    def __init__(
        self,
        *,
        half_aperture_rad: float = ...,
        beam_width_rad: float = ...,
        spread_below: float = 0.45,
        spread_above: float = 1.0,
        broad_share: float = 0.3,
        missed_share: float = 0.1,
        first_return: float = 0.45,
        quiet: float = 3.0,
        behind_scale: float = 0.6,
        min_step: float = 0.3,
        max_step: float = 6.0,
    ) -> None: ...
    @property
    def free_step(self) -> float:
        """Log-odds by which silence lowers a voxel: -L_free of the map's `IwloParams`."""

class ArcModel:
    """Tables of the arc rule, for maps with the same `IwloParams`.

    Raises:
        ValueError: a parameter is out of range; the text names it.
    """

    def __init__(self, params: ArcParams, rule: IwloParams) -> None: ...

class ArcChanges:
    """What the echoes of a ping changed in a map.

    Args:
        counts: (C,) uint32, number of the steps by part of the fan.
        steps: (N,) int16, of each voxel on an arc with an echo, in units of the map.
    """

    @overload
    def __init__(self) -> None: ...
    @overload
    def __init__(self, counts: NDArray[np.uint32], steps: NDArray[np.int16]) -> None: ...
    @property
    def counts(self) -> NDArray[np.uint32]: ...
    @property
    def steps(self) -> NDArray[np.int16]: ...

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
    """What one ping changed, in voxels; nothing, of one that is made."""

    def __init__(self) -> None: ...

    occupied: int
    free: int
    blocks_visited: int
    blocks_created: int

class VoxelMap:
    """Hash of blocks of voxels: log-odds and observation counts.

    Log-odds are held in 16 bits, in whole units of 2**-11, or coarser ones where L_min or L_max is
    beyond 15.8.

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
    def memory_bytes(self) -> int:
        """All that the map allocates, within 5 % of the allocator's figure."""

    @property
    def held_voxels(self) -> int:
        """Voxels that are stored one by one: those of cells of 4**3 that are not all alike."""

    def set_intensity_threshold(self, intensity: float) -> None:
        """Set what counts as a return from now on; the voxels stay as they are.

        Raises:
            ValueError: not finite.
        """

    def integrate_arc(
        self,
        model: ArcModel,
        levels: NDArray[np.float32],
        noise: NDArray[np.float32],
        bearings_rad: NDArray[np.float64],
        range_resolution_m: float,
        map_T_sonar: NDArray[np.float64],  # noqa: N803 frames are named
        *,
        min_range_m: float = 0.5,
        carve_no_return: bool = False,
        threads: int = 1,
        motion: PingMotion = ...,
        changes: ArcChanges | None = None,
    ) -> PingStats:
        """Add one ping's evidence by the arc rule: the level of an echo shows its elevation.

        `model` is that of the map's own rule. `levels`, (rows, beams), are relative to the level of
        a surface on the beam's axis; so is `noise`, (rows,), its median level, above 0. `changes`
        receives what the echoes changed.

        Raises:
            ValueError, IndexError: as `integrate_evidence_grid`.
            RuntimeError: the map is limited to a part.
        """

    def refine_arc(
        self,
        model: ArcModel,
        levels: NDArray[np.float32],
        noise: NDArray[np.float32],
        bearings_rad: NDArray[np.float64],
        range_resolution_m: float,
        map_T_sonar: NDArray[np.float64],  # noqa: N803 frames are named
        *,
        changes: ArcChanges,
        min_range_m: float = 0.5,
        carve_no_return: bool = False,
        threads: int = 1,
        motion: PingMotion = ...,
    ) -> PingStats:
        """Integrate the echoes of a ping again that the map holds already.

        Each voxel on their arcs gets the step that follows from all other pings, the later ones
        too; `changes` is what the same arguments changed before, and receives the new changes.

        Raises:
            ValueError, IndexError: as `integrate_arc`, and for changes of another ping.
            RuntimeError: the map is limited to a part.
        """

    def integrate_evidence_grid(
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
        detail: float = 1.0,
        threads: int = 1,
        motion: PingMotion = ...,
    ) -> PingStats:
        """Integrate one ping: filter its image by the voxel's footprint, look each voxel up once.

        Args:
            intensity: (rows, beams), 0..255, row 0 nearest, column 0 the most negative bearing.
            bearings_rad: (beams,), strictly increasing, positive to starboard, within +-90 deg.
            range_resolution_m: thickness of a row; row k spans k..k+1 times this.
            map_T_sonar: (4, 4) rigid transform, sonar x forward, y port, z up.
            vertical_aperture_rad: full aperture.
            min_range_m: nothing is learnt nearer than this.
            carve_no_return: beams without a return free their whole length.
            aggregation: "occupied_first" or "mean".
            detail: fineness of the evidence grid, 0.25 to 8: rows every 0.3 / detail voxels,
                columns every 0.5 / detail voxels at most.
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
            keys (M, 3), log-odds less the prior in LOG_ODDS_UNIT, and counts, both
            (M, BLOCK_EDGE**3), x fastest.
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
            ValueError: not all of a map, or one of another resolution, prior, clamps or settled
                count; the text states what is wrong. The map is as before.
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
                By default 2^28, about 0.9 GB where no cell of 4^3 voxels is all alike.

        Raises:
            ValueError: no whole tree of this resolution, or over `max_voxels`; the text states what
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
            ValueError: another resolution, prior, clamp or settled count, or the map itself;
                nothing is changed.
        """

    def with_rule(self, iwlo: IwloParams) -> VoxelMap:
        """A copy under another rule: log-odds inside its clamps, counts up to its settled one."""

    @property
    def is_in_tiles(self) -> bool:
        """Whether `cut_into_tiles` was called: not all of the map need be here."""

    def blocks_of_ping(
        self,
        intensity: NDArray[np.float32],
        bearings_rad: NDArray[np.float64],
        range_resolution_m: float,
        map_T_sonar: NDArray[np.float64],  # noqa: N803 frames are named
        *,
        vertical_aperture_rad: float,
        min_range_m: float = ...,
        carve_no_return: bool = ...,
        motion: PingMotion = ...,
    ) -> tuple[Key, Key] | None:
        """A box of blocks, first and last, outside of which the ping changes nothing.

        None for a ping without evidence. Raises as `integrate_evidence_grid`, for the same pings.
        """

    def limit_to_tile(self, tile: Key, tile_bricks: int) -> None:
        """From now on pings change only voxels of a tile, and those as if there were no limit.

        Maps of tiles side by side are together the map of all, to the bit; their revisions too,
        where each counts a ping of the whole by `raise_revision`.

        Raises:
            ValueError: the tile lies beyond the map's reach.
        """

    def cut_into_tiles(self, tile_bricks: int, fetch: Callable[[list[Key]], None]) -> None:
        """From now on hold only tiles, cubes of bricks, that somebody put here.

        Args:
            tile_bricks: along an edge.
            fetch: receives the tiles that a ping is about to change, in ascending order, and
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

    def raise_revision(self, min_revision: int) -> None:
        """Make the map's revision at least this."""

    def clear(self) -> None: ...
    def changed_blocks(
        self, revision: int, bricks: NDArray[np.int32]
    ) -> tuple[int, int, NDArray[np.int32], NDArray[np.uint64], NDArray[np.bool_]]:
        """Blocks in memory that changed after a revision, all of one state of the map.

        Args:
            revision: of the map.
            bricks: (M, 3), that are asked about.

        Returns:
            the map's revision; the one at which all its blocks went or were replaced at once; the
            blocks' keys (N, 3), in no particular order, and revisions (N,); which of the bricks
            are in memory (M,).
        """

    def stream_digests(
        self, view: StreamView, keys: NDArray[np.int32]
    ) -> tuple[NDArray[np.uint64], NDArray[np.uint64], NDArray[np.bool_]]:
        """Digest of what a view sends of blocks of the map stream, one number a block.

        Args:
            view: how cells are encoded.
            keys: (N, 3).

        Returns:
            digests (N,), 0 where nothing is known; the map's revisions at which a voxel of the
            blocks changed last (N,); which of the blocks are in memory (N,).
        """

    def stream_blocks(
        self, view: StreamView, keys: NDArray[np.int32]
    ) -> tuple[int, NDArray[np.int8], NDArray[np.uint8], NDArray[np.bool_]]:
        """Blocks of the map stream (`mapperd.wire.blocks`), all of one state of the map.

        Returns:
            the map's revision; cells (N, 512) and the bits of their counts (N, 512), x fastest;
            which of the blocks are in memory (N,): the others read as unknown.
        """

class StreamView:
    """How the map stream encodes cells.

    Args:
        level: cells are cubes of 2**level voxels.
        detail: "classes", "log_odds" or "counts"; with the last, digests are of counts too.
        log_odds_step: of the quantised log-odds.
        occupied_log_odds, free_log_odds: of the classes.

    Raises:
        ValueError: there is no such detail; where it is used, for other bad values.
    """

    def __init__(
        self,
        level: int,
        detail: str,
        *,
        log_odds_step: float,
        occupied_log_odds: float,
        free_log_odds: float,
    ) -> None: ...

class KeyIndex:
    """Numbers keys in the order in which they come; a number stays with its key."""

    def __init__(self) -> None: ...
    def __len__(self) -> int: ...
    @property
    def memory_bytes(self) -> int: ...
    def numbers(self, keys: NDArray[np.int32], add: bool) -> NDArray[np.int64]:
        """The numbers (N,) of keys (N, 3); -1 for unknown ones unless they are to be added."""

    def keys(self, numbers: NDArray[np.int64]) -> NDArray[np.int32]:
        """The keys (N, 3) of numbers. Raises IndexError for a number that no key has."""

class MclGrid:
    """A flat occupancy grid.

    Args:
        occupancy: (rows, columns) int8: 0 free, 100 occupied, anything else unknown.
        resolution_m: edge of a cell.
        origin: (3,) pose of the outer corner of cell (0, 0) in the map frame: m, m, rad.

    Raises:
        ValueError: no cells, more than 32000 along a side, or not finite.
    """

    def __init__(
        self, occupancy: NDArray[np.int8], resolution_m: float, origin: NDArray[np.float64]
    ) -> None: ...

class MclFreeSpace:
    """The free cells of a grid, to start from anywhere and to draw random particles from.

    Raises:
        ValueError: no cell is free.
    """

    def __init__(self, grid: MclGrid) -> None: ...
    def __len__(self) -> int: ...

class MclHitModel:
    """p(d) of the distance to the nearest obstacle.

    z_hit / (sigma_hit sqrt(2 pi)) exp(-d^2 / (2 sigma_hit^2)) + z_rand / max_range, a density in
    1/m; d counts up to max_distance_m.

    Raises:
        ValueError: out of range, or nothing is left of p.
    """

    def __init__(
        self,
        *,
        z_hit: float,
        z_rand: float,
        sigma_hit_m: float,
        max_range_m: float,
        max_distance_m: float,
    ) -> None: ...
    def density(self, distance_m: float) -> float: ...

class MclBeamModel:
    """The mixture of hits, short, random and largest readings about an expected range.

    Raises:
        ValueError: out of range, or all weights 0.
    """

    def __init__(
        self,
        *,
        z_hit: float,
        z_short: float,
        z_max: float,
        z_rand: float,
        sigma_hit_m: float,
        lambda_short_per_m: float,
        max_range_m: float,
    ) -> None: ...
    def density(
        self, range_m: NDArray[np.float64] | float, expected_m: NDArray[np.float64] | float
    ) -> NDArray[np.float64]:
        """P of each reading, in 1/m."""

class MclField:
    """Likelihoods of the places of the map, in one layer or, of a 3D map, in many."""

    @staticmethod
    def of_grid(
        grid: MclGrid,
        model: MclHitModel,
        only_boundaries: bool = False,
        unknown: str = "as_free",
        threads: int = 1,
    ) -> MclField:
        """Make a field from a grid by the exact distance transform.

        Args:
            grid: the map.
            model: p of the distance.
            only_boundaries: only occupied cells with a free one at a side are obstacles.
            unknown: `as_free`, `background` (p at max_distance_m) or `uniform` (1 / max_range).
            threads: change no value.
        """

    @staticmethod
    def of_values(
        values: NDArray[np.float32],
        resolution_m: float,
        origin: NDArray[np.float64],
        outside: float,
    ) -> MclField:
        """Make a field of (rows, columns) values; places off the map have the value `outside`."""

    @staticmethod
    def of_distances(
        distances_m: NDArray[np.float32],
        first_centre_m: NDArray[np.float64],
        resolution_m: float,
        model: MclHitModel,
    ) -> MclField:
        """Make a field of what `VoxelMap.distance_field` returns.

        Args:
            distances_m: (x, y, z).
            first_centre_m: centre of the first cell, (3,).
            resolution_m: edge of a cell.
            model: p of the distance.
        """

    def values(self, layer: int = 0) -> NDArray[np.float32]:
        """Return the values of a layer, (rows, columns)."""

    @property
    def layers(self) -> int: ...
    @property
    def background(self) -> float:
        """P where nothing is known: off the map, and far from all obstacles."""

    @property
    def memory_bytes(self) -> int: ...

class MclRangeMap:
    """Ranges to expect, exact to 1e-9 cells."""

    def __init__(
        self,
        grid: MclGrid,
        unknown_blocks: bool = False,
        threads: int = 1,
    ) -> None: ...
    def cast(self, rays: NDArray[np.float64], max_range_m: float) -> NDArray[np.float64]:
        """Range of each of (N, 3) poses along its heading.

        max_range_m where nothing is hit, -1 where the ray leaves the map before or begins off it.
        """

class MclEndpoints:
    """Ends of beams in the levelled base frame.

    Args:
        points_m: (beams, elevations, 2), or 3 with the height in the map frame. Of the elevations
            the likeliest counts.
        quality: (beams,) 0 ... 1; p becomes quality p + (1 - quality) background.

    Raises:
        ValueError: shapes do not fit, or not finite.
    """

    def __init__(self, points_m: NDArray[np.float64], quality: NDArray[np.float64]) -> None: ...
    def __len__(self) -> int: ...

class MclBeams:
    """Beams as the sensor has them.

    Args:
        bearing_rad: (beams,) in the base frame, counter-clockwise.
        range_m: (beams,) from the sensor; the model's max_range_m and more: nothing came back.
        quality: (beams,) as of `MclEndpoints`.
        sensor_x_m: of the sensor in the base frame.
        sensor_y_m: as well.
    """

    def __init__(
        self,
        *,
        bearing_rad: NDArray[np.float64],
        range_m: NDArray[np.float64],
        quality: NDArray[np.float64],
        sensor_x_m: float = 0.0,
        sensor_y_m: float = 0.0,
    ) -> None: ...
    def __len__(self) -> int: ...

class MclRule:
    """How the filter resamples and recovers.

    Args:
        min_particles: 1 or more.
        max_particles: at every start, and at most.
        kld_error: above 0, up to 1.
        kld_quantile: the standard normal quantile itself, 0 ... 40.
        bucket_x_m: edges of the KLD rule's buckets, at least 0.001.
        bucket_y_m: as well.
        bucket_yaw_rad: as well.
        resampling: `low_variance` or `multinomial`.
        alpha_slow: gains of the recovery's averages, 0 <= slow <= fast <= 1; both 0: no recovery.
        alpha_fast: as well.
        resample_interval: in updates.
        selective: only below an effective size of half the particles.
        max_step_m: longer steps of odometry are refused.
        least_effective_share: likelihoods are raised to a power below 1 where else less of the
            effective size was left, 0 ... 1 without 1; 0 never.
        draw_exponent: draws go by weights to this power, children keep the rest; 1 as in AMCL.

    Raises:
        ValueError: out of range.
    """

    def __init__(
        self,
        *,
        min_particles: int,
        max_particles: int,
        kld_error: float,
        kld_quantile: float,
        bucket_x_m: float,
        bucket_y_m: float,
        bucket_yaw_rad: float,
        resampling: str = "low_variance",
        alpha_slow: float = 0.0,
        alpha_fast: float = 0.0,
        resample_interval: int = 1,
        selective: bool = False,
        max_step_m: float = 1e6,
        least_effective_share: float = 0.0,
        draw_exponent: float = 1.0,
    ) -> None: ...

class MclEstimate:
    """Where the particles are."""

    @property
    def mean(self) -> NDArray[np.float64]:
        """(3,): m, m, rad."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(3, 3), with cross terms; the heading's variance is infinite where headings cancel."""

    @property
    def mass(self) -> float:
        """Weight of the particles counted."""

    @property
    def particles(self) -> int: ...
    @property
    def heading_known(self) -> bool:
        """False where headings cancel out."""

    @property
    def spread_known(self) -> bool:
        """False where one particle carries all weight; variances are then the floor, 1e-12."""

class MclWeighed:
    """What a scan did to the weights."""

    @property
    def informative(self) -> bool:
        """False: an empty scan, or no particle explains it; weights stay."""

    @property
    def log_evidence(self) -> float:
        """Ln of the mean likelihood, weighted."""

    @property
    def fit(self) -> float:
        """Mean likelihood of one beam, whatever the number of particles and beams."""

    @property
    def injected_share(self) -> float:
        """Share of random particles in the next resampling, 0 ... 1."""

    @property
    def exponent(self) -> float:
        """That the likelihoods were raised to, 1 where they were taken as they came."""

class MclRecovery:
    """Two averages of the fit; where the fast one falls below the slow one, particles are drawn."""

    def __init__(self, alpha_slow: float, alpha_fast: float) -> None: ...
    def add(self, fit: float) -> None: ...
    def reset(self) -> None: ...
    @property
    def injected_share(self) -> float: ...

MclState: TypeAlias = tuple[
    NDArray[np.float64], NDArray[np.float64], tuple[int, ...], tuple[float, float, bool]
]

class MclFilter:
    """The particle filter: (x, y, yaw) in the map frame. Not to be used from two threads at once.

    Args:
        rule: how it resamples.
        seed: of all draws; one seed is one run, whatever the number of threads.
        threads: that share the work.
    """

    def __init__(self, rule: MclRule, seed: int, threads: int = 1) -> None: ...
    def set_rule(self, rule: MclRule) -> None:
        """Keeps the particles; their number changes at the next resampling."""

    def set_threads(self, threads: int) -> None: ...
    def start_about(self, mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Draw all particles about a pose (3,) with covariance (3, 3).

        Raises:
            ValueError: not finite, not symmetric, not positive semi-definite; nothing is changed.
        """

    def start_anywhere(self, free: MclFreeSpace) -> None: ...
    def start_by_scan(
        self,
        free: MclFreeSpace,
        field: MclField,
        ends: MclEndpoints,
        poses: int,
        kappa: float = 1.0,
    ) -> None:
        """Draw max_particles by a scan's likelihood, of many poses anywhere.

        Args:
            free: where a vehicle can be.
            field: broader than the poses lie apart.
            ends: the scan.
            poses: to weigh, as many as max_particles at least.
            kappa: tempering; less where few poses would carry the weight.

        Raises:
            ValueError: out of range.
        """

    def start_with(
        self, poses: NDArray[np.float64], weights: NDArray[np.float64] | None = None
    ) -> None:
        """Take (N, 3) poses, with weights of any sum.

        Raises:
            ValueError: not finite, or no weight.
        """

    def state(self) -> MclState:
        """All that a filter of the same rule needs to continue as this one would.

        (N, 3) poses, (N,) logarithms of the weights, whole numbers, averages.
        """

    def restore(
        self,
        poses: NDArray[np.float64],
        log_weights: NDArray[np.float64],
        numbers: tuple[int, ...],
        averages: tuple[float, float, bool],
    ) -> None:
        """Take what `state` gave.

        Raises:
            ValueError: it is no filter's; nothing is changed.
        """

    def predict(
        self,
        before: NDArray[np.float64],
        now: NDArray[np.float64],
        model: str,
        alphas: NDArray[np.float64],
        floor_xy_m: float = 0.0,
        floor_yaw_rad: float = 0.0,
    ) -> bool:
        """Move the particles by the step between two odometry poses (3,).

        Args:
            before: at the last update.
            now: at this one.
            model: `differential_drive`, `omnidirectional_drive` or `stationary`.
            alphas: (5,) variances of noise by motion squared.
            floor_xy_m: sigma of noise that comes with time, of this step.
            floor_yaw_rad: as well.

        Returns:
            False where the step is refused (not finite, too long): nothing moved, keep `before`.
        """

    def weigh_field(
        self,
        field: MclField,
        ends: MclEndpoints,
        aggregation: str = "cube_sum",
        kappa: float = 1.0,
    ) -> MclWeighed:
        """`cube_sum`: 1 + sum p^3; `product`: exp(kappa sum ln p), 0 < kappa <= 1."""

    def weigh_beams(
        self,
        map: MclRangeMap,  # noqa: A002 what it is
        beams: MclBeams,
        model: MclBeamModel,
        aggregation: str = "cube_sum",
        kappa: float = 1.0,
    ) -> MclWeighed:
        """`cube_sum`: sum p^3; `product`: exp(kappa sum ln p), 0 < kappa <= 1."""

    def weigh(
        self,
        log_likelihood: NDArray[np.float64],
        beams: int,
        kind: str = "product",
        kappa: float = 1.0,
    ) -> MclWeighed:
        """Log-likelihoods (N,) from elsewhere; NaN and +infinity count as likelihood 0.

        `kind` is the meaning of `fit`: `cube_sum_from_one`, `cube_sum` or `product`.
        """

    def resample_if_due(self, free: MclFreeSpace | None = None) -> bool:
        """Resample when interval and size require it; random particles come from `free`."""

    def resample(self, free: MclFreeSpace | None = None) -> None: ...
    def effective_size(self) -> float: ...
    def estimate(self) -> MclEstimate:
        """Return the estimate of all particles."""

    def modes(
        self, bucket_xy_m: float = 0.2, bucket_yaw_rad: float = 0.524
    ) -> tuple[MclEstimate, NDArray[np.float64], NDArray[np.int64]]:
        """Return clusters of particles.

        Returns:
            the heaviest cluster's estimate, the masses of all clusters, falling, and the cluster of
            each particle.
        """

    def __len__(self) -> int: ...
    @property
    def poses(self) -> NDArray[np.float64]:
        """Poses of the particles, (N, 3), a copy."""

    @property
    def weights(self) -> NDArray[np.float64]:
        """Weights of the particles, (N,); their sum is 1."""

    @property
    def log_weights(self) -> NDArray[np.float64]: ...
    @property
    def counts(self) -> dict[str, int]:
        """Number of updates, refusals and workarounds by kind."""

def mcl_estimate(poses: NDArray[np.float64], weights: NDArray[np.float64]) -> MclEstimate:
    """Return the estimate of (N, 3) poses with weights of any sum."""

def mcl_square_root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """S with S S^T = covariance (3, 3).

    Raises:
        ValueError: not finite, asymmetric beyond 1e-9, an eigenvalue below -1e-9 of the largest.
    """

def mcl_squared_distances(
    marked: NDArray[np.bool_], limit: int, threads: int = 1
) -> NDArray[np.int32]:
    """Squared distance in cells to the nearest marked one; 2**31 - 1 beyond `limit` cells."""

def mcl_kld_size(buckets: int, error: float, quantile: float) -> int:
    """Particles wanted for so many buckets; the largest 64-bit number for up to two."""

class Submap:
    """Observed voxels of a part of a dive, for registration in x, y and yaw.

    Its frame is levelled: z is vertical. `weights` (N,) of the occupied voxels, such as their
    log-odds, say how much each counts in the distributions that `register_submaps` matches; without
    them all count alike. Raises ValueError without occupied voxels, for centres that are not
    finite, for weights that are not positive, or where their box has over 2**27 voxels.
    """

    def __init__(
        self,
        occupied_m: NDArray[np.float64],
        free_m: NDArray[np.float64],
        resolution_m: float,
        weights: NDArray[np.float64] | None = None,
    ) -> None: ...
    @property
    def occupied(self) -> int: ...

class Registration:
    """Result of `register_submaps`; `pose` is target_T_source, (3,) x, y (m) and yaw (rad).

    `information` (3, 3) is the inverse of its covariance, `curvature` (3, 3) the cost's Hessian.
    `score` and `matched` are those of `compare_submaps` with 0.2 m and 2500 points.
    """

    @property
    def pose(self) -> NDArray[np.float64]: ...
    @property
    def information(self) -> NDArray[np.float64]: ...
    @property
    def curvature(self) -> NDArray[np.float64]: ...
    @property
    def score(self) -> float: ...
    @property
    def matched(self) -> float: ...
    @property
    def converged(self) -> bool: ...

def search_poses(
    target: Submap,
    source: Submap,
    centre: NDArray[np.float64],
    *,
    half_x_m: float,
    half_y_m: float,
    half_yaw_rad: float,
    step_m: float,
    step_yaw_rad: float,
    count: int,
) -> list[tuple[NDArray[np.float64], float, float, float]]:
    """Find the best places in a window: pose target_T_source, score, matched, contradicted.

    Raises ValueError for a window that is not finite or has over a million poses.
    """

def compare_submaps(
    target: Submap, source: Submap, pose: NDArray[np.float64], *, scale_m: float, points: int
) -> tuple[NDArray[np.float64], float, float, float]:
    """Return pose, score 0..1, and the shares of points matched and contradicted."""

def register_submaps(target: Submap, source: Submap, start: NDArray[np.float64]) -> Registration:
    """Refine target_T_source from a start, by distances and then by distributions."""
