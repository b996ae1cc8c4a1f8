"""Shapes of objects, as a scene's file tells them."""

from typing import Annotated

from msgspec import Meta

from sonar_sim.scene_file.sections import Length, Point, Section, Size, says


class Box(Section, frozen=True, tag="box", tag_field="kind"):
    """A box about its middle."""

    size_m: Annotated[Size, says("Edges along x, y and z.", "m")]


class Cylinder(Section, frozen=True, tag="cylinder", tag_field="kind"):
    """An upright cylinder or cone about its middle."""

    radius_m: Annotated[float, says("Radius of the foot.", "m", gt=0, le=1000)]
    height_m: Annotated[float, says("Height.", "m", gt=0, le=1000)]
    top_radius_m: Annotated[
        Annotated[float, Meta(ge=0, le=1000)] | None,
        says("Radius of the head; as the foot's if left out.", "m"),
    ] = None
    open: Annotated[bool, says("Without the ends: a tube, a round tank.")] = False
    facets: Annotated[int, says("Faces around.", "", ge=3, le=2048)] = 32


class Sphere(Section, frozen=True, tag="sphere", tag_field="kind"):
    """A sphere, or an ellipsoid."""

    radius_m: Annotated[float | Size, says("Radius, or the three half axes.", "m")]
    subdivisions: Annotated[int, says("Each one quarters 20 triangles.", "", ge=0, le=7)] = 3


class Capsule(Section, frozen=True, tag="capsule", tag_field="kind"):
    """A rod with round ends, along a line: a limb, a fender."""

    start_m: Annotated[Point, says("Middle of one end.", "m")]
    end_m: Annotated[Point, says("Middle of the other end.", "m")]
    radius_m: Annotated[float, says("Radius.", "m", gt=0, le=100)]
    facets: Annotated[int, says("Faces around.", "", ge=3, le=512)] = 24


class Pipe(Section, frozen=True, tag="pipe", tag_field="kind"):
    """A tube through points: a pipeline, a rope, a cable."""

    points_m: Annotated[tuple[Point, ...], says("Its axis.", "m")]
    radius_m: Annotated[float, says("Radius.", "m", gt=0, le=100)]
    facets: Annotated[int, says("Faces around.", "", ge=3, le=512)] = 24
    follow_floor: Annotated[
        bool, says("The points' z count from the floor below each of them.")
    ] = False


class Sheet(Section, frozen=True, tag="sheet", tag_field="kind"):
    """A flat rectangle in the plane z = 0 of the object: a plate, a wall when turned."""

    size_m: Annotated[tuple[Length, Length], says("Edges along x and y.", "m")]


class Disc(Section, frozen=True, tag="disc", tag_field="kind"):
    """A flat disc in the plane z = 0 of the object."""

    radius_m: Annotated[float, says("Radius.", "m", gt=0, le=1000)]
    facets: Annotated[int, says("Corners.", "", ge=3, le=2048)] = 64


class Hull(Section, frozen=True, tag="hull", tag_field="kind"):
    """A ship's hull by Wigley's parabolas, keel at -draught, deck at the freeboard; x ahead."""

    length_m: Annotated[float, says("Length.", "m", gt=0, le=500)]
    beam_m: Annotated[float, says("Greatest width.", "m", gt=0, le=100)]
    draught_m: Annotated[float, says("From the water line to the keel.", "m", gt=0, le=50)]
    freeboard_m: Annotated[
        float, says("From the water line to the deck; 0 has no deck.", "m", ge=0, le=50)
    ] = 0.0


class Mesh(Section, frozen=True, tag="mesh", tag_field="kind"):
    """Triangles of a file: STL, OBJ, PLY or GLB."""

    file: Annotated[str, says("Path, seen from the scene's file.")]
    scale: Annotated[float, says("Metres a unit of the file.", "m", gt=0, le=1e6)] = 1.0


BuiltShape = Box | Cylinder | Sphere | Capsule | Pipe | Sheet | Disc | Hull
OneShape = BuiltShape | Mesh


class Part(Section, frozen=True):
    """A shape at its place in a group."""

    shape: Annotated[OneShape, says("One of the shapes but a group.")]
    position_m: Annotated[Point, says("In the group.", "m")] = (0.0, 0.0, 0.0)
    roll_deg: Annotated[float, says("About x, first.", "°", ge=-360, le=360)] = 0.0
    pitch_deg: Annotated[float, says("About y, nose down.", "°", ge=-360, le=360)] = 0.0
    yaw_deg: Annotated[float, says("About z, last.", "°", ge=-360, le=360)] = 0.0


class Group(Section, frozen=True, tag="group", tag_field="kind"):
    """Several shapes of one material that stand and move together."""

    parts: Annotated[tuple[Part, ...], says("The shapes.", "", min_length=1)]


Shape = OneShape | Group
