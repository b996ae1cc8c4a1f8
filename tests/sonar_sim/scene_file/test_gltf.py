"""glTF built by hand, to the letter of its specification."""

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from sonar_sim.errors import SceneError
from sonar_sim.scene_file.mesh_files import NamedMesh, read_parts

BOX: Any = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
POINTS = np.asarray(BOX.vertices, dtype=np.float32)
FACES = np.asarray(BOX.faces, dtype=np.uint16)
FLOAT, USHORT, SHORT = 5126, 5123, 5122


class Builder:
    """A document of one box, of which a test changes what it is about."""

    def __init__(self) -> None:
        self.data = b""
        self.root: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "buffers": [{}],
            "bufferViews": [],
            "accessors": [],
            "materials": [{"name": "wood"}],
            "meshes": [{"name": "box", "primitives": []}],
            "nodes": [{"name": "hull", "mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }

    def view(self, array: np.ndarray, **fields: int) -> int:
        """Add bytes to the buffer, from a multiple of 4."""
        self.data += b"\0" * (-len(self.data) % 4)
        at = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.data += array.tobytes()
        self.root["bufferViews"].append(at | fields)
        return len(self.root["bufferViews"]) - 1

    def accessor(self, view: int | None, kind: int, shape: tuple[int, str], **fields: Any) -> int:
        accessor = {"componentType": kind, "count": shape[0], "type": shape[1]} | fields
        self.root["accessors"].append(accessor | ({} if view is None else {"bufferView": view}))
        return len(self.root["accessors"]) - 1

    def primitive(self, position: int, indices: int | None = None, **fields: Any) -> None:
        one = {"attributes": {"POSITION": position}, "material": 0} | fields
        self.root["meshes"][0]["primitives"].append(
            one if indices is None else one | {"indices": indices}
        )

    def box(self) -> None:
        position = self.accessor(self.view(POINTS), FLOAT, (8, "VEC3"))
        self.primitive(position, self.accessor(self.view(FACES), USHORT, (36, "SCALAR")))

    def parts(self, folder: Path, uri: str | None = None) -> list[NamedMesh]:
        """Write the file, and read it with its own z up."""
        data = self.data
        self.root["buffers"][0] = {"byteLength": len(data)}
        if uri is not None:
            self.root["buffers"][0]["uri"] = uri
            (folder / "m.gltf").write_text(json.dumps(self.root))
            return read_parts(folder / "m.gltf", up="z")
        text = json.dumps(self.root).encode()
        text += b" " * (-len(text) % 4)
        data += b"\0" * (-len(data) % 4)
        chunks = struct.pack("<2I", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<2I", len(data), 0x004E4942) + data
        header = struct.pack("<4s2I", b"glTF", 2, 12 + len(chunks))
        (folder / "m.glb").write_bytes(header + chunks)
        return read_parts(folder / "m.glb", up="z")


def is_box(part: NamedMesh) -> bool:
    """Whether it is the box in the origin, its outside out."""
    return (
        np.allclose(part.mesh.bounds, [[-0.5, -1.0, -1.5], [0.5, 1.0, 1.5]], atol=1e-4)
        and bool(part.mesh.is_watertight)
        and part.mesh.volume == pytest.approx(6.0, abs=1e-3)
    )


def interleaved(made: Builder) -> None:
    """Positions between other attributes, each 20 bytes after the one before."""
    table = np.zeros((8, 5), dtype=np.float32)
    table[:, 1:4] = POINTS
    view = made.view(table, byteStride=20)
    position = made.accessor(view, FLOAT, (8, "VEC3"), byteOffset=4)
    made.primitive(position, made.accessor(made.view(FACES), USHORT, (36, "SCALAR")))


def sparse(made: Builder, base: np.ndarray | None) -> None:
    """Positions of which some, or all, are written over."""
    changed = np.arange(8) if base is None else np.arange(4, 8)
    over = {
        "count": len(changed),
        "indices": {
            "bufferView": made.view(changed.astype(np.uint16)),
            "componentType": USHORT,
        },
        "values": {"bufferView": made.view(POINTS[changed])},
    }
    view = None if base is None else made.view(base)
    position = made.accessor(view, FLOAT, (8, "VEC3"), sparse=over)
    made.primitive(position, made.accessor(made.view(FACES), USHORT, (36, "SCALAR")))


def quantized(made: Builder) -> None:
    """Normalized shorts, each vertex padded to 8 bytes, that the node scales."""
    table = np.zeros((8, 4), dtype=np.int16)
    table[:, :3] = np.round(POINTS / 2.0 * 32767)
    view = made.view(table, byteStride=8)
    position = made.accessor(view, SHORT, (8, "VEC3"), normalized=True)
    made.primitive(position, made.accessor(made.view(FACES), USHORT, (36, "SCALAR")))
    made.root["nodes"][0]["scale"] = [2.0, 2.0, 2.0]
    made.root["extensionsRequired"] = ["KHR_mesh_quantization", "KHR_materials_unlit"]


def without_indices(made: Builder) -> None:
    made.primitive(made.accessor(made.view(POINTS[FACES]), FLOAT, (36, "VEC3")))


@pytest.mark.parametrize(
    "build",
    [
        Builder.box,
        interleaved,
        lambda made: sparse(made, None),
        lambda made: sparse(made, np.where(np.arange(8)[:, None] < 4, POINTS, 9.0).astype("f4")),
        quantized,
        without_indices,
    ],
    ids=["plain", "interleaved", "sparse", "sparse over", "quantized", "no indices"],
)
def test_a_box_is_read_however_it_is_stored(tmp_path: Path, build: Callable[[Any], None]) -> None:
    made = Builder()
    build(made)
    (part,) = made.parts(tmp_path)
    assert (part.name, part.material) == ("hull", "wood")
    assert is_box(part)


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("mode", [4, 5, 6])
def test_strips_and_fans_face_one_way(tmp_path: Path, mode: int, *, indexed: bool) -> None:
    ring = np.array([[0, 0, 0], [2, 0, 0], [3, 1, 0], [2, 2, 0], [0, 2, 0], [-1, 1, 0]], "f4")
    orders = {
        4: [0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5],
        5: [0, 1, 5, 2, 4, 3],
        6: [0, 1, 2, 3, 4, 5],
    }
    order = np.array(orders[mode], dtype=np.uint16)
    made = Builder()
    if indexed:
        position = made.accessor(made.view(ring), FLOAT, (6, "VEC3"))
        indices = made.accessor(made.view(order), USHORT, (len(order), "SCALAR"))
        made.primitive(position, indices, mode=mode)
    else:
        points = ring[order]
        made.primitive(made.accessor(made.view(points), FLOAT, (len(points), "VEC3")), mode=mode)
    made.primitive(made.accessor(made.view(ring), FLOAT, (6, "VEC3")), mode=1)  # lines
    (part,) = made.parts(tmp_path)
    assert part.mesh.area == pytest.approx(6.0)
    assert np.allclose(part.mesh.face_normals, [0.0, 0.0, 1.0])


def test_nodes_place_turn_and_mirror_their_meshes(tmp_path: Path) -> None:
    made = Builder()
    made.box()
    half = np.sqrt(0.5)
    columns = np.array([[1, 0, 0, 7], [0, 1, 0, 8], [0, 0, 1, 9], [0, 0, 0, 1]], float).T
    made.root["nodes"] = [
        {"name": "root", "translation": [10, 0, 0], "children": [1, 2]},
        {"name": "turned", "mesh": 0, "rotation": [0, 0, half, half], "translation": [0, 5, 0]},
        {"scale": [-1, 1, 1], "mesh": 0, "children": [3]},
        {"name": "moved", "matrix": columns.ravel().tolist(), "mesh": 0},
        {"name": "of another scene", "mesh": 0},
    ]
    made.root["scenes"] = [{"nodes": [4]}, {"nodes": [0]}]
    made.root["scene"] = 1
    parts = {part.name: part.mesh for part in made.parts(tmp_path)}
    assert set(parts) == {"turned", "box", "moved"}
    assert parts["turned"].bounds == pytest.approx(np.array([[9, 4.5, -1.5], [11, 5.5, 1.5]]))
    assert parts["moved"].centroid == pytest.approx([3.0, 8.0, 9.0])
    for mesh in parts.values():
        assert mesh.volume == pytest.approx(6.0)  # none is inside out


@pytest.mark.parametrize("uri", ["data", "ext data.bin", "ext%20data.bin"])
def test_buffers_are_files_beside_it_or_inside(tmp_path: Path, uri: str) -> None:
    made = Builder()
    made.box()
    (tmp_path / "ext data.bin").write_bytes(made.data)
    if uri == "data":
        uri = "data:application/octet-stream;base64," + base64.b64encode(made.data).decode()
    (part,) = made.parts(tmp_path, uri)
    assert is_box(part)


def test_parts_of_one_node_have_its_name_at_each_reading(tmp_path: Path) -> None:
    made = Builder()
    made.box()
    made.root["materials"].append({})
    made.root["meshes"][0]["primitives"].append(
        made.root["meshes"][0]["primitives"][0] | {"material": 1}
    )
    first, again = made.parts(tmp_path), made.parts(tmp_path)
    assert [(part.name, part.material) for part in first] == [("hull", ""), ("hull", "wood")]
    for one, other in zip(first, again, strict=True):
        assert np.array_equal(one.mesh.triangles, other.mesh.triangles)


def change(*path: str | int, to: object) -> Callable[[Builder], None]:
    """Set a value deep in the document."""

    def apply(made: Builder) -> None:
        at: Any = made.root
        for key in path[:-1]:
            at = at[key]
        at[path[-1]] = to

    return apply


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (change("extensionsRequired", to=["KHR_draco_mesh_compression"]), "needs KHR_draco"),
        (change("extensionsRequired", to=["ACME_gears"]), "needs ACME_gears"),
        (
            change("nodes", 0, "extensions", to={"EXT_mesh_gpu_instancing": {}}),
            "'hull': EXT_mesh_gpu_instancing",
        ),
        (change("nodes", 0, "skin", to=0), "'hull': its skin"),
        (change("meshes", 0, "weights", to=[0.5]), "'hull': its skin or morph"),
        (change("nodes", 0, "children", to=[0]), "node 0 is a child twice"),
        (change("nodes", 0, "mesh", to=3), "there is no mesh 3; it has 1"),
        (change("nodes", 0, "mesh", to=-1), r"\$\.nodes\[0\]\.mesh"),
        (change("nodes", 0, "rotation", to=[0, 0, 0, 0]), "'hull': quaternion"),
        (change("accessors", 0, "count", to=10**12), "claim more than"),
        (change("accessors", 0, "count", to=9), "buffer view 0 is too short"),
        (change("accessors", 0, "byteOffset", to=4), "buffer view 0 is too short"),
        (change("accessors", 0, "componentType", to=1), "VEC3"),
        (change("accessors", 0, "bufferView", to=7), "there is no buffer view 7"),
        (change("accessors", 1, "type", to="VEC3"), "SCALAR"),
        (change("asset", "version", to="1.0"), "only version 2"),
    ],
)
def test_what_is_not_read_is_refused_by_name(
    tmp_path: Path, broken: Callable[[Builder], None], reason: str
) -> None:
    made = Builder()
    made.box()
    broken(made)
    with pytest.raises(SceneError, match=rf"m\.glb: .*{reason}"):
        made.parts(tmp_path)


def test_a_compressed_part_beside_a_plain_one_is_refused(tmp_path: Path) -> None:
    made = Builder()
    made.box()
    made.primitive(
        made.accessor(None, FLOAT, (8, "VEC3")), extensions={"KHR_draco_mesh_compression": {}}
    )
    with pytest.raises(SceneError, match=r"'hull': its vertices are compressed .*KHR_draco"):
        made.parts(tmp_path)


def test_indices_without_data_are_refused_before_they_fill_the_memory(tmp_path: Path) -> None:
    made = Builder()
    position = made.accessor(made.view(POINTS), FLOAT, (8, "VEC3"))
    made.primitive(position, made.accessor(None, 5125, (60_000_000, "SCALAR")))
    with pytest.raises(SceneError, match="an accessor has no data"):
        made.parts(tmp_path)


def test_a_primitive_without_positions_is_skipped(tmp_path: Path) -> None:
    made = Builder()
    made.box()
    made.root["meshes"][0]["primitives"].append({"attributes": {"NORMAL": 0}})
    (part,) = made.parts(tmp_path)
    assert is_box(part)


@pytest.mark.parametrize("uri", ["http://127.0.0.1:1/x.bin", "none.bin", "/dev/zero", "data:,%%"])
def test_a_buffer_that_cannot_be_is_refused(tmp_path: Path, uri: str) -> None:
    made = Builder()
    made.box()
    with pytest.raises(SceneError, match=r"m\.gltf: "):
        made.parts(tmp_path, uri)


def test_a_file_cut_off_anywhere_is_refused(tmp_path: Path) -> None:
    made = Builder()
    made.box()
    made.parts(tmp_path)
    whole = (tmp_path / "m.glb").read_bytes()
    for end in (5, 12, 20, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.glb").write_bytes(whole[:end])
        with pytest.raises(SceneError, match=r"cut\.glb: "):
            read_parts(tmp_path / "cut.glb")
