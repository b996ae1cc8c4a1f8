"""The map in the browser: a node of the scene for each chunk that shows something."""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.client.mirror import MapMirror
from mapperd.viewer.chunks import Chunk, Chunks, ChunkSurface, Filter, coarser, drawn_of
from mapperd.viewer.colours import Scale, colours_of, linear, shaded, values_of
from mapperd.viewer.shapes import Nodes, cube

if TYPE_CHECKING:
    from viser import SceneApi

__all__ = ["MapLayer", "MapStyle"]

MAX_NODES = 1500
MAX_CUBES = 120_000
"""Above this number cells are drawn as points, because browsers transform each cube."""

MAX_FINE = 300_000
"""Above this number distant cells are drawn as larger cubes, so that browsers stay responsive."""

FAR_M = ((20.0, 2), (60.0, 4))
"""Distances of chunks, and how many cells along an edge are drawn as one beyond them."""

SLACK = 1.15
"""Hysteresis of the distances."""

POINT_RADIUS = 0.58
"""Point size in cells: slightly larger than a cell, so that there are no holes."""

POINT_BYTES, CUBE_BYTES = 9, 31
"""Bytes sent to the browser for each."""

Shape = Literal["auto", "cubes", "points"]


@dataclass(frozen=True, slots=True)
class MapStyle:
    """How the map is drawn.

    Attributes:
        chosen: cells to draw.
        scale: their colours.
        shape: `auto` draws cubes while there are few cells.
        shading: shade points by their normals.
    """

    chosen: Filter
    scale: Scale
    shape: Shape = "auto"
    shading: bool = True


class MapLayer:
    """Draws the cells of a map mirror; use from one thread.

    Args:
        scene: scene of the server.

    Attributes:
        look: how the map is drawn.
        sent_bytes: bytes of the map sent to each browser.
    """

    def __init__(self, scene: "SceneApi", look: MapStyle, max_nodes: int = MAX_NODES) -> None:
        self.look = look
        self.sent_bytes = 0
        self._nodes = Nodes()
        self._chunks = Chunks(max_nodes)
        self._drawn: dict[Chunk, ChunkSurface] = {}
        self._fine: dict[Chunk, int] = {}
        self._factor: dict[Chunk, int] = {}
        self._many = False
        self._cubes = look.shape != "points"
        self._points_of = partial(
            scene.add_point_cloud, point_size=POINT_RADIUS, point_shading="flat"
        )
        vertices, faces = cube()
        self._cubes_of = partial(
            scene.add_batched_meshes_simple,
            vertices=vertices,
            faces=faces,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    @property
    def stale(self) -> int:
        """Number of chunks to draw."""
        return self._chunks.stale

    @property
    def nodes(self) -> int:
        """Number of chunks in the browser."""
        return len(self._drawn)

    @property
    def cells(self) -> int:
        """Number of cells in the browser."""
        return sum(map(len, self._drawn.values()))

    @property
    def drawn(self) -> list[ChunkSurface]:
        """Chunks that the browser shows."""
        return list(self._drawn.values())

    @property
    def bounds_m(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Corners of the bounding box of all cell centres, (3,), (3,); None without cells."""
        if not self._drawn:
            return None
        parts = self._drawn.values()
        low = [one.origin_m + one.local.min(axis=0) * one.cell_m for one in parts]
        high = [one.origin_m + one.local.max(axis=0) * one.cell_m for one in parts]
        return np.min(low, axis=0), np.max(high, axis=0)

    def forget(self) -> None:
        """Remove the map."""
        self._chunks.forget()
        self._nodes.clear()
        self._clear()

    def touch(self, keys: ArrayLike) -> None:
        """Mark blocks (N, 3) as changed."""
        self._chunks.touch(keys)

    def change(self, look: MapStyle) -> None:
        """Change how the map is drawn."""
        if look != self.look:
            self.look = look
            self._choose_shape()
            self._chunks.touch_all()

    def grow_older(self) -> None:
        """Redraw if colours show ages."""
        if self.look.scale.mode == "age":
            self._chunks.touch_some(self._drawn)

    def refine(self, near_m: ArrayLike, cell_m: float) -> None:
        """Redraw chunks whose distance to the vehicle (3,) calls for another level of detail.

        In maps of many cells, distant cells are drawn as larger cubes.
        """
        self._many = sum(self._fine.values()) > MAX_FINE
        if not self._drawn:
            return
        chunks = list(self._drawn)
        away_m = self._away_m(np.array(chunks), near_m, cell_m)
        now = np.array([self._factor[chunk] for chunk in chunks])
        least, most = self._factors(away_m / SLACK), self._factors(away_m * SLACK)
        self._chunks.touch_some(chunks[k] for k in np.flatnonzero((now < least) | (now > most)))

    def draw(
        self, mirror: MapMirror, near_m: ArrayLike, now_ns: int, max_bytes: int, max_chunks: int
    ) -> int:
        """Send changed chunks, nearest first, up to a limit.

        Args:
            mirror: the map.
            near_m: (3,) position of the vehicle, map frame.
            now_ns: time that ages are counted from.
            max_bytes: start no chunk beyond this size.
            max_chunks: maximum number of chunks.

        Returns:
            Bytes sent to each browser.
        """
        sent = 0
        for chunk in self._chunks.take(near_m, mirror.cell_m, max_chunks):
            if sent > max_bytes:
                self._chunks.touch_some([chunk])
                continue
            drawn = drawn_of(mirror, self._chunks, chunk, self.look.chosen)
            self._fine[chunk] = len(drawn)
            away_m = self._away_m(np.array([chunk]), near_m, drawn.cell_m)
            factor = self._factor[chunk] = int(self._factors(away_m)[0])
            sent += self._show(chunk, coarser(drawn, factor), now_ns)
        if self._chunks.crowded:
            self._chunks.grow()
            self._nodes.replace_all()
            self._clear()
        self._choose_shape()
        self.sent_bytes += sent
        return sent

    def tidy(self) -> None:
        """Remove replaced nodes; call after each round of `draw`."""
        self._nodes.look(complete=self.stale == 0)

    def _away_m(
        self, chunks: NDArray[np.int64], near_m: ArrayLike, cell_m: float
    ) -> NDArray[np.float64]:
        """Distances from a position to the centres of chunks (N, 3)."""
        middles = (chunks + 0.5) * (self._chunks.edge * cell_m)
        return np.asarray(np.linalg.norm(middles - np.asarray(near_m), axis=1))

    def _factors(self, away_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """Number of cells along an edge that are drawn as one at these distances."""
        factors = np.ones(len(away_m), np.int64)
        if self._many:
            for far_m, factor in FAR_M:
                factors[away_m > far_m] = factor
        return factors

    def _choose_shape(self) -> None:
        """Choose cubes or points, with hysteresis."""
        limit = MAX_CUBES if self._cubes else MAX_CUBES * 3 // 4
        cubes = self.look.shape == "cubes" or (self.look.shape == "auto" and self.cells <= limit)
        if cubes != self._cubes:
            self._cubes = cubes
            self._chunks.touch_all()

    def _show(self, chunk: Chunk, drawn: ChunkSurface, now_ns: int) -> int:
        self._chunks.shows(chunk, something=len(drawn) > 0)
        if len(drawn) == 0:
            self._fine.pop(chunk, None)
            self._drawn.pop(chunk, None)
            self._nodes.remove(self._name(chunk, cubes=True))
            self._nodes.remove(self._name(chunk, cubes=False))
            return 0
        self._drawn[chunk] = drawn
        colours = colours_of(values_of(drawn, self.look.scale.mode, now_ns), self.look.scale)
        half = self._chunks.edge / self._factor[chunk] / 2
        at = drawn.local + np.float32(0.5 - half)
        middle_m = drawn.origin_m + half * drawn.cell_m
        name = self._name(chunk, cubes=self._cubes)
        if self._cubes:
            self._put_cubes(name, at, colours, middle_m, drawn.cell_m)
        else:
            if self.look.shading:
                colours = shaded(colours, drawn.normals)
            self._nodes.put(
                name,
                self._points_of,
                points=at,
                colors=colours,
                scale=drawn.cell_m,
                position=middle_m,
            )
        self._nodes.replace(self._name(chunk, cubes=not self._cubes))
        return (CUBE_BYTES if self._cubes else POINT_BYTES) * len(drawn)

    def _put_cubes(
        self,
        name: str,
        at: NDArray[np.float32],
        colours: NDArray[np.uint8],
        middle_m: NDArray[np.float64],
        cell_m: float,
    ) -> None:
        upright = np.zeros((len(at), 4), np.float32)
        upright[:, 0] = 1
        mixed = linear(colours)
        if name in self._nodes:  # otherwise viser withholds unchanged colours, and a browser that
            # connects later receives more colours than positions
            self._nodes.put(name, self._cubes_of, batched_colors=mixed[0])
        self._nodes.put(
            name,
            self._cubes_of,
            batched_positions=at,
            batched_wxyzs=upright,
            batched_colors=mixed,
            scale=cell_m,
            position=middle_m,
        )

    def _clear(self) -> None:
        self._drawn.clear()
        self._fine.clear()
        self._factor.clear()

    def _name(self, chunk: Chunk, *, cubes: bool) -> str:
        """Node name by kind and size, because both are visible while one replaces the other."""
        kind = "cubes" if cubes else "points"
        return "/map/{}_{}/{}_{}_{}".format(kind, self._chunks.edge, *chunk)
