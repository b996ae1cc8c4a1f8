"""What an alignment writes: trajectories, the pose graph, figures and a report with pictures.

Of each dive the folder gets `NAME.tum` and `NAME.mcap`; those of a single dive are called
`trajectory`. matplotlib belongs to the extra `align`; it is imported only when pictures are drawn.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mapperd import __version__
from mapperd.alignment.align import AlignedDive, Alignment, odometry_steps
from mapperd.alignment.pose_graph import DriftModel, Loop, OdometryStep
from mapperd.alignment.submaps import (
    DiveReader,
    SonarSubmap,
    compose,
    inverse,
)
from mapperd.errors import ExportError, os_reason
from mapperd.export.picture import MapProjection, project
from mapperd.io import atomic_file, make_folder, sync_folder
from mapperd.mapping.sonar_map import Voxels
from mapperd.odometry.native import NativeRecord, encode_native
from mapperd.odometry.trajectory_files import FINISHED, POSES_LINK
from oculus_driver.errors import RecordingError
from oculus_driver.recording import ODOMETRY_NATIVE, RecordingWriter

__all__ = [
    "ALIGNMENT_JSON",
    "AlignedDiveRecord",
    "AlignmentRecord",
    "LoopRecord",
    "MapPair",
    "maps_of",
    "record_of",
    "trajectory_name",
    "write_alignment",
]

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

ALIGNMENT_JSON = "alignment.json"
TRAJECTORY = "trajectory"
NS = 10**9

HEIGHT_M, TILT_RAD = 0.02, math.radians(0.2)
"""Standard deviations stated for z, and for roll and pitch: those of usual sensors of depth and
tilt, which alignment leaves as they are."""


class LoopRecord(Struct, frozen=True):
    """A registration between two submaps.

    Attributes:
        dives: of target and source.
        time_s: of both submaps' middles, Unix.
        accepted: whether the result uses it.
        neighbours: whether the submaps follow each other, so that it is no revisit.
        weight: 0..1, trust in it after solving.
        score: 0..1, agreement of the submaps.
        residual_m, residual_deg: by which the aligned poses deviate from it.
    """

    dives: tuple[str, str]
    time_s: tuple[float, float]
    accepted: bool
    neighbours: bool
    weight: float
    score: float
    residual_m: float
    residual_deg: float


class AlignedDiveRecord(Struct, frozen=True):
    """Figures of one dive.

    Attributes:
        name: of the dive.
        trajectory: files in the same folder.
        begin_s, end_s: Unix time.
        nodes: of the pose graph.
        frame: x, y (m) and yaw (degrees) of the odometry's frame in the common one.
        correction_rms_m, correction_max_m: horizontal, of the nodes, in the odometry's frame.
        correction_max_deg: of the heading.
        drift_scale_percent, drift_crab_deg, drift_turn_deg_per_min: medians of the drift found:
            part that distances grow by and angle that courses turn by until they fit, and rate that
            the heading lacks.
        deviation_mean_m, deviation_max_m: horizontal standard deviation of the poses written, over
            time: the root of the sum of the variances of x and y, with respect to the common
            frame's first pose.
    """

    name: str
    trajectory: list[str]
    begin_s: float
    end_s: float
    nodes: int
    frame: tuple[float, float, float]
    correction_rms_m: float
    correction_max_m: float
    correction_max_deg: float
    drift_scale_percent: float
    drift_crab_deg: float
    drift_turn_deg_per_min: float
    deviation_mean_m: float
    deviation_max_m: float


class AlignmentRecord(Struct, frozen=True):
    """Content of `alignment.json`.

    Attributes:
        corrected: whether the trajectories are corrected; else they are the odometry.
        reason: why they are not; empty if they are.
        verdict: both in one line.
        pairs_tried: number of comparisons of submaps for revisits, in both passes.
        pairs_rejected: those without a registration, by reason.
        revisits_accepted, revisits_refused: number of registrations, without those of submaps that
            follow each other.
        figures: what the verdict rests on, by name.
        dives: in the given order.
        loops: all registrations.
        version: of this program.
    """

    corrected: bool
    reason: str
    verdict: str
    pairs_tried: int
    pairs_rejected: dict[str, int]
    revisits_accepted: int
    revisits_refused: int
    figures: dict[str, float]
    dives: list[AlignedDiveRecord]
    loops: list[LoopRecord]
    version: str = __version__

    def summary(self) -> dict[str, Any]:
        """Return the verdict and its figures, for other summaries."""
        return {
            "corrected": self.corrected,
            "reason": self.reason,
            "revisits_accepted": self.revisits_accepted,
            "revisits_refused": self.revisits_refused,
            "correction_rms_m": max(dive.correction_rms_m for dive in self.dives),
            "correction_max_m": max(dive.correction_max_m for dive in self.dives),
            "deviation_mean_m": max(dive.deviation_mean_m for dive in self.dives),
            "deviation_max_m": max(dive.deviation_max_m for dive in self.dives),
        }


@dataclass(frozen=True, slots=True, eq=False)
class MapPair:
    """Occupied voxels of the same submaps, before and after.

    Attributes:
        before, after: in the common frame.
        resolution_m: edge of a voxel.
    """

    before: Voxels
    after: Voxels
    resolution_m: float


def maps_of(alignment: Alignment, readers: Sequence[DiveReader]) -> MapPair | None:
    """Place the submaps of all dives by the odometry and by the aligned poses.

    Args:
        alignment: the result.
        readers: of its dives, in their order.

    Returns:
        the voxels that are occupied in any submap; None without any.
    """
    edges_m = [one.resolution_m for reader in readers for one in reader.submaps]
    if not edges_m:
        return None
    resolution_m = max(edges_m)
    before, after = [], []
    for dive, reader in zip(alignment.dives, readers, strict=True):
        if reader.submaps:
            odometry = dive.track.at(_anchors(reader.uncorrected))
            poses = compose(dive.frame, odometry)
            before += _voxels_at_poses(reader.uncorrected, poses, resolution_m)
            submaps = reader.submaps if alignment.corrected else reader.uncorrected
            after += _voxels_at_poses(submaps, dive.poses_at(_anchors(submaps)), resolution_m)
    return MapPair(
        _merged_voxels(before, resolution_m), _merged_voxels(after, resolution_m), resolution_m
    )


def _anchors(submaps: Sequence[SonarSubmap]) -> Times:
    return np.array([submap.anchor_ns for submap in submaps], dtype=np.int64)


def _voxels_at_poses(
    submaps: Sequence[SonarSubmap], poses: Floats, resolution_m: float
) -> list[NDArray[np.int64]]:
    """Indices (N, 3) of the voxels of an edge that each submap fills at its planar pose."""
    placed = []
    for submap, (x, y, yaw) in zip(submaps, poses.tolist(), strict=True):
        ahead, port, up = ((submap.occupied + 0.5) * submap.resolution_m).T
        c, s = math.cos(yaw), math.sin(yaw)
        points_m = np.column_stack([x + c * ahead - s * port, y + s * ahead + c * port, up])
        cells = np.floor(points_m / resolution_m).astype(np.int64)
        placed.append(np.unique(cells, axis=0))
    return placed


def _merged_voxels(cells: Sequence[NDArray[np.int64]], resolution_m: float) -> Voxels:
    """Voxels that any submap has, with the share and the number of submaps that have them."""
    none = np.zeros((0, 3), dtype=np.int64)
    found, count = np.unique(np.concatenate([none, *cells]), axis=0, return_counts=True)
    centres_m = (found + 0.5) * resolution_m
    return Voxels(
        centres_m,
        np.ones(len(found), dtype=np.float32),
        np.minimum(count, 2**16 - 1).astype(np.uint16),
    )


def trajectory_name(alignment: Alignment, dive: AlignedDive) -> str:
    """Return the name of a dive's trajectories, without suffix."""
    return TRAJECTORY if len(alignment.dives) == 1 else dive.name


def write_alignment(
    alignment: Alignment,
    folder: Path,
    maps: MapPair | None = None,
    model: DriftModel | None = None,
) -> AlignmentRecord:
    """Write everything; each file is whole or as it was.

    Args:
        alignment: the result.
        folder: is made where it is missing.
        maps: for the picture of both maps; None draws none.
        model: of the drift, for the information of odometry edges; None is the default.

    Returns:
        what `alignment.json` says.

    Raises:
        ExportError: a file cannot be written.
    """
    make_folder(folder)
    record = record_of(alignment)
    for dive in alignment.dives:
        name = trajectory_name(alignment, dive)
        t_ns, position_m, wxyz = _trajectory_of(dive)
        _write(folder / f"{name}.tum", "".join(_tum_lines(t_ns, position_m, wxyz)))
        _write_records(folder / f"{name}.mcap", dive, t_ns, position_m, wxyz)
    _write(
        folder / "graph.g2o",
        "".join(f"{line}\n" for line in _g2o_lines(alignment, model or DriftModel())),
    )
    encoded = msgspec.json.format(msgspec.json.encode(record), indent=1)
    _write(folder / ALIGNMENT_JSON, encoded.decode() + "\n")
    pictures = _draw(alignment, record, folder, maps)
    _write(folder / "report.md", _page(record, pictures))
    return record


def _write(path: Path, text: str) -> None:
    with atomic_file(path) as file:
        file.write(text.encode())


def _trajectory_of(dive: AlignedDive) -> tuple[Times, Floats, Floats]:
    """Times, positions (N, 3) and quaternions (N, 4) w x y z of the base in the common frame.

    x, y and yaw are aligned; z, roll and pitch are the odometry's.
    """
    track = dive.track
    turn = dive.correction_at(track.t_ns)[:, 2] / 2
    planar = dive.poses_at(track.t_ns)
    c, s = np.cos(turn), np.sin(turn)
    w, x, y, z = track.map_q_base.T
    wxyz = np.column_stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    return track.t_ns, np.column_stack([planar[:, :2], track.position_m[:, 2]]), wxyz


def _tum_lines(t_ns: Times, position_m: Floats, wxyz: Floats) -> Iterator[str]:
    yield "# timestamp tx ty tz qx qy qz qw\n"
    rows = zip(t_ns.tolist(), position_m.tolist(), wxyz.tolist(), strict=True)
    for stamp_ns, place, (w, x, y, z) in rows:
        numbers = " ".join(f"{value:.6f}" for value in place)
        turn = " ".join(f"{value:.9f}" for value in (x, y, z, w))
        yield f"{stamp_ns // NS}.{stamp_ns % NS:09} {numbers} {turn}\n"


def _covariance_at(dive: AlignedDive, t_ns: Times) -> Floats:
    """(M, 3, 3) of x, y and yaw; between nodes they are mixed."""
    flat = dive.covariance.reshape(len(dive.t_ns), 9)
    columns = [np.interp(t_ns, dive.t_ns, column) for column in flat.T]
    return np.stack(columns, axis=-1).reshape(-1, 3, 3)


def _triangles(planar: Floats) -> Floats:
    """(N, 21) upper triangles of poses' covariances from those of x, y and yaw."""
    full = np.zeros((len(planar), 6, 6))
    full[:, range(6), range(6)] = [0, 0, HEIGHT_M**2, TILT_RAD**2, TILT_RAD**2, 0]
    places = [0, 1, 5]
    full[np.ix_(range(len(planar)), places, places)] = planar
    rows, columns = np.triu_indices(6)
    triangles: Floats = full[:, rows, columns]
    return triangles


def _write_records(
    path: Path, dive: AlignedDive, t_ns: Times, position_m: Floats, wxyz: Floats
) -> None:
    """Write native odometry records with covariances, as `mapperd --odometry` reads them."""
    partial = path.with_name(f".{path.name}.partial")
    triangles = _triangles(_covariance_at(dive, t_ns))
    resets = (dive.track.segment - dive.track.segment[0]).tolist()
    rows = zip(t_ns.tolist(), position_m.tolist(), wxyz.tolist(), triangles.tolist(), resets)  # noqa: B905
    try:
        with RecordingWriter(partial, metadata=FINISHED, overwrite=True) as recording:
            link = recording.add_link(POSES_LINK, ODOMETRY_NATIVE)
            for stamp_ns, place, turn, triangle, reset in rows:
                record = NativeRecord(
                    v=1,
                    clk="unix",
                    w="enu",
                    b="flu",
                    t=stamp_ns,
                    p=tuple(place),
                    q=tuple(turn),
                    pc=tuple(triangle),
                    rst=reset,
                    src="alignment",
                )
                recording.write(link, encode_native(record), stamp_ns)
        partial.replace(path)
        sync_folder(path.parent)
    except (RecordingError, OSError) as error:
        why = os_reason(error) if isinstance(error, OSError) else error
        raise ExportError(f"{path}: cannot be written: {why}") from error
    finally:
        partial.unlink(missing_ok=True)


def _g2o_lines(alignment: Alignment, model: DriftModel) -> Iterator[str]:
    """The pose graph as other programs read it: vertices, odometry, accepted registrations."""
    yield "# poses of the base: x m, y m, yaw rad; information of x, y (axes of the first) and yaw"
    first = 0
    fixed = []
    for dive in alignment.dives:
        fixed.append(first)
        yield f"# dive {dive.name}: vertices {first} to {first + len(dive.t_ns) - 1}"
        for k, pose in enumerate(dive.poses):
            yield f"VERTEX_SE2 {first + k} {_numbers(pose)}"
        first += len(dive.t_ns)
    yield f"FIX {fixed[0]}"
    yield "# odometry, as it came: its drift counts as noise of each step alone"
    for first, dive in zip(fixed, alignment.dives, strict=True):
        steps = odometry_steps(dive.track, dive.t_ns)
        outage_std_m: dict[int | None, float] = {}
        for step in filter(None, steps):
            outage_std_m[step.outage] = outage_std_m.get(step.outage, 0.0) + step.outage_std_m
        for k, step in enumerate(filter(None, steps), 1):
            # Of steps that share an error the variances add up to that of their sum.
            outage_variance_m2 = step.outage_std_m * outage_std_m[step.outage]
            information = _upper(_step_information(step, outage_variance_m2, model))
            yield f"EDGE_SE2 {first + k - 1} {first + k} {_numbers(step.motion)} {information}"
    yield "# registrations of submaps; refused ones are comments"
    for loop in alignment.loops:
        mark = "" if loop.accepted else "# refused: "
        pose, information = loop.poses[loop.chosen], loop.information[loop.chosen]
        yield f"{mark}EDGE_SE2 {loop.i} {loop.j} {_numbers(pose)} {_upper(information)}"


def _step_information(step: OdometryStep, outage_variance_m2: float, model: DriftModel) -> Floats:
    path_m, seconds = step.path_m, step.seconds
    noise2 = model.noise_m**2 * max(path_m, 0.1) + step.extra_std_m**2 + outage_variance_m2
    # Twice: the variances of the mean and of what wanders about it. The larger one of scale and
    # crab, for the direction of travel is not known.
    drift2 = 2 * (max(model.scale, model.crab_rad) * path_m) ** 2
    turn2 = model.noise_rad**2 * seconds + 2 * (model.turn_radps * seconds) ** 2 + 1e-6
    information = (
        1 / (noise2 + drift2),
        1 / (noise2 + drift2),
        1 / (turn2 + step.extra_std_rad**2),
    )
    return np.diag(information)


def _numbers(values: Floats) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _upper(matrix: Floats) -> str:
    return _numbers(matrix[np.triu_indices(3)])


def record_of(alignment: Alignment) -> AlignmentRecord:
    """Return the figures of an alignment."""
    revisits = [loop for loop in alignment.loops if not loop.neighbours]
    accepted = sum(loop.accepted for loop in revisits)
    return AlignmentRecord(
        corrected=alignment.corrected,
        reason=alignment.reason,
        verdict=alignment.verdict,
        pairs_tried=alignment.tried,
        pairs_rejected=dict(sorted(alignment.rejected.items())),
        revisits_accepted=accepted,
        revisits_refused=len(revisits) - accepted,
        figures={name: float(value) for name, value in alignment.figures.items()},
        dives=[_dive_record(alignment, dive) for dive in alignment.dives],
        loops=[_loop_record(alignment, loop) for loop in alignment.loops],
    )


def _dive_record(alignment: Alignment, dive: AlignedDive) -> AlignedDiveRecord:
    shift_m, turn_rad = _correction_of(dive, dive.odometry, dive.poses)
    deviation_m = _deviation_m(_covariance_at(dive, dive.track.t_ns))
    scale, crab, turn = np.median(dive.drift, axis=0).tolist()
    name = trajectory_name(alignment, dive)
    x, y, yaw = dive.frame.tolist()
    return AlignedDiveRecord(
        name=dive.name,
        trajectory=[f"{name}.tum", f"{name}.mcap"],
        begin_s=int(dive.track.t_ns[0]) / NS,
        end_s=int(dive.track.t_ns[-1]) / NS,
        nodes=len(dive.t_ns),
        frame=(x, y, math.degrees(yaw)),
        correction_rms_m=float(np.sqrt((shift_m**2).mean())),
        correction_max_m=float(shift_m.max()),
        correction_max_deg=math.degrees(float(np.abs(turn_rad).max())),
        drift_scale_percent=100 * scale,
        drift_crab_deg=math.degrees(crab),
        drift_turn_deg_per_min=60 * math.degrees(turn),
        deviation_mean_m=float(deviation_m.mean()),
        deviation_max_m=float(deviation_m.max()),
    )


def _correction_of(dive: AlignedDive, odometry: Floats, poses: Floats) -> tuple[Floats, Floats]:
    """Horizontal distance (N,) and turn (N,) of aligned poses from the odometry in its frame."""
    placed = compose(dive.frame, odometry)
    shift_m = np.hypot(*(poses - placed)[:, :2].T)
    turn = np.remainder(poses[:, 2] - placed[:, 2] + math.pi, 2 * math.pi) - math.pi
    return shift_m, turn


def _deviation_m(covariance: Floats) -> Floats:
    """(N,) horizontal standard deviation."""
    return np.asarray(np.sqrt(np.maximum(covariance[:, 0, 0] + covariance[:, 1, 1], 0.0)))


def _loop_record(alignment: Alignment, loop: Loop) -> LoopRecord:
    (a, m), (b, n) = (_node(alignment, node) for node in (loop.i, loop.j))
    residual = _residual(loop, a.poses[m], b.poses[n])
    return LoopRecord(
        dives=(a.name, b.name),
        time_s=(int(a.t_ns[m]) / NS, int(b.t_ns[n]) / NS),
        accepted=loop.accepted,
        neighbours=loop.neighbours,
        weight=float(loop.weight),
        score=float(loop.scores[loop.chosen]),
        residual_m=float(np.hypot(residual[0], residual[1])),
        residual_deg=math.degrees(abs(residual[2])),
    )


def _node(alignment: Alignment, node: int) -> tuple[AlignedDive, int]:
    """Return the dive of a node, and its index in it."""
    for dive in alignment.dives:
        if node < len(dive.t_ns):
            return dive, node
        node -= len(dive.t_ns)
    raise IndexError(node)


def _residual(loop: Loop, a: Floats, b: Floats) -> Floats:
    residual = compose(inverse(a), b) - loop.poses[loop.chosen]
    residual[2] = math.remainder(float(residual[2]), math.tau)
    return np.asarray(residual)


INK, PAPER, WATER = "#1b2733", "#ffffff", "#eef2f5"
GREY, BLUE, ORANGE, GREEN, VERMILION = "#7d8790", "#0072b2", "#e69f00", "#009e73", "#d55e00"
PURPLE = "#cc79a7"
DIVE_COLOURS = (BLUE, ORANGE, GREEN, "#56b4e9", VERMILION)
"""Palette of Okabe and Ito, for colour-blind readers."""

DPI = 110
MANY_LOOPS = 60
"""Revisits that are drawn opaque; more are fainter."""

MAX_COLUMN_RATIO = 1.6
"""A plan higher than this share of its width is drawn beside the other, else below it."""


def _draw(
    alignment: Alignment, record: AlignmentRecord, folder: Path, maps: MapPair | None
) -> list[tuple[str, str]]:
    """Draw all pictures; return their files and what they show."""
    drawn = [
        ("trajectory.png", _trajectory_text(record), _trajectory_figure(alignment)),
        ("correction.png", CORRECTION_TEXT, _correction_figure(alignment)),
        ("loops.png", LOOPS_TEXT, _loops_figure(alignment, record)),
        ("residuals.png", RESIDUALS_TEXT, _residuals_figure(record)),
    ]
    if maps is not None and len(maps.before):
        drawn.append(("map.png", MAP_TEXT, _map_figure(maps)))
    for name, _, figure in drawn:
        with atomic_file(folder / name) as file:
            figure.savefig(file, format="png")
    return [(name, text) for name, text, _ in drawn]


def _trajectory_text(record: AlignmentRecord) -> str:
    lines = "Thin lines are accepted revisits." if record.revisits_accepted else "No revisits."
    return f"The base in plan: the odometry, and the poses written. {lines}"


CORRECTION_TEXT = (
    "Top: distance between aligned poses and odometry. Bottom: horizontal standard deviation of "
    "the aligned poses, and what the odometry states of itself."
)
LOOPS_TEXT = (
    "When the two submaps of each revisit were seen. Revisits of the same pass of the site lie on "
    "lines; refused ones contradict the rest."
)
RESIDUALS_TEXT = (
    "How far aligned poses deviate from each accepted registration. Wide tails are registrations "
    "that disagree."
)
MAP_TEXT = (
    "Occupied voxels of all submaps from above, placed by the odometry and by the aligned poses; "
    "the odometry of each dive begins where its aligned poses do. "
    "What is drawn twice before should be drawn once after."
)


def _figure(width_in: float, height_in: float) -> Any:  # noqa: ANN401 untyped
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(width_in, height_in), dpi=DPI, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _styled(axes: Any, title: str, x: str, y: str) -> None:  # noqa: ANN401
    axes.set_title(title, color=INK, fontsize=12, loc="left")
    axes.set_xlabel(x, color=INK, fontsize=11)
    axes.set_ylabel(y, color=INK, fontsize=11)
    axes.tick_params(labelsize=10)
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.grid(visible=True, color=INK, alpha=0.12, linewidth=0.6)


def _legend(axes: Any, columns: int = 1) -> None:  # noqa: ANN401
    if axes.get_legend_handles_labels()[1]:
        axes.legend(fontsize=10, ncols=columns, loc="upper left", bbox_to_anchor=(1.01, 1.0))


def _trajectory_figure(alignment: Alignment) -> Any:  # noqa: ANN401
    tracks = [
        (compose(dive.frame, dive.track.planar), dive.poses_at(dive.track.t_ns))
        for dive in alignment.dives
    ]
    points_m = np.concatenate([some[:, :2] for both in tracks for some in both])
    width_m, height_m = np.maximum(np.ptp(points_m, axis=0), 1.0).tolist()
    figure = _figure(10.0, float(np.clip(1.5 + 7.5 * height_m / width_m, 4.0, 9.0)))
    axes = figure.add_subplot()
    several = len(alignment.dives) > 1
    for k, (dive, (before, after)) in enumerate(zip(alignment.dives, tracks, strict=True)):
        colour = DIVE_COLOURS[k % len(DIVE_COLOURS)]
        name = f", {dive.name}" if several else ""
        style = {"color": GREY if not several else colour, "linewidth": 1.2, "linestyle": "--"}
        axes.plot(before[:, 0], before[:, 1], label=f"odometry{name}", **style)
        axes.plot(after[:, 0], after[:, 1], color=colour, linewidth=1.8, label=f"aligned{name}")
        marks = (("o", 0, "start"), ("s", -1, "end"))
        for mark, place, text in marks:
            label = text if k == 0 else None
            axes.plot(
                *after[place, :2],
                mark,
                markersize=9,
                markerfacecolor=PAPER if text == "start" else INK,
                markeredgecolor=INK,
                label=label,
                linestyle="none",
                zorder=5,
            )
    revisit: str | None = "accepted revisit"
    used = [loop for loop in alignment.loops if loop.accepted and not loop.neighbours]
    opaque = float(np.clip(MANY_LOOPS / max(len(used), 1), 0.3, 1.0))
    for loop in used:
        ends = [one.poses[k, :2] for one, k in (_node(alignment, n) for n in (loop.i, loop.j))]
        x, y = np.transpose(ends)
        axes.plot(x, y, color=PURPLE, linewidth=0.7, alpha=opaque, label=revisit, zorder=1)
        revisit = None
    axes.set_aspect("equal", adjustable="datalim")
    _styled(axes, "Trajectory from above", "x east [m]", "y north [m]")
    _legend(axes)
    return figure


def _offsets_s(alignment: Alignment) -> list[float]:
    """Where each dive begins if dives follow each other without pauses."""
    spans = [float(dive.track.t_ns[-1] - dive.track.t_ns[0]) / NS for dive in alignment.dives]
    return [sum(spans[:k]) for k in range(len(spans))]


def _minutes(alignment: Alignment, t_ns: Times, place: int) -> Floats:
    dive = alignment.dives[place]
    within_s = (t_ns - dive.track.t_ns[0]) / NS
    return np.asarray((within_s + _offsets_s(alignment)[place]) / 60)


def _time_label(alignment: Alignment) -> str:
    several = ", dive after dive" if len(alignment.dives) > 1 else ""
    return f"time from the start{several} [min]"


def _divide(axes: Any, alignment: Alignment, *, both: bool = False) -> None:  # noqa: ANN401
    """Mark where dives begin, and name them."""
    if len(alignment.dives) == 1:
        return
    ends = [*_offsets_s(alignment), sum(_spans_s(alignment))]
    for k, dive in enumerate(alignment.dives):
        begin, middle = ends[k] / 60, (ends[k] + ends[k + 1]) / 120
        if k:
            axes.axvline(begin, color=INK, linewidth=0.8)
            if both:
                axes.axhline(begin, color=INK, linewidth=0.8)
        place = axes.get_xaxis_transform()
        axes.text(
            middle, 0.98, dive.name, transform=place, ha="center", va="top", fontsize=10, color=INK
        )


def _spans_s(alignment: Alignment) -> list[float]:
    return [float(dive.track.t_ns[-1] - dive.track.t_ns[0]) / NS for dive in alignment.dives]


def _correction_figure(alignment: Alignment) -> Any:  # noqa: ANN401
    figure = _figure(10.0, 7.5)
    above, below = figure.subplots(2, 1, sharex=True)
    for k, dive in enumerate(alignment.dives):
        t_ns = dive.track.t_ns
        minutes = _minutes(alignment, t_ns, k)
        shift_m, _ = _correction_of(dive, dive.track.planar, dive.poses_at(t_ns))
        label = "aligned" if k == 0 else None
        above.plot(minutes, shift_m, color=BLUE, linewidth=1.6)
        below.plot(minutes, _deviation_m(_covariance_at(dive, t_ns)), color=BLUE, label=label)
        stated = "odometry, as it states" if k == 0 else None
        below.plot(minutes, dive.track.deviation_m, color=GREY, linestyle="--", label=stated)
    _styled(above, "Correction", "", "horizontal correction [m]")
    _styled(below, "Uncertainty", _time_label(alignment), "standard deviation [m]")
    for axes in (above, below):
        top = axes.get_ylim()[1]
        axes.set_ylim(0.0, 1.12 * max(top, 1e-3))
        _divide(axes, alignment)
    _legend(below)
    return figure


def _loops_figure(alignment: Alignment, record: AlignmentRecord) -> Any:  # noqa: ANN401
    figure = _figure(9.0, 7.0)
    axes = figure.add_subplot()
    place = {dive.name: k for k, dive in enumerate(alignment.dives)}
    kinds = ((True, "o", GREEN, "accepted"), (False, "x", VERMILION, "refused"))
    for accepted, mark, colour, name in kinds:
        chosen = [one for one in record.loops if not one.neighbours and one.accepted == accepted]
        times = [
            sorted(
                float(_minutes(alignment, np.array([round(t * NS)]), place[dive])[0])
                for dive, t in zip(one.dives, one.time_s, strict=True)
            )
            for one in chosen
        ]
        early, late = np.array(times).reshape(-1, 2).T
        axes.plot(early, late, mark, color=colour, label=f"{name} ({len(chosen)})", markersize=7)
    whole = sum(_spans_s(alignment)) / 60
    axes.plot([0, whole], [0, whole], color=GREY, linewidth=0.8)
    axes.set_xlim(0, whole)
    axes.set_ylim(0, 1.06 * whole)
    label = _time_label(alignment)
    _styled(axes, "Revisits by time", f"earlier submap: {label}", f"later submap: {label}")
    _divide(axes, alignment, both=True)
    _legend(axes)
    return figure


def _residuals_figure(record: AlignmentRecord) -> Any:  # noqa: ANN401
    figure = _figure(10.0, 4.5)
    left, right = figure.subplots(1, 2)
    used = [loop for loop in record.loops if loop.accepted]
    kinds = ((False, GREEN, "revisits"), (True, GREY, "submaps that follow each other"))
    for axes, field in ((left, "residual_m"), (right, "residual_deg")):
        values = [[getattr(one, field) for one in used if one.neighbours == n] for n, *_ in kinds]
        most = max((max(some) for some in values if some), default=1.0)
        bins = np.linspace(0.0, max(most, 1e-6), 21)
        labels = [f"{name} ({len(v)})" for (_, _, name), v in zip(kinds, values, strict=True)]
        axes.hist(values, bins=bins, stacked=True, color=[c for _, c, _ in kinds], label=labels)
        axes.yaxis.get_major_locator().set_params(integer=True)
    _styled(left, "Residuals, position", "distance [m]", "accepted registrations")
    _styled(right, "Residuals, heading", "angle [deg]", "accepted registrations")
    right.legend(fontsize=10, loc="upper right")
    return figure


def _map_figure(maps: MapPair) -> Any:  # noqa: ANN401
    views = [project(v, maps.resolution_m, [(0, 1)])[0] for v in (maps.before, maps.after)]
    boxes = np.array([view.extent_m for view in views])
    left, bottom = boxes[:, [0, 2]].min(axis=0)
    right, top = boxes[:, [1, 3]].max(axis=0)
    beside = (top - bottom) > (right - left) / MAX_COLUMN_RATIO
    share = float(np.clip((top - bottom) / (right - left), 0.25, 3.0))
    size_in = (13.0, min(1.5 + 5.2 * share, 12.0)) if beside else (10.0, 1.8 + 15 * share)
    figure = _figure(*size_in)
    rows, columns = (1, 2) if beside else (2, 1)
    every = figure.subplots(rows, columns, sharex=True, sharey=True)
    heights = np.concatenate([maps.before.centres_m[:, 2], maps.after.centres_m[:, 2]])
    limits = np.quantile(heights, [0.01, 0.99]).tolist()
    for axes, view, title in zip(every, views, ("Before: odometry", "After: aligned"), strict=True):
        image = _show(axes, view, limits)
        bottom_row = beside or axes is every[-1]
        _styled(axes, title, "x east [m]" if bottom_row else "", "y north [m]")
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
    bar = figure.colorbar(image, ax=list(every), shrink=0.8)
    bar.set_label("height z of the highest voxel [m]", fontsize=11)
    bar.ax.tick_params(labelsize=10)
    return figure


def _show(axes: Any, view: MapProjection, limits: Sequence[float]) -> Any:  # noqa: ANN401
    axes.set_facecolor(WATER)
    return axes.imshow(
        view.height_m,
        origin="lower",
        extent=view.extent_m,
        interpolation="nearest",
        interpolation_stage="data",
        cmap="viridis",
        vmin=limits[0],
        vmax=limits[1],
    )


TABLE_HEADER = (
    "dive",
    "duration, min",
    "correction RMS / max, m",
    "heading max, deg",
    "scale, %",
    "crab, deg",
    "turn, deg/min",
    "standard deviation mean / max, m",
)
TABLE_TEXT = (
    "Scale, crab and turn are medians of the drift that was found. The standard deviation is "
    "horizontal: the root of the sum of the variances of x and y."
)


def _page(record: AlignmentRecord, pictures: Sequence[tuple[str, str]]) -> str:
    """The report in Markdown."""
    lines = ["# Alignment", "", f"**{record.verdict[0].upper()}{record.verdict[1:]}.**", ""]
    if not record.corrected:
        lines += ["The trajectories are the odometry.", ""]
    counts = f"{record.revisits_accepted} revisits accepted, {record.revisits_refused} refused"
    lines += [f"{counts}; {record.pairs_tried} comparisons of submaps.", ""]
    if record.pairs_rejected:
        rejected = ", ".join(f"{why} {count}" for why, count in record.pairs_rejected.items())
        lines += [f"Comparisons without a registration: {rejected}.", ""]
    lines += [f"| {' | '.join(TABLE_HEADER)} |", f"|{'---|' * len(TABLE_HEADER)}"]
    lines += [*(_row(dive) for dive in record.dives), "", TABLE_TEXT, ""]
    if record.figures:
        lines += ["| figure | value |", "|---|---|"]
        lines += [f"| `{name}` | {value:.3g} |" for name, value in record.figures.items()]
        lines.append("")
    for name, text in pictures:
        lines += [f"![{text}]({name})", "", text, ""]
    return "\n".join(lines)


def _row(dive: AlignedDiveRecord) -> str:
    cells = (
        dive.name,
        f"{(dive.end_s - dive.begin_s) / 60:.1f}",
        f"{dive.correction_rms_m:.2f} / {dive.correction_max_m:.2f}",
        f"{dive.correction_max_deg:.1f}",
        f"{dive.drift_scale_percent:+.1f}",
        f"{dive.drift_crab_deg:+.1f}",
        f"{dive.drift_turn_deg_per_min:+.1f}",
        f"{dive.deviation_mean_m:.2f} / {dive.deviation_max_m:.2f}",
    )
    return f"| {' | '.join(cells)} |"
