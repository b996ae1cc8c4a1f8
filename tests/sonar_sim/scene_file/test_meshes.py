from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from sonar_sim.errors import SceneError
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene_file.mesh_files import clean_mesh, read_parts

Load = Callable[..., Scenario]


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "glb"])
def test_mesh_of_every_format_is_read_to_scale(tmp_path: Path, load: Load, ending: str) -> None:
    trimesh.creation.box(extents=(1000.0, 2000.0, 3000.0)).export(tmp_path / f"box.{ending}")
    made = load(
        f"objects: [{{name: m, shape: {{kind: mesh, file: box.{ending}, scale: 0.001, "
        "up: z}, material: rock, position_m: [0, 0, -5]}]"
    )
    corners = made.scene.surfaces[0].vertices_m
    assert len(made.scene.surfaces[0].faces) == 12
    assert corners.min(axis=0) == pytest.approx([-0.5, -1.0, -6.5], abs=1e-6)
    assert corners.max(axis=0) == pytest.approx([0.5, 1.0, -3.5], abs=1e-6)


def test_parts_of_one_material_become_one_surface(tmp_path: Path, load: Load) -> None:
    parts = trimesh.Scene()
    parts.add_geometry(trimesh.creation.box(extents=(1, 1, 1)))
    moved = np.eye(4)
    moved[0, 3] = 5.0
    parts.add_geometry(trimesh.creation.box(extents=(1, 1, 1)), transform=moved)
    parts.export(tmp_path / "two.glb")  # type: ignore[no-untyped-call]
    made = load(
        "objects: [{name: m, shape: {kind: mesh, file: two.glb}, material: rock, "
        "position_m: [0, 0, -5]}]"
    )
    (surface,) = made.scene.surfaces
    assert (surface.name, len(surface.faces)) == ("m", 24)
    assert surface.vertices_m.max(axis=0) == pytest.approx([5.5, 0.5, -4.5])


def test_triangles_without_an_area_are_left_out() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [np.nan, 0, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 1, 2]])
    mesh = clean_mesh(vertices, faces, "m")
    assert len(mesh.faces) == 1
    assert np.isfinite(mesh.vertices).all()  # the point that is not a number was no triangle's


def test_a_body_is_closed_though_its_file_repeats_each_vertex(tmp_path: Path) -> None:
    trimesh.creation.box(extents=(1, 1, 1)).export(tmp_path / "box.stl")
    (part,) = read_parts(tmp_path / "box.stl")
    assert part.mesh.is_watertight
    assert len(part.mesh.vertices) == 8


@pytest.mark.parametrize(
    ("content", "ending"),
    [
        (b"", "stl"),
        (b"solid x\nendsolid x\n", "stl"),
        (b"garbage" * 30, "stl"),
        (b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "obj"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1e999 0\nf 1 2 3\n", "obj"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "obj"),
        (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "obj"),
        (b"ply\nformat ascii 1.0\n", "ply"),
        (b"glTF\x02\x00\x00\x00", "glb"),
        (b"\x00" * 500, "glb"),
    ],
)
def test_broken_mesh_is_refused_by_name(
    tmp_path: Path, load: Load, content: bytes, ending: str
) -> None:
    (tmp_path / f"odd.{ending}").write_bytes(content)
    with pytest.raises(SceneError, match=rf"\$\.objects\[0\] \(m\): .*odd\.{ending}"):
        load(
            f"objects: [{{name: m, shape: {{kind: mesh, file: odd.{ending}}}, material: rock, "
            "position_m: [0, 0, -5]}]"
        )


def test_missing_file_and_foreign_format_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no such file"):
        read_parts(tmp_path / "none.stl")
    with pytest.raises(SceneError, match=r"\.dae, \.glb, \.gltf, \.obj, \.ply"):
        read_parts(tmp_path / "model.blend")


TWO_OF_STEEL = """
mtllib absent.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
o first
usemtl Steel.001
f 1 2 3
usemtl wood
f 1 3 4
o second
usemtl Steel.001
f 1 2 5
"""
OBJECT = "objects: [{{name: m, shape: {{kind: mesh, file: {}}}, material: rock{}}}]"


def materials_of(made: Scenario) -> dict[str, tuple[str, int]]:
    """Material and number of triangles of each surface."""
    return {one.name: (one.material.name, len(one.faces)) for one in made.scene.surfaces}


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("", {"m: rock": ("rock", 2), "m: wood": ("wood", 1)}),
        ('"Steel*": rusty_steel', {"m: rusty_steel": ("rusty_steel", 2), "m: wood": ("wood", 1)}),
        ('"*": mud', {"m": ("mud", 3)}),
        ('"second*": pvc, "*": mud', {"m: pvc": ("pvc", 1), "m: mud": ("mud", 2)}),
        ('"wood": null', {"m": ("rock", 2)}),
    ],
)
def test_faces_have_the_materials_of_their_file(
    tmp_path: Path, load: Load, given: str, expected: dict[str, tuple[str, int]]
) -> None:
    (tmp_path / "m.obj").write_text(TWO_OF_STEEL)
    made = load(OBJECT.format(f"m.obj, materials: {{{given}}}", ", position_m: [0, 0, -5]"))
    assert materials_of(made) == expected


def test_a_material_that_the_file_lacks_is_refused(tmp_path: Path, load: Load) -> None:
    (tmp_path / "m.obj").write_text(TWO_OF_STEEL)
    with pytest.raises(SceneError, match=r"nothing is named Stel; it has Steel\.001"):
        load(OBJECT.format("m.obj, materials: {Stel: pvc}", ", position_m: [0, 0, -5]"))
    with pytest.raises(SceneError, match="nothing of it is between the floor"):
        load(OBJECT.format('m.obj, materials: {"*": null}', ", position_m: [0, 0, -5]"))
    with pytest.raises(SceneError, match="no material is called gold"):
        load(OBJECT.format('m.obj, materials: {"*": gold}', ", position_m: [0, 0, -5]"))


CORNERS = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
QUADS = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]


def cube_lines(shift_x: int, faces: list[tuple[int, ...]]) -> str:
    """Vertices of a cube of 1 m, and its faces."""
    lines = [f"v {x + shift_x} {y} {z}" for x, y, z in CORNERS]
    return "\n".join(lines + ["f " + " ".join(map(str, face)) for face in faces]) + "\n"


COUNTED_BACK = [tuple(k - 9 for k in quad) for quad in QUADS]


@pytest.mark.parametrize("form", ["plain", "tabs", "indented", "crlf", "continued"])
def test_obj_is_read_as_programs_write_it(tmp_path: Path, form: str) -> None:
    text = (
        f"# two cubes\nmtllib a b.mtl\no Cube\n{cube_lines(0, COUNTED_BACK)}"
        f"o Cube.001\ng side\nusemtl Wet Steel\n{cube_lines(5, COUNTED_BACK)}"
    )
    changes = {
        "plain": ("", ""),
        "tabs": (" ", "\t"),
        "indented": ("\n", "\n  "),
        "crlf": ("\n", "\r\n"),
        "continued": ("f -8 -6 ", "f -8 \\\n -6 "),
    }
    (tmp_path / "m.obj").write_bytes(text.replace(*changes[form]).encode())
    first, second = read_parts(tmp_path / "m.obj")
    assert (first.name, first.material) == ("Cube", "")
    assert (second.name, second.material) == ("Cube.001", "Wet Steel")
    for part, x_m in ((first, 0.5), (second, 5.5)):
        assert part.mesh.is_watertight
        assert len(part.mesh.vertices) == 8  # none of another part
        assert part.mesh.volume == pytest.approx(1.0)
        assert part.mesh.centroid == pytest.approx([x_m, 0.5, 0.5])


def test_obj_without_objects_has_groups(tmp_path: Path) -> None:
    text = f"g left\n{cube_lines(0, COUNTED_BACK)}g right\n{cube_lines(5, COUNTED_BACK)}"
    (tmp_path / "m.obj").write_text(text)
    assert [part.name for part in read_parts(tmp_path / "m.obj")] == ["left", "right"]


@pytest.mark.parametrize("turn", range(8))
@pytest.mark.parametrize("lying", [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
def test_concave_polygons_are_cut_inside_their_outline(
    tmp_path: Path, turn: int, lying: tuple[int, int, int]
) -> None:
    outline = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]  # a U of 7 m²
    vertices = np.array([(x, y, 4.0) for x, y in outline])[:, lying]
    lines = ["v {} {} {}".format(*vertex) for vertex in vertices]
    corners = [str((k + turn) % 8 + 1) for k in range(8)]
    (tmp_path / "u.obj").write_text("\n".join([*lines, "f " + " ".join(corners)]))
    (part,) = read_parts(tmp_path / "u.obj")
    assert part.mesh.area == pytest.approx(7.0)
    inside = part.mesh.triangles_center[:, np.argsort(lying)]
    in_notch = (abs(inside[:, 0] - 1.5) < 0.5) & (inside[:, 1] > 1.0)
    assert not in_notch.any()


def test_a_concave_polygon_of_too_many_corners_is_refused(tmp_path: Path) -> None:
    teeth = [(k, 2.0 * (k % 2) + 1.0) for k in range(1000)]
    lines = [f"v {x} {y} 0" for x, y in [(0, -1), (999, -1), *reversed(teeth)]]
    (tmp_path / "saw.obj").write_text(
        "\n".join([*lines, "f " + " ".join(map(str, range(1, 1003)))])
    )
    with pytest.raises(SceneError, match="a face has 1002 corners"):
        read_parts(tmp_path / "saw.obj")


def test_what_obj_cannot_mean_is_refused_with_its_line(tmp_path: Path) -> None:
    for bad in ("v 0 zero 0", "v 0 0", "f 1 2 x"):
        (tmp_path / "m.obj").write_text(f"v 0 0 0\n{bad}\n")
        with pytest.raises(SceneError, match=bad):
            read_parts(tmp_path / "m.obj")


def boxes_of_two_materials() -> trimesh.Scene:
    """A steel box of 1 x 2 x 3 m at the origin, and a wooden one 4 m along x, mirrored."""
    scene = trimesh.Scene()
    for k, name in enumerate(("painted_steel", "wood")):
        box = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
        grey: Any = [90, 90, 90, 255]
        visual: Any = trimesh.visual
        look = visual.material.PBRMaterial(name=name, baseColorFactor=grey)
        box.visual = visual.TextureVisuals(uv=np.zeros((8, 2)), material=look)
        transform = np.diag([1.0 - 2.0 * k, 1.0, 1.0, 1.0])
        transform[0, 3] = 4.0 * k
        scene.add_geometry(box, node_name=f"node {k}", geom_name=f"box {k}", transform=transform)
    return scene


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_gltf_keeps_materials_places_and_outsides(tmp_path: Path, load: Load, ending: str) -> None:
    files = boxes_of_two_materials().export(file_type=ending)  # type: ignore[no-untyped-call]
    for name, data in ({"model.glb": files} if ending == "glb" else files).items():
        (tmp_path / name).write_bytes(data)
    made = load(OBJECT.format(f"model.{ending}", ", position_m: [0, 0, -5]"))
    steel, wood = made.scene.surfaces
    assert (steel.material.name, wood.material.name) == ("painted_steel", "wood")
    assert wood.vertices_m.mean(axis=0) == pytest.approx([4.0, 0.0, -5.0])
    for one in (steel, wood):
        assert trimesh.Trimesh(one.vertices_m, one.faces).volume == pytest.approx(6.0)


@pytest.mark.filterwarnings("ignore:the matrix subclass")  # in pycollada
@pytest.mark.parametrize(
    ("up_axis", "option", "high"),
    [("Y_UP", "", 1), ("Z_UP", "", 2), ("X_UP", "", 0), ("Y_UP", ", up: z", 2)],
)
def test_collada_stands_upright_in_metres(
    tmp_path: Path, load: Load, up_axis: str, option: str, high: int
) -> None:
    box = boxes_of_two_materials().geometry["box 0"]
    exchange: Any = trimesh.exchange
    text = exchange.dae.export_collada(box).decode()
    header = f'<unit meter="0.1" name="decimetre"/><up_axis>{up_axis}</up_axis>'
    (tmp_path / "m.dae").write_text(text.replace("<up_axis>Y_UP</up_axis>", header))
    made = load(OBJECT.format(f"m.dae{option}", ", position_m: [0, 0, -5]"))
    corners = made.scene.surfaces[0].vertices_m
    assert np.ptp(corners[:, 2]) == pytest.approx((0.1, 0.2, 0.3)[high])
    mesh = trimesh.Trimesh(corners, made.scene.surfaces[0].faces)
    assert mesh.volume == pytest.approx(0.006)  # not inside out


@pytest.mark.filterwarnings("ignore:the matrix subclass", "ignore:The behavior of fromstring")
def test_collada_has_the_names_of_its_nodes_and_no_broken_points(tmp_path: Path) -> None:
    exchange: Any = trimesh.exchange
    text = exchange.dae.export_collada(boxes_of_two_materials().geometry["box 0"]).decode()
    path = tmp_path / "m.dae"
    instance = text[text.index("<node") : text.index("</node>") + len("</node>")]
    body = instance[instance.index(">") + 1 : -len("</node>")]
    mirrored = f'<node id="b" name="right one"><scale>-1 1 1</scale>{body}</node>'
    path.write_text(text.replace(instance, f'<node id="a" name="left">{body}</node>{mirrored}'))
    left, right = read_parts(path)
    assert (left.name, right.name) == ("left", "right one")
    assert left.mesh.volume == right.mesh.volume == pytest.approx(6.0)  # neither is inside out
    array = text.index("float_array")
    first = text.index("-0.5", array)
    path.write_text(text[:first] + "NaN" + text[first + len("-0.5") :])
    with pytest.raises(SceneError, match="not finite"):
        read_parts(path)


@pytest.mark.parametrize(("option", "high_m"), [("", 2.0), (", up: z", 3.0)])
def test_y_of_gltf_is_up_by_its_specification(
    tmp_path: Path, load: Load, option: str, high_m: float
) -> None:
    boxes_of_two_materials().geometry["box 0"].export(tmp_path / "m.glb")
    made = load(OBJECT.format(f"m.glb{option}", ", position_m: [0, 0, -5]"))
    assert np.ptp(made.scene.surfaces[0].vertices_m[:, 2]) == pytest.approx(high_m)


def test_y_of_other_files_is_turned_up_on_demand(tmp_path: Path, load: Load) -> None:
    boxes_of_two_materials().geometry["box 0"].export(tmp_path / "m.stl")
    made = load(OBJECT.format("m.stl, up: y", ", position_m: [0, 0, -5]"))
    assert np.ptp(made.scene.surfaces[0].vertices_m, axis=0) == pytest.approx([1.0, 3.0, 2.0])


def test_parts_of_a_group_have_their_own_materials(load: Load) -> None:
    box = "shape: {kind: box, size_m: [1, 1, 1]}"
    made = load(
        f"objects: [{{name: g, material: rock, position_m: [0, 0, -5], shape: {{kind: group, "
        f"parts: [{{{box}}}, {{{box}, position_m: [2, 0, 0], material: wood}}, "
        f"{{{box}, position_m: [4, 0, 0]}}]}}}}]"
    )
    assert materials_of(made) == {"g: rock": ("rock", 24), "g: wood": ("wood", 12)}
