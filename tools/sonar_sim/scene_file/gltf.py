"""Read the triangles of glTF 2.0 (.gltf, .glb): nodes at their places, with their materials' names.

Colours, textures, cameras, lights and animations are ignored. Geometry that cannot be read, such as
compressed or skinned meshes, is an error: no part of a file is lost silently.

Source: Khronos Group, glTF 2.0 Specification (ISO/IEC 12113:2022), and its registered extensions.
"""

import base64
import binascii
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeVar
from urllib.parse import unquote, urlsplit

import msgspec
import numpy as np
from numpy.typing import NDArray

from sonar_sim.errors import SceneError
from sonar_sim.geometry.pose import rotation_of_quaternion

Floats = NDArray[np.float64]
MAX_VALUES = 100_000_000
"""Of all accessors that are read; a file may claim more than a machine holds."""
POSITION = "POSITION"
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "EXT_lights_")
"""Beginnings of extensions that leave geometry as it is."""
READ = ("KHR_mesh_quantization",)
"""Extensions of geometry that are read."""
COMPONENTS: Mapping[int, type[np.number[Any]]] = MappingProxyType(
    {
        5120: np.int8,
        5121: np.uint8,
        5122: np.int16,
        5123: np.uint16,
        5125: np.uint32,
        5126: np.float32,
    }
)
"""dtype by the number of a component's type (3.6.2.2 Accessor Data Types)."""
WIDTHS = MappingProxyType({"SCALAR": 1, "VEC3": 3})
TRIANGLES, STRIP, FAN = 4, 5, 6
_Index = Annotated[int, msgspec.Meta(ge=0)]
_Item = TypeVar("_Item")


class _Struct(msgspec.Struct, rename="camel"):
    pass


class _GltfNode(_Struct):
    name: str = ""
    children: list[_Index] = []
    mesh: _Index | None = None
    skin: _Index | None = None
    matrix: Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)] | None = None
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    weights: list[float] = []
    extensions: dict[str, Any] = {}

    def transform(self) -> Floats:
        """Parent's frame from the node's, (4, 4)."""
        if self.matrix is not None:
            return np.array(self.matrix).reshape(4, 4).T  # by columns in the file
        transform = np.eye(4)
        x, y, z, w = self.rotation
        transform[:3, :3] = rotation_of_quaternion(np.array([w, x, y, z])) * self.scale
        transform[:3, 3] = self.translation
        return transform


class _Primitive(_Struct):
    attributes: dict[str, _Index]
    indices: _Index | None = None
    material: _Index | None = None
    mode: int = TRIANGLES
    extensions: dict[str, Any] = {}


class _GltfMesh(_Struct):
    primitives: list[_Primitive]
    name: str = ""
    weights: list[float] = []


class _Elements(_Struct):
    """Where a sparse accessor's indices or values are."""

    buffer_view: _Index
    byte_offset: _Index = 0
    component_type: int = 0


class _Sparse(_Struct):
    count: _Index
    indices: _Elements
    values: _Elements


class _Accessor(_Struct):
    component_type: int
    count: _Index
    type: str
    buffer_view: _Index | None = None
    byte_offset: _Index = 0
    normalized: bool = False
    sparse: _Sparse | None = None


class _View(_Struct):
    buffer: _Index
    byte_length: _Index
    byte_offset: _Index = 0
    byte_stride: _Index | None = None


class _Buffer(_Struct):
    byte_length: _Index
    uri: str | None = None


class _Named(_Struct):
    name: str = ""


class _GltfScene(_Struct):
    nodes: list[_Index] = []


class _Gltf(_Struct):
    asset: dict[str, Any]
    nodes: list[_GltfNode] = []
    meshes: list[_GltfMesh] = []
    accessors: list[_Accessor] = []
    buffer_views: list[_View] = []
    buffers: list[_Buffer] = []
    materials: list[_Named] = []
    scenes: list[_GltfScene] = []
    scene: _Index = 0
    extensions_required: list[str] = []


def read_gltf(path: Path) -> Iterator[tuple[str, str, Floats, NDArray[np.int64]]]:
    """Read all triangles of a file's scene, in the order of its nodes.

    Returns:
        For each primitive the node's name, or else the mesh's; the material's name; vertices (V, 3)
        in the scene's frame, y up, in metres; and faces (F, 3), seen from outside counterclockwise.

    Raises:
        SceneError: not glTF 2.0, or with geometry that is not read.
    """
    document = _Document(path)
    for node, transform in document.placed_nodes():
        mesh = document.item(document.root.meshes, node.mesh, "mesh")
        where = f"{path}: node {node.name or mesh.name!r}"
        if node.skin is not None or any(node.weights or mesh.weights):
            raise SceneError(f"{where}: its skin or morph targets are not read: apply them first")
        for primitive in mesh.primitives:
            has_positions = POSITION in primitive.attributes
            if primitive.mode not in (TRIANGLES, STRIP, FAN) or not has_positions:
                continue  # points and lines, and what the specification says to skip
            vertices = document.positions(primitive, where)
            faces = document.faces(primitive, len(vertices))
            if not np.all((faces >= 0) & (faces < len(vertices))):
                raise SceneError(f"{where}: a triangle names a vertex that does not exist")
            used, corners = np.unique(faces, return_inverse=True)
            vertices, faces = vertices[used], corners.reshape(-1, 3)
            if np.linalg.det(transform[:3, :3]) < 0.0:
                faces = faces[:, ::-1]
            named = _Named()
            if primitive.material is not None:
                named = document.item(document.root.materials, primitive.material, "material")
            placed = vertices @ transform[:3, :3].T + transform[:3, 3]
            yield node.name or mesh.name, named.name, placed, faces


class _Document:
    """One file and its buffers."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._buffers: dict[int, bytes] = {}
        self._values_left = MAX_VALUES
        data = path.read_bytes()
        text, self._chunk = self._chunks(data) if data[:4] == b"glTF" else (data, None)
        try:
            self.root = msgspec.json.decode(text, type=_Gltf)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise SceneError(f"{path}: not glTF: {error}") from error
        if not str(self.root.asset.get("version", "")).startswith("2."):
            raise SceneError(f"{path}: only version 2 of glTF is read")
        for name in self.root.extensions_required:
            if name not in READ and not name.startswith(HARMLESS):
                raise SceneError(f"{path}: needs {name}, which is not read: export it without")

    def item(self, items: Sequence[_Item], index: int | None, what: str) -> _Item:
        """Return one of a list by its index in the file."""
        if index is None or index >= len(items):
            raise SceneError(f"{self._path}: there is no {what} {index}; it has {len(items)}")
        return items[index]

    def placed_nodes(self) -> Iterator[tuple[_GltfNode, Floats]]:
        """All nodes of the scene that have a mesh, each with its frame in the scene's."""
        nodes = self.root.nodes
        if self.root.scenes:
            roots = self.item(self.root.scenes, self.root.scene, "scene").nodes
        else:
            roots = sorted(set(range(len(nodes))) - {k for one in nodes for k in one.children})
        seen: set[int] = set()
        waiting = [(index, np.eye(4)) for index in reversed(roots)]
        while waiting:
            index, above = waiting.pop()
            node = self.item(nodes, index, "node")
            if index in seen:
                raise SceneError(f"{self._path}: node {index} is a child twice, or of itself")
            seen.add(index)
            if "EXT_mesh_gpu_instancing" in node.extensions:
                raise SceneError(
                    f"{self._path}: node {node.name!r}: EXT_mesh_gpu_instancing is not read: "
                    "export its copies as nodes"
                )
            try:
                transform = above @ node.transform()
            except ValueError as error:
                raise SceneError(f"{self._path}: node {node.name!r}: {error}") from error
            if node.mesh is not None:
                yield node, transform
            waiting += [(child, transform) for child in reversed(node.children)]

    def positions(self, primitive: _Primitive, where: str) -> Floats:
        """Vertices of a primitive, (V, 3)."""
        accessor = self.item(self.root.accessors, primitive.attributes[POSITION], "accessor")
        if accessor.buffer_view is None and accessor.sparse is None:
            how = f" ({', '.join(primitive.extensions)})" if primitive.extensions else ""
            raise SceneError(
                f"{where}: its vertices are compressed or missing{how}: export it plain"
            )
        return self._values(accessor, "VEC3").astype(np.float64)

    def faces(self, primitive: _Primitive, vertices: int) -> NDArray[np.int64]:
        """Triangles of a primitive, (F, 3) (3.7.2.1 Topology Types)."""
        order = np.arange(vertices)
        if primitive.indices is not None:
            accessor = self.item(self.root.accessors, primitive.indices, "accessor")
            order = self._values(accessor, "SCALAR")[:, 0].astype(np.int64)
        if primitive.mode == TRIANGLES:
            return order[: len(order) // 3 * 3].reshape(-1, 3)
        if primitive.mode == FAN:
            return np.stack([order[1:-1], order[2:], order[:1].repeat(max(len(order) - 2, 0))], 1)
        k = np.arange(max(len(order) - 2, 0))
        return np.stack([order[k], order[k + 1 + k % 2], order[k + 2 - k % 2]], 1)

    def _values(self, accessor: _Accessor, kind: str) -> NDArray[Any]:
        """Return the numbers of an accessor, (count, width)."""
        if accessor.type != kind or accessor.component_type not in COMPONENTS:
            raise SceneError(
                f"{self._path}: an accessor of {accessor.type} and type {accessor.component_type} "
                f"stands for {kind}"
            )
        dtype, width = np.dtype(COMPONENTS[accessor.component_type]), WIDTHS[kind]
        self._values_left -= accessor.count * width
        if self._values_left < 0:
            raise SceneError(f"{self._path}: its accessors claim more than {MAX_VALUES} numbers")
        if accessor.buffer_view is None and accessor.sparse is None:
            raise SceneError(f"{self._path}: an accessor has no data")
        values = np.zeros((accessor.count, width), dtype)
        if accessor.buffer_view is not None:
            at = _Elements(accessor.buffer_view, accessor.byte_offset)
            values = self._elements(at, dtype, accessor.count, width)
        if accessor.sparse is not None:
            sparse = accessor.sparse
            if sparse.indices.component_type not in COMPONENTS:
                raise SceneError(f"{self._path}: indices of a sparse accessor have no type")
            index_type = np.dtype(COMPONENTS[sparse.indices.component_type])
            places = self._elements(sparse.indices, index_type, sparse.count, 1)[:, 0]
            if not np.all((places >= 0) & (places < accessor.count)):
                raise SceneError(f"{self._path}: a sparse accessor replaces what it does not have")
            values = values.copy()
            values[places.astype(np.int64)] = self._elements(
                sparse.values, dtype, sparse.count, width
            )
        if accessor.normalized and dtype.kind in "iu":
            return np.maximum(values / float(np.iinfo(dtype).max), -1.0)
        return values

    def _elements(
        self, at: _Elements, dtype: np.dtype[Any], count: int, width: int
    ) -> NDArray[Any]:
        """Return numbers of a buffer view, (count, width)."""
        view = self.item(self.root.buffer_views, at.buffer_view, "buffer view")
        data = self._buffer(view.buffer)
        size = dtype.itemsize * width
        stride = view.byte_stride or size
        end = at.byte_offset + stride * (count - 1) + size if count else 0
        if end > view.byte_length or view.byte_offset + end > len(data):
            raise SceneError(f"{self._path}: buffer view {at.buffer_view} is too short")
        return np.ndarray(
            (count, width),
            dtype.newbyteorder("<"),
            data,
            view.byte_offset + at.byte_offset if count else 0,
            (stride, dtype.itemsize),
        )

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            buffer = self.item(self.root.buffers, index, "buffer")
            data = self._loaded(buffer.uri, index)
            if len(data) < buffer.byte_length:
                raise SceneError(
                    f"{self._path}: buffer {index} has {len(data)} of {buffer.byte_length} bytes"
                )
            self._buffers[index] = data
        return self._buffers[index]

    def _loaded(self, uri: str | None, index: int) -> bytes:
        if uri is None:
            if self._chunk is None or index:
                raise SceneError(f"{self._path}: buffer {index} has no data")
            return self._chunk
        try:
            if uri.startswith("data:"):
                return base64.b64decode(uri.partition(",")[2], validate=True)
            file = self._path.parent / unquote(uri)
            if urlsplit(uri).scheme or not file.is_file():
                raise SceneError(f"{self._path}: there is no file {uri!r} beside it")
            return file.read_bytes()
        except (OSError, ValueError, binascii.Error) as error:
            raise SceneError(f"{self._path}: buffer {index} cannot be read: {error}") from error

    def _chunks(self, data: bytes) -> tuple[bytes, bytes | None]:
        """Return the JSON and the binary chunk of a GLB file (4.4 Binary glTF Layout)."""
        chunks: dict[int, bytes] = {}
        try:
            _, version, length = struct.unpack_from("<3I", data)
            at = 12
            while at < min(length, len(data)):
                size, kind = struct.unpack_from("<2I", data, at)
                chunks.setdefault(kind, data[at + 8 : at + 8 + size])
                at += 8 + size
        except struct.error as error:
            raise SceneError(f"{self._path}: not glTF: it is cut off") from error
        if version != 2 or length > len(data) or JSON_CHUNK not in chunks:  # noqa: PLR2004 glTF 2
            raise SceneError(f"{self._path}: not glTF 2, or cut off")
        return chunks[JSON_CHUNK], chunks.get(BINARY_CHUNK)
