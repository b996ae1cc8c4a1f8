"""The map in the browser: a node of the scene for each chunk that shows something."""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.client.mirror import MapMirror
from mapperd.viewer.chunks import Chunk, Chunks, Drawn, Filter, coarser, drawn_of
from mapperd.viewer.colours import Scale, colours_of, linear, shaded, values_of
from mapperd.viewer.shapes import Nodes, cube

if TYPE_CHECKING:
    from viser import SceneApi

__all__ = ["Look", "MapView"]

MAX_NODES = 1500
MAX_CUBES = 120_000
"""Beyond it cells are drawn as points: a browser turns each cube by itself."""

MAX_FINE = 300_000
"""Beyond it cells far from the vehicle are drawn in larger cubes: browsers stay quick."""

FAR_M = ((20.0, 2), (60.0, 4))
"""From this distance on, of chunks, so many cells along an edge are one."""

SLACK = 1.15
"""On the distance, so that nothing goes to and fro."""

POINT_RADIUS = 0.58
"""Of a cell: points a little wider than cells leave no holes; viser's size is half of that."""

POINT_BYTES, CUBE_BYTES = 9, 31
"""What the browser is sent for each."""

Shape = Literal["auto", "cubes", "points"]


@dataclass(frozen=True, slots=True)
class Look:
    """How the map is drawn.

    Attributes:
        chosen: which cells.
        scale: their colours.
        shape: `auto` draws cubes while there are few.
        shading: points look as if light fell on them.
    """

    chosen: Filter
    scale: Scale
    shape: Shape = "auto"
    shading: bool = True


class MapView:
    """Draws a mirror's cells; of one thread.

    Args:
        scene: of the server.

    Attributes:
        look: how.
        sent_bytes: all that browsers were told of the map, each.
    """

    def __init__(self, scene: "SceneApi", look: Look, most_nodes: int = MAX_NODES) -> None:
        self.look = look
        self.sent_bytes = 0
        self._nodes = Nodes()
        self._chunks = Chunks(most_nodes)
        self._drawn: dict[Chunk, Drawn] = {}
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
        """Chunks that wait to be drawn."""
        return self._chunks.stale

    @property
    def nodes(self) -> int:
        """Chunks that the browser has."""
        return len(self._drawn)

    @property
    def cells(self) -> int:
        """Cells that the browser has."""
        return sum(map(len, self._drawn.values()))

    @property
    def drawn(self) -> list[Drawn]:
        """What the browser shows."""
        return list(self._drawn.values())

    @property
    def bounds_m(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Corners of a box around the middles of all cells, (3,), (3,); None without any."""
        if not self._drawn:
            return None
        parts = self._drawn.values()
        low = [one.origin_m + one.local.min(axis=0) * one.cell_m for one in parts]
        high = [one.origin_m + one.local.max(axis=0) * one.cell_m for one in parts]
        return np.min(low, axis=0), np.max(high, axis=0)

    def forget(self) -> None:
        """There is no map any more."""
        self._chunks.forget()
        self._nodes.clear()
        self._clear()

    def touch(self, keys: ArrayLike) -> None:
        """Blocks (N, 3) changed."""
        self._chunks.touch(keys)

    def change(self, look: Look) -> None:
        """Draw otherwise from now on."""
        if look != self.look:
            self.look = look
            self._choose_shape()
            self._chunks.touch_all()

    def grow_older(self) -> None:
        """Colours that tell ages are wrong by now."""
        if self.look.scale.mode == "age":
            self._chunks.touch_some(self._drawn)

    def refine(self, near_m: ArrayLike, cell_m: float) -> None:
        """Chunks to which the vehicle came near, or from which it went, are to be drawn again.

        Of a map of many cells, those far from a place (3,) are drawn in larger cubes.
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
        self, mirror: MapMirror, near_m: ArrayLike, now_ns: int, most_bytes: int, most_chunks: int
    ) -> int:
        """Send what changed, nearest first, until so much is sent.

        Args:
            mirror: of the map.
            near_m: (3,) where the vehicle is, map frame.
            now_ns: the map's time: ages are counted from it.
            most_bytes: after which no more chunks are begun.
            most_chunks: that are looked at.

        Returns:
            Bytes that each browser is sent.
        """
        sent = 0
        for chunk in self._chunks.take(near_m, mirror.cell_m, most_chunks):
            if sent > most_bytes:
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
        """Remove what browsers no longer need; after each round of `draw`."""
        self._nodes.look(complete=self.stale == 0)

    def _away_m(
        self, chunks: NDArray[np.int64], near_m: ArrayLike, cell_m: float
    ) -> NDArray[np.float64]:
        """From a place to the middles of chunks (N, 3)."""
        middles = (chunks + 0.5) * (self._chunks.edge * cell_m)
        return np.asarray(np.linalg.norm(middles - np.asarray(near_m), axis=1))

    def _factors(self, away_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """How many cells along an edge are drawn as one at these distances."""
        factors = np.ones(len(away_m), np.int64)
        if self._many:
            for far_m, factor in FAR_M:
                factors[away_m > far_m] = factor
        return factors

    def _choose_shape(self) -> None:
        """Cubes or points; with slack, so that it does not go to and fro."""
        limit = MAX_CUBES if self._cubes else MAX_CUBES * 3 // 4
        cubes = self.look.shape == "cubes" or (self.look.shape == "auto" and self.cells <= limit)
        if cubes != self._cubes:
            self._cubes = cubes
            self._chunks.touch_all()

    def _show(self, chunk: Chunk, drawn: Drawn, now_ns: int) -> int:
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
        if name in self._nodes:  # else viser keeps back colours that are the same as before, and
            # a browser that comes late is told them before the places, of which it needs as many
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
        """Of one kind and size: they are in sight together while one replaces the other."""
        kind = "cubes" if cubes else "points"
        return "/map/{}_{}/{}_{}_{}".format(kind, self._chunks.edge, *chunk)
