"""The simulator's kernels, in C++; they run without the interpreter's lock.

Rows are ranges, nearest first. A field is complex64, a power float32. How many threads work never
changes a byte of what comes out. Arrays of wrong shape raise ValueError.
"""

from typing import Literal, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

_Real = TypeVar("_Real", np.float32, np.float64)
_Number = TypeVar("_Number", np.float32, np.float64, np.int32)

def complex_gaussian(key: int, count: int) -> NDArray[np.complex64]:
    """Circular complex Gaussian numbers of mean power 1, (count,), of a 64-bit key's stream."""

def add_gaussian(
    field: NDArray[np.complex64],
    row_rms: NDArray[np.float32],
    column_rms: NDArray[np.float32],
    key: int,
    threads: int = 2,
    extra_power: NDArray[np.float32] | None = None,
) -> None:
    """Add to each cell a complex Gaussian number of its own, in place.

    Args:
        field: (rows, columns), C-contiguous.
        row_rms: rms amplitude, (rows,).
        column_rms: factor to it, (columns,).
        key: 64 bits that choose the numbers.
        threads: that share the rows.
        extra_power: added to the mean power, (rows, columns) or (rows, 1), at least 0.
    """

def add_gaussian_power(
    field: NDArray[np.complex64],
    power: NDArray[np.float32],
    key: int,
    threads: int = 2,
    first: float = 0.0,
    step: float = 1.0,
) -> None:
    """Add to each cell a complex Gaussian number of a mean power of its own, in place.

    Args:
        field: (rows, columns), C-contiguous.
        power: (rows, M), at the columns first + step * m; linear between them, constant beyond.
        key: 64 bits that choose the numbers.
        threads: that share the rows.
        first: column of the first power.
        step: columns between powers.
    """

def spread_over_rows(
    column: NDArray[np.int64],
    range_m: NDArray[np.float64],
    extent_m: NDArray[np.float64],
    power: NDArray[np.float64],
    row_m: float,
    rows: int,
    columns: int,
) -> NDArray[np.float64]:
    """Power per metre of range of patches that spread evenly over the rows they cover.

    Args:
        column: of each patch, (N,).
        range_m: of its middle, (N,).
        extent_m: in range; a patch covers at least one row, (N,).
        power: (N,).
        row_m: height of a row.
        rows: of the picture.
        columns: of the picture.

    Returns:
        (rows, columns).

    Raises:
        ValueError: sizes differ, or a column lies outside of the picture.
    """

def limited(
    numbers: NDArray[np.floating], limit: float, factor: float = 1.0
) -> NDArray[np.float32]:
    """Numbers no less than 0 and no larger than a limit, times a factor; NaN counts as 0."""

def pixel_change_db(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    gamma: float,
    largest_pixel: float,
    exceeding: int,
    row_cells: float = 0.0,
    column_cells: float = 0.0,
) -> float:
    """Difference in dB that at most `exceeding` pixels of two pictures exceed.

    Args:
        first: expected amplitudes of full scale, at least 0 and at most 1e18, (rows, columns).
        second: of the other picture.
        gamma: exponent between amplitude and pixel.
        largest_pixel: of the quantiser; what differs by less than a step does not differ.
        exceeding: number of pixels.
        row_cells: displacement in rows that does not count.
        column_cells: the same in columns.

    Raises:
        ValueError: the pictures differ in shape, or gamma or a displacement is out of range.
    """

def dark_change_db(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    gamma: float,
    mean_pixel: NDArray[np.float32],
    limit: float,
    row_cells: float = 0.0,
    column_cells: float = 0.0,
) -> float:
    """Largest difference in dB between the means of what is dark in both, over bands of range.

    Args:
        first: expected amplitudes of full scale, at least 0 and at most 1e18, (rows, columns).
        second: of the other picture.
        gamma: exponent between amplitude and pixel.
        mean_pixel: mean pixel of speckle over its rms amplitude, 0 to the limit, then 0, (E + 1,).
        limit: amplitude below which pixels are dark.
        row_cells: displacement in rows that does not count.
        column_cells: the same in columns.

    Raises:
        ValueError: the pictures differ in shape, or gamma or a displacement is out of range.
    """

def block_powers(
    cells: NDArray[np.complex64] | NDArray[np.float32], width: int, threads: int = 2
) -> NDArray[np.float32]:
    """Mean power of blocks of columns, (rows, blocks).

    Args:
        cells: (rows, columns), a field or a power.
        width: columns of a block; the last may be narrower.
        threads: that share the rows.
    """

def decaying_sum(power: NDArray[_Real], energy: float, kept: float) -> NDArray[_Real]:
    """Sum of a part of all earlier rows, that fades from row to row, in double precision.

    Args:
        power: (rows, columns).
        energy: part of a row that is in the next one.
        kept: part of the sum that is left a row later.

    Returns:
        (rows, columns); the first row is 0.

    Raises:
        ValueError: the power is not two-dimensional, or neither float32 nor float64.
    """

def spread_columns(
    power: NDArray[_Real], weights: NDArray[_Real], threads: int = 2
) -> NDArray[_Real]:
    """The matrix product power @ weights. Zeros at the ends of the weights' rows cost nothing.

    Args:
        power: (rows, columns).
        weights: (columns, M).
        threads: that share the rows.

    Returns:
        (rows, M).

    Raises:
        ValueError: the shapes do not match, or the power is neither float32 nor float64.
    """

def box_crossing(
    box_m: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float32],
    reach_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ranges between which rays of one origin are inside a box, (N,) each; equal for a miss.

    Args:
        box_m: lowest and highest corner, (2, 3).
        origin_m: of the rays, (3,).
        direction: unit vectors, (N, 3).
        reach_m: where the rays end, (N,).

    Raises:
        ValueError: the shapes are wrong.
    """

def add_cloud(
    power: NDArray[np.float32],
    enter_row: NDArray[np.float64],
    leave_row: NDArray[np.float64],
    column: NDArray[np.int32],
    weight: NDArray[np.float64],
    row_fade: NDArray[np.float64],
    column_fade: NDArray[np.float64],
    level: NDArray[np.float64],
) -> None:
    """Add what a cloud sends back, in place.

    Each of N rays adds its weight to the rows between its entry and exit, in parts of a row, times
    min(row_fade * column_fade, 1) * level.

    Args:
        power: (rows, columns), C-contiguous.
        enter_row: where rays enter, rows and parts of them, at least 0, (N,).
        leave_row: where they leave, not before, (N,).
        column: of each ray, (N,).
        weight: of each ray, (N,).
        row_fade: (rows,).
        column_fade: (columns,).
        level: factor to power, (rows,).
    """

@overload
def form_beams(
    cells: NDArray[np.complex64],
    taps: NDArray[np.float32],
    first: int,
    beams: int,
    range_taps: NDArray[np.float32],
    threads: int = 2,
) -> NDArray[np.complex64]: ...
@overload
def form_beams(
    cells: NDArray[np.float32],
    taps: NDArray[np.float32],
    first: int,
    beams: int,
    range_taps: NDArray[np.float32],
    threads: int = 2,
) -> NDArray[np.float32]:
    """Range response and azimuth pattern of beams that follow the columns' pitch.

    Args:
        cells: (rows, columns), a field or a power; what lies outside is silent.
        taps: weights about a beam's own column, (odd,); many of them go by Fourier transform.
        first: column of beam 0.
        beams: their number.
        range_taps: weights about a cell's own row, (odd,).
        threads: that share the rows.

    Returns:
        (rows, beams), field or power as given.
    """

@overload
def form_beams_at(
    cells: NDArray[np.complex64],
    taps: NDArray[np.float32],
    firsts: NDArray[np.int64],
    range_taps: NDArray[np.float32],
    threads: int = 2,
) -> NDArray[np.complex64]: ...
@overload
def form_beams_at(
    cells: NDArray[np.float32],
    taps: NDArray[np.float32],
    firsts: NDArray[np.int64],
    range_taps: NDArray[np.float32],
    threads: int = 2,
) -> NDArray[np.float32]:
    """As `form_beams`, for beams anywhere: beam b weighs column firsts[b] + k by taps[b, k].

    Args:
        cells: (rows, columns), a field or a power.
        taps: (beams, count).
        firsts: (beams,), may be negative.
        range_taps: (odd,).
        threads: that share the rows.
    """

def amplitudes(
    beams: NDArray[np.complex64] | NDArray[np.float32], gain: NDArray[np.float32], threads: int = 2
) -> NDArray[np.float32]:
    """Amplitude after gain, (rows, beams): of a field, or the root of a power; NaN becomes 0.

    Args:
        beams: (rows, beams).
        gain: factor to amplitude, (rows,).
        threads: that share the rows.
    """

@overload
def pixels(
    amplitude: NDArray[np.float32], gamma: float, bits: Literal[0], clip: bool, threads: int = 2
) -> NDArray[np.float32]: ...
@overload
def pixels(
    amplitude: NDArray[np.float32], gamma: float, bits: Literal[8], clip: bool, threads: int = 2
) -> NDArray[np.uint8]: ...
@overload
def pixels(
    amplitude: NDArray[np.float32], gamma: float, bits: Literal[16], clip: bool, threads: int = 2
) -> NDArray[np.uint16]: ...
@overload
def pixels(
    amplitude: NDArray[np.float32], gamma: float, bits: Literal[32], clip: bool, threads: int = 2
) -> NDArray[np.uint32]: ...
@overload
def pixels(
    amplitude: NDArray[np.float32], gamma: float, bits: int, clip: bool, threads: int = 2
) -> NDArray[np.float32] | NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32]:
    """The pixel law: amplitude^gamma, times the greatest integer and rounded; any shape.

    Args:
        amplitude: 1 is full scale.
        gamma: exponent, in (0, 2].
        bits: of a pixel, 8, 16 or 32; 0 gives floats.
        clip: at full scale; integers end there in any case.
        threads: that share the work.
    """

class FaceTable:
    """Triangles as their planes, with what they are made of."""

    def __init__(
        self,
        planes: NDArray[np.float64],
        objects: NDArray[np.uint32],
        materials: NDArray[np.int32],
        smooth: NDArray[np.int32],
        curved_normal: NDArray[np.float64],
        table: NDArray[np.float64],
    ) -> None:
        """Keep the arrays.

        Args:
            planes: normal n and offset, n.p = offset, (F, 4), in the frame of the face's object.
            objects: key of each face's object, (F,); scatterers belong to it.
            materials: index into the table, (F,).
            smooth: index into `curved_normal`, or -1 for a flat face, (F,).
            curved_normal: rows of G | g, whose G p + g is a round surface's normal at p, (S, 12).
            table: mu, squared reflection, roughness in m, slope in rad, (M, 4).
        """

    def coarse_patches(
        self,
        face: NDArray[np.int32],
        group: NDArray[np.int32],
        range_m: NDArray[np.float32],
        direction: NDArray[np.float64],
        solid_angle_sr: NDArray[np.float64],
        s_step: float,
        w_step: float,
        map_T_sonar: NDArray[np.float64],  # noqa: N803
        map_T_group: NDArray[np.float64],  # noqa: N803
        reach_m: float,
    ) -> tuple[
        NDArray[np.int64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        """Compute the patches of surface that coarse rays hit.

        Args:
            face: in the table, or negative for nothing, (N,).
            group: index of the face's pose, (N,).
            range_m: of the hit, (N,).
            direction: unit vectors, sonar frame, (N, 3).
            solid_angle_sr: of each ray's cell, (N,).
            s_step: width of the cells in s = -y.
            w_step: their height in w = z.
            map_T_sonar: rotation, row by row, and position, (12,).
            map_T_group: the same of each frame of faces, (G, 12).
            reach_m: farther hits are left out.

        Returns:
            Of P patches: their rays, (P,). Points and unit normals in the map frame, (P, 3).
            Cosines of incidence, at least 0, areas in m² and extents in range in m, (P,).
            Variances of the normal within the patch by its curvature, (P, 3): their sum, their
            product, and the variance along the ray's projection on the tangent plane.

        Raises:
            ValueError: sizes differ, or a face or group does not exist.
        """

class Rays:
    """What was met, and by which legs the sound goes there and back."""

    def __init__(
        self,
        face: NDArray[np.int32],
        seen: NDArray[np.int32],
        transmit: NDArray[np.int32],
        receive: NDArray[np.int32],
        cell: NDArray[np.float32],
        span_m: NDArray[np.float32],
        gain: NDArray[np.float32],
        legs: NDArray[np.float64],
        both_ways: bool = False,
        lean: NDArray[np.float32] | None = None,
    ) -> None:
        """Keep the arrays.

        Args:
            face: that was met, (H,); negative where nothing sends back sound.
            seen: leg that looked, (H,).
            transmit: leg from which the sound came, (H,).
            receive: leg that hears it, (H,).
            cell: s from, s to, w from, w to of the directions that the hit stands for, as `seen`
                has them, (H, 4); s is starboard, w up.
            span_m: ranges from `seen` between which the face's plane is followed, (H, 2).
            gain: of pressure, (H,).
            legs: origin in m, rotation object from sonar row by row, drift of the apparent range
                per unit of direction in m, gain of pressure; in the object's frame, (L, 16).
            both_ways: whether the sound goes there by `receive` and back by `transmit` too; no leg
                has a drift then.
            lean: by which a cell's s grows with w from its middle, and its w with s, (H, 2); None
                is upright.
        """

class ScatterSetting:
    """Cells, receiver and scattering model."""

    def __init__(
        self,
        loss: NDArray[np.float32],
        vertical: NDArray[np.float32],
        taps: NDArray[np.float32],
        columns: int,
        row_m: float,
        first_sine: float,
        sine_pitch: float,
        range_scale: float,
        lambert: bool,
        specular: bool,
        spreading: bool,
        turns_per_m: float,
        nodes_per_cell: float,
        key: int,
    ) -> None:
        """Keep the settings.

        Args:
            loss: pressure that the way to a row and back leaves, source included, (rows,).
            vertical: one-way pressure over |w|, evenly from 0 to 1, (2 or more,).
            taps: how an echo between columns spreads over whole ones, by the fraction, (F, even).
            columns: of the grid.
            row_m: range of a row.
            first_sine: of column 0's bearing.
            sine_pitch: of the columns.
            range_scale: apparent range over true range.
            lambert: whether strength falls as cos² of incidence.
            specular: whether reflecting materials have their lobe.
            spreading: whether pressure falls as 1 / range each way.
            turns_per_m: 1 / wavelength.
            nodes_per_cell: scatterers in a row's and column's cell, about.
            key: 64 bits that choose the scatterers.
        """

def edges(
    direction: NDArray[np.float32],
    range_m: NDArray[np.float32],
    face: NDArray[np.int32],
    group: NDArray[np.int32],
    standing: int,
    column: NDArray[np.int32],
    normals: NDArray[np.float32],
    smooth: NDArray[np.int32],
    max_slope: float,
    min_step_m: float,
    min_cosine: float,
) -> NDArray[np.int64]:
    """Rays whose upper neighbour in the column met something else, in order.

    Args:
        direction: map frame, column after column from below upwards, (N, 3).
        range_m: at which each ray met something, (N,).
        face: that was met, negative where nothing, (N,).
        group: whose frame the face is given in, (N,).
        standing: the group in the map's frame, -1 for none: hits of others are compared by group.
        column: of the fan, (N,).
        normals: of the faces, (F, 3).
        smooth: of the faces, not negative where round, (F,).
        max_slope: slope by which one neighbour may leave the other's plane.
        min_step_m: by which it may in any case.
        min_cosine: between the normals on a round surface.
    """

def spans(
    range_m: NDArray[np.float32],
    face: NDArray[np.int32],
    column: NDArray[np.int32],
    up: NDArray[np.float32],
    surface: NDArray[np.int32],
    size_m: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Ranges between which each hit's plane is followed, (N, 2).

    They are those at which neighbours in the column and beside it met the same surface, widened by
    the face's size.

    Args:
        range_m: at which each ray met something, column after column from below upwards, (N,).
        face: that was met, negative where nothing, (N,).
        column: of the fan, (N,).
        up: sine of elevation, (N,).
        surface: of each face, (F,).
        size_m: longest edge of each face, (F,).
    """

class TriangleTable:
    """Triangles of a mesh, for rays of one origin."""

    def __init__(self, corners_m: NDArray[np.float32]) -> None:
        """Sort triangles.

        Args:
            corners_m: (F, 3, 3).

        Raises:
            ValueError: the shape is wrong, or a corner is not less than 1e9 m.
        """
    def cast_bundle(
        self,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float32],
        near_m: NDArray[np.float32] | None,
        first_face: int,
        range_m: NDArray[np.float32],
        face: NDArray[np.int32],
        threads: int,
    ) -> None:
        """Find the first triangle on each ray; rays of the mesh's frame.

        Args:
            origin_m: of all rays, (3,).
            direction: unit vectors, (N, 3).
            near_m: hits at or below this range are ignored, (N,); None: 0.1 mm.
            first_face: added to the triangles' indices.
            range_m: (N,), in: maximum range; out: range of the hit, unchanged for a miss.
            face: (N,), of the hit, unchanged for a miss.
            threads: at most; the result does not depend on it.

        Raises:
            TypeError: `range_m` or `face` is of another type or not contiguous.
            ValueError: sizes differ, or `range_m` or `face` is read-only.
        """

class EdgeTable:
    """Edges of a mesh at which its outline may lie."""

    def __init__(
        self,
        corners_m: NDArray[np.float32],
        normals: NDArray[np.float32],
        surface: NDArray[np.int32],
    ) -> None:
        """Join corners at the same place.

        Args:
            corners_m: of the faces, (F, 3, 3).
            normals: of the faces, (F, 3).
            surface: that each face belongs to, (F,).
        """

    def __len__(self) -> int:
        """Number of edges; those within a plane are left out."""

class MeshView:
    """A mesh as seen from the sonar."""

    def __init__(self, table: EdgeTable, pose: NDArray[np.float64]) -> None:
        """Keep the table.

        Args:
            table: of the mesh's edges.
            pose: rotation sonar from mesh, row by row; origin of the mesh in the sonar's frame;
                the sonar in the mesh's frame, (15,).
        """

def meet_sea(
    direction: NDArray[np.float32],
    depth_m: float,
    near_m: NDArray[np.float32] | None,
    sea_face: int,
    sea_group: int,
    range_m: NDArray[np.float32],
    face: NDArray[np.int32],
    group: NDArray[np.int32],
) -> None:
    """Enter where rays of one origin meet the sea's surface from below before anything else.

    Args:
        direction: unit vectors, map frame, (N, 3).
        depth_m: of the origin; where it is not below the surface, nothing is met.
        near_m: minimum range, (N,), or None.
        sea_face: entered where a ray meets the surface.
        sea_group: the same.
        range_m: of the hits so far, (N,), changed in place.
        face: the same.
        group: the same.

    Raises:
        TypeError: an array to be changed is of another type or not contiguous.
        ValueError: sizes differ, or an array to be changed is read-only.
    """

def merged(
    known: NDArray[_Number], source: NDArray[np.int32], more: NDArray[_Number]
) -> NDArray[_Number]:
    """Rows of `known` (N, ...) where `source` names them, and those of `more`, in order, elsewhere.

    Args:
        known: rows to choose from.
        source: of each row of the result, its place in `known`, or negative, (M,).
        more: a row for each negative source, (K, ...).

    Raises:
        TypeError: `source` is of another type.
        ValueError: the rows differ in type or shape, or their numbers do not fit `source`.
    """

def rotated(direction: NDArray[np.float32], matrix: NDArray[np.float32]) -> NDArray[np.float32]:
    """The product direction @ matrix, (N, 3), on this thread alone.

    Args:
        direction: (N, 3).
        matrix: (3, 3).

    Raises:
        ValueError: a shape is another.
    """

def rays_near_ball(
    start_m: NDArray[np.float64],
    direction: NDArray[np.float32],
    reach_m: float,
    middle_m: NDArray[np.float64],
    radius_m: float,
) -> NDArray[np.int64]:
    """Indices of the rays that pass through a ball within `reach_m`.

    Args:
        start_m: (N, 3).
        direction: unit vectors, (N, 3).
        reach_m: maximum range.
        middle_m: of the ball, (3,).
        radius_m: of the ball.

    Raises:
        ValueError: sizes differ.
    """

def visible_points(
    direction: NDArray[np.float32],
    map_direction: NDArray[np.float32],
    face: NDArray[np.int32],
    hit_m: NDArray[np.float32],
    origin_m: NDArray[np.float64],
    range_m: float,
    bearing_sine: float,
    elevation_sine: float,
) -> NDArray[np.float64]:
    """Points of hits within a range and within sines of bearing and elevation, map frame, (P, 3).

    Args:
        direction: unit vectors of the rays, sonar frame, (N, 3).
        map_direction: the same in the map frame, (N, 3).
        face: that each ray hit, or negative for nothing, (N,).
        hit_m: range of the hit, (N,).
        origin_m: of the rays, map frame, (3,).
        range_m: farther hits are left out.
        bearing_sine: largest |y| of the direction.
        elevation_sine: largest |z|.

    Raises:
        ValueError: sizes differ.
    """

def cells_through_window(
    direction: NDArray[np.float32],
    cell: NDArray[np.float32],
    map_T_fan: NDArray[np.float64],  # noqa: N803
    plane: NDArray[np.float64],
    box_m: NDArray[np.float64],
    margin_m: float,
    reach_m: float,
) -> NDArray[np.int64]:
    """Indices of the fan's cells of which a direction may pass through a part of a plane.

    Args:
        direction: middles of the cells, (N, 3).
        cell: s from, s to, w from, w to of each, (N, 4).
        map_T_fan: rotation, row by row, which may reflect, and position, (12,).
        plane: its normal in the map frame, to the side that rays go to, and its height over the
            fan's origin along it, (4,).
        box_m: lowest and highest corner of a box that holds the part, map frame, (2, 3).
        margin_m: by which the box is widened.
        reach_m: maximum range to the plane.

    Raises:
        ValueError: sizes differ.
    """

def turned_rays(
    layers: NDArray[np.float64],
    points: NDArray[np.float64],
    directions: NDArray[np.float64],
    step_m: float,
    turn_m: float,
    threads: int = 2,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speeds in the middle of the rays' next straight pieces, (N,), and their directions, (N, 3).

    Elevation changes by -(dc/dz) cos / c along the way (Snell). Turned from the middle of one piece
    to that of the next, a path is off by the square of the step.

    Args:
        layers: depths, increasing, and speeds of sound: linear in between, constant beyond, (L, 2).
        points: where the rays are, z up, 0 at the sea's surface, (N, 3).
        directions: unit vectors, (N, 3).
        step_m: length of the next piece.
        turn_m: way over which it turns: `step_m`, and half of it for the first piece.
        threads: that share the rays.
    """

def followed_rays(
    layers: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    directions: NDArray[np.float64],
    step_m: float,
    steps: int,
    speed_mps: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of bent rays, (steps + 1, N, 3), and ranges by time to them, (steps + 1, N).

    Args:
        layers: as of `turned_rays`.
        origin_m: where the rays leave, (3,).
        directions: in which they leave, unit vectors, (N, 3).
        step_m: length of a straight piece.
        steps: pieces.
        speed_mps: that turns time into range.
    """

def refined_rays(
    direction: NDArray[np.float32],
    cell: NDArray[np.float32],
    range_m: NDArray[np.float32],
    row_edges: NDArray[np.float64],
    rays: NDArray[np.int32],
    first_s: float,
    s_pitch: float,
    meshes: list[MeshView],
    pairs: NDArray[np.int64],
    reach_m: float,
    layers: NDArray[np.float64],
    up: NDArray[np.float64],
) -> tuple[
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.int32],
    NDArray[np.int32],
]:
    """Cut a fan's cells along the outlines of what it sees, into parts of one surface each.

    Args:
        direction: sonar frame, (N, 3).
        cell: s from, s to, w from, w to of each ray's cell, (N, 4).
        range_m: at which each ray met something, (N,).
        row_edges: sines of elevation between the rows of cells, (rows + 1,).
        rays: of each cell, -1 where it has none, (columns, rows).
        first_s: s where the first column begins.
        s_pitch: of the columns.
        meshes: what may have an outline.
        pairs: rays whose upper neighbour met something else, in order; where no outline is between
            them, rays are laid there.
        reach_m: maximum range of an outline.
        layers: depth in m and speed of sound in m/s, in order of depth, (L, 2); of none, rays are
            straight.
        up: the upward direction in the sonar's frame, and the sonar's height over the sea, (4,).

    Returns:
        Directions (M, 3), cells (M, 4), by how much they lean (M, 2), see `Rays`, and columns (M,)
        of the finer fan; and the ray of the given fan that each is, -1 for new ones, (M,).
    """

def scatter_field(
    field: NDArray[np.complex64],
    faces: FaceTable,
    rays: Rays,
    setting: ScatterSetting,
    threads: int,
) -> None:
    """Add the surfaces' random scatterers, in place, (rows, columns)."""

def scatter_power(
    power: NDArray[np.float32], faces: FaceTable, rays: Rays, setting: ScatterSetting, threads: int
) -> None:
    """Add the surfaces' mean powers, in place, (rows, columns)."""
