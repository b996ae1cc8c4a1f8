"""The schema of scene files.

Each field carries its meaning and unit, from which docs/reference/scene-files.md is made.
"""

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

Number3 = tuple[float, float, float]
Limits = float


def field_info(description: str, unit: str = "", **limits: Limits) -> Meta:
    """A field's meaning, unit and limits."""
    known: dict[str, Any] = dict(limits)
    return Meta(description=description, extra={"unit": unit}, **known)


Metres = Annotated[float, field_info("", "m", ge=-1e5, le=1e5)]
Length = Annotated[float, field_info("", "m", gt=0, le=1e4)]
Point = tuple[Metres, Metres, Metres]
Size = tuple[Length, Length, Length]
Span = tuple[Metres, Metres]
Degrees3 = tuple[float, float, float]


class Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A mapping whose keys are known."""


class Box(Section, frozen=True, tag="box", tag_field="kind"):
    """A box about its middle."""

    size_m: Annotated[Size, field_info("Edges along x, y and z.", "m")]


class Cylinder(Section, frozen=True, tag="cylinder", tag_field="kind"):
    """An upright cylinder or cone about its middle."""

    radius_m: Annotated[float, field_info("Radius of the foot.", "m", gt=0, le=1000)]
    height_m: Annotated[float, field_info("Height.", "m", gt=0, le=1000)]
    top_radius_m: Annotated[
        Annotated[float, Meta(ge=0, le=1000)] | None,
        field_info("Radius of the head; as the foot's if left out.", "m"),
    ] = None
    open: Annotated[bool, field_info("Without the ends: a tube, a round tank.")] = False
    facets: Annotated[int, field_info("Faces around.", "", ge=3, le=2048)] = 32


class Sphere(Section, frozen=True, tag="sphere", tag_field="kind"):
    """A sphere, or an ellipsoid."""

    radius_m: Annotated[float | Size, field_info("Radius, or the three half axes.", "m")]
    subdivisions: Annotated[int, field_info("Each one quarters 20 triangles.", "", ge=0, le=7)] = 3


class Capsule(Section, frozen=True, tag="capsule", tag_field="kind"):
    """A rod with round ends, along a line: a limb, a fender."""

    start_m: Annotated[Point, field_info("Middle of one end.", "m")]
    end_m: Annotated[Point, field_info("Middle of the other end.", "m")]
    radius_m: Annotated[float, field_info("Radius.", "m", gt=0, le=100)]
    facets: Annotated[int, field_info("Faces around.", "", ge=3, le=512)] = 24


class Pipe(Section, frozen=True, tag="pipe", tag_field="kind"):
    """A tube through points: a pipeline, a rope, a cable."""

    points_m: Annotated[tuple[Point, ...], field_info("Its axis.", "m")]
    radius_m: Annotated[float, field_info("Radius.", "m", gt=0, le=100)]
    facets: Annotated[int, field_info("Faces around.", "", ge=3, le=512)] = 24
    follow_floor: Annotated[
        bool, field_info("The points' z count from the floor below each of them.")
    ] = False


class Sheet(Section, frozen=True, tag="sheet", tag_field="kind"):
    """A flat rectangle in the plane z = 0 of the object: a plate, a wall when turned."""

    size_m: Annotated[tuple[Length, Length], field_info("Edges along x and y.", "m")]


class Disc(Section, frozen=True, tag="disc", tag_field="kind"):
    """A flat disc in the plane z = 0 of the object."""

    radius_m: Annotated[float, field_info("Radius.", "m", gt=0, le=1000)]
    facets: Annotated[int, field_info("Corners.", "", ge=3, le=2048)] = 64


class Hull(Section, frozen=True, tag="hull", tag_field="kind"):
    """A ship's hull by Wigley's parabolas, keel at -draught, deck at the freeboard; x ahead."""

    length_m: Annotated[float, field_info("Length.", "m", gt=0, le=500)]
    beam_m: Annotated[float, field_info("Greatest width.", "m", gt=0, le=100)]
    draught_m: Annotated[float, field_info("From the water line to the keel.", "m", gt=0, le=50)]
    freeboard_m: Annotated[
        float, field_info("From the water line to the deck; 0 has no deck.", "m", ge=0, le=50)
    ] = 0.0


class Mesh(Section, frozen=True, tag="mesh", tag_field="kind"):
    """Triangles of a file: STL, PLY, OBJ, glTF (GLB), COLLADA (DAE), URDF or SDF."""

    file: Annotated[str, field_info("Path, seen from the scene's file.")]
    scale: Annotated[float, field_info("Metres a unit of the file.", "m", gt=0, le=1e6)] = 1.0
    up: Annotated[
        Literal["x", "y", "z"] | None,
        field_info(
            "The file's axis that points up; left out, what a DAE file declares, y of glTF, else z."
        ),
    ] = None
    materials: Annotated[
        dict[str, str | None],
        field_info(
            "Materials of the file's materials or parts, by their names; `*` and `?` stand for any "
            "text, the first that fits counts, and `null` leaves the part out. Others have the "
            "scene's material of their own name, or else the object's."
        ),
    ] = {}


BuiltShape = Box | Cylinder | Sphere | Capsule | Pipe | Sheet | Disc | Hull
OneShape = BuiltShape | Mesh


class ShapePart(Section, frozen=True):
    """A shape at its place in a group."""

    shape: Annotated[OneShape, field_info("One of the shapes but a group.")]
    position_m: Annotated[Point, field_info("In the group.", "m")] = (0.0, 0.0, 0.0)
    roll_deg: Annotated[float, field_info("About x, first.", "°", ge=-360, le=360)] = 0.0
    pitch_deg: Annotated[float, field_info("About y, nose down.", "°", ge=-360, le=360)] = 0.0
    yaw_deg: Annotated[float, field_info("About z, last.", "°", ge=-360, le=360)] = 0.0
    material: Annotated[str | None, field_info("Name of a material; left out, the object's.")] = (
        None
    )


class ShapeGroup(Section, frozen=True, tag="group", tag_field="kind"):
    """Several shapes that stand and move together."""

    parts: Annotated[tuple[ShapePart, ...], field_info("The shapes.", "", min_length=1)]


Shape = OneShape | ShapeGroup


class WaterSection(Section, frozen=True):
    """The water, as the sound meets it."""

    temperature_c: Annotated[float, field_info("Temperature.", "°C", ge=-2, le=40)] = 10.0
    salinity_ppt: Annotated[float, field_info("Salinity; 0 is fresh.", "ppt", ge=0, le=45)] = 35.0
    depth_m: Annotated[float, field_info("Where the formulas are taken.", "m", ge=0, le=7000)] = 5.0
    acidity_ph: Annotated[float, field_info("Acidity.", "pH", ge=6, le=9)] = 8.0
    absorption_model: Annotated[
        Literal["francois_garrison", "ainslie_mccolm"], field_info("Whose formula of absorption.")
    ] = "francois_garrison"
    profile: Annotated[
        tuple[tuple[float, float], ...] | None,
        field_info("Speed of sound over depth: pairs of depth and speed.", "m, m/s"),
    ] = None
    sediment_kg_per_m3: Annotated[
        float, field_info("Quartz in suspension everywhere.", "kg/m³", ge=0, le=100)
    ] = 0.0
    sediment_radius_um: Annotated[
        float, field_info("Radius of its grains.", "µm", ge=0.1, le=1000)
    ] = 5.0
    volume_strength_db: Annotated[
        float, field_info("Back scattering strength of the water.", "dB re 1/m", ge=-150, le=0)
    ] = -80.0
    reverberation_db: Annotated[
        float,
        field_info(
            "Energy of the tail behind echoes per metre, re their own.", "dB re 1/m", ge=-200, le=0
        ),
    ] = -18.5
    reverberation_decay_db_per_m: Annotated[
        float, field_info("By which the tail fades.", "dB/m", ge=0, le=1000)
    ] = 14.0


class SeaSection(Section, frozen=True):
    """The surface of the water, at z = 0, as sound from below meets it."""

    rms_height_mm: Annotated[
        float, field_info("Standard deviation of its height.", "mm", ge=0, le=10000)
    ] = 0.0
    lambert_db: Annotated[
        float, field_info("Back scattering strength, bubbles included.", "dB", ge=-100, le=0)
    ] = -20.0


class MaterialSection(Section, frozen=True):
    """A material of one's own, beside the named ones."""

    lambert_db: Annotated[
        float, field_info("Back scattering strength at normal incidence.", "dB", ge=-200, le=0)
    ]
    reflection: Annotated[float, field_info("Reflection of pressure, signed.", "", ge=-1, le=1)] = (
        0.0
    )
    roughness_mm: Annotated[
        float, field_info("Standard deviation of the height.", "mm", ge=0, le=1000)
    ] = 10.0
    slope_rad: Annotated[
        float, field_info("Standard deviation of the facets' slopes.", "rad", ge=0.001, le=1)
    ] = 0.1


class Repeat(Section, frozen=True):
    """Copies of an object in a row."""

    count: Annotated[int, field_info("How many in all.", "", ge=1, le=1000)]
    step_m: Annotated[Point, field_info("From one to the next.", "m")]


class DriftMotion(Section, frozen=True, tag="drift", tag_field="kind"):
    """Steady drift and turning with a swing on top."""

    velocity_mps: Annotated[Number3, field_info("In the map.", "m/s")] = (0.0, 0.0, 0.0)
    yaw_rate_dps: Annotated[float, field_info("About the vertical.", "°/s", ge=-360, le=360)] = 0.0
    swing_m: Annotated[Number3, field_info("Amplitude along the map's axes.", "m")] = (
        0.0,
        0.0,
        0.0,
    )
    swing_deg: Annotated[Degrees3, field_info("Amplitude in roll, pitch, yaw.", "°")] = (
        0.0,
        0.0,
        0.0,
    )
    period_s: Annotated[float, field_info("Of the swing.", "s", gt=0, le=1e5)] = 10.0
    phase_deg: Annotated[float, field_info("Of the swing at time 0.", "°", ge=-360, le=360)] = 0.0


class WaypointSection(Section, frozen=True):
    """A place to pass."""

    position_m: Annotated[Point, field_info("In the map.", "m")]
    yaw_deg: Annotated[
        float, field_info("Heading, anticlockwise from east, unwrapped.", "°", ge=-36000, le=36000)
    ] = 0.0
    roll_deg: Annotated[float, field_info("Roll.", "°", ge=-180, le=180)] = 0.0


class PathSection(Section, frozen=True):
    """A smooth path through waypoints."""

    waypoints: Annotated[tuple[WaypointSection, ...], field_info("At least two.")]
    speed_mps: Annotated[float, field_info("Along straight legs.", "m/s", gt=0, le=50)] = 0.6
    turn_rate_dps: Annotated[float, field_info("Of heading and roll.", "°/s", gt=0, le=360)] = 30.0
    smoothing_s: Annotated[float, field_info("Rounds the corners.", "s", gt=0, le=60)] = 0.8
    sway_deg: Annotated[float, field_info("Roll and pitch of the waves.", "°", ge=0, le=60)] = 1.0
    heave_m: Annotated[float, field_info("Heave of the waves.", "m", ge=0, le=10)] = 0.03


class TourMotion(Section, frozen=True, tag="tour", tag_field="kind"):
    """Along a path, again and again."""

    path: Annotated[PathSection, field_info("The path of the object's frame.")]


class ObjectSection(Section, frozen=True):
    """Something that echoes: a shape at a place."""

    name: Annotated[
        str,
        field_info(
            "For people; copies are numbered, and parts of other materials get theirs appended.",
            "",
            min_length=1,
        ),
    ]
    shape: Annotated[Shape, field_info("One of the shapes below.")]
    material: Annotated[str, field_info("Name of a material.")]
    position_m: Annotated[Point, field_info("Of the shape's origin in the map.", "m")] = (
        0.0,
        0.0,
        0.0,
    )
    roll_deg: Annotated[float, field_info("About x, first.", "°", ge=-360, le=360)] = 0.0
    pitch_deg: Annotated[float, field_info("About y, nose down.", "°", ge=-360, le=360)] = 0.0
    yaw_deg: Annotated[float, field_info("About z, last.", "°", ge=-360, le=360)] = 0.0
    on_floor: Annotated[bool, field_info("The position's z counts from the terrain below it.")] = (
        False
    )
    smooth: Annotated[
        bool, field_info("Round between its vertices: spheres, pipes, hulls. Boxes are not.")
    ] = False
    cell_m: Annotated[
        Annotated[float, Meta(gt=0, le=100)] | None,
        field_info("Triangles are cut until their edges are no longer.", "m"),
    ] = None
    repeat: Annotated[Repeat | None, field_info("Copies of it.")] = None
    motion: Annotated[DriftMotion | TourMotion | None, field_info("How it moves.")] = None


class Flat(Section, frozen=True, tag="flat", tag_field="kind"):
    """A level floor."""

    depth_m: Annotated[float, field_info("Below the surface.", "m", gt=0, le=10000)]


class Ripples(Section, frozen=True):
    """Long-crested sand ripples."""

    height_m: Annotated[float, field_info("Crest to trough.", "m", ge=0, le=10)]
    length_m: Annotated[float, field_info("Crest to crest.", "m", gt=0, le=1000)]
    direction_deg: Annotated[float, field_info("Across the crests, from east.", "°")] = 0.0


class Procedural(Section, frozen=True, tag="procedural", tag_field="kind"):
    """A floor of random waves of all lengths, the same for the same seed."""

    depth_m: Annotated[float, field_info("Of its mean below the surface.", "m", gt=0, le=10000)]
    relief_m: Annotated[float, field_info("Standard deviation of its height.", "m", ge=0, le=1000)]
    longest_m: Annotated[float, field_info("Of the waves.", "m", gt=0, le=10000)] = 20.0
    shortest_m: Annotated[
        float, field_info("Of the waves; at least a 4096th of the longest.", "m", gt=0, le=10000)
    ] = 1.0
    hurst: Annotated[
        float, field_info("Heights go as length to this power: 1 smooth, 0 rugged.", "", ge=0, le=2)
    ] = 1.0
    seed: Annotated[int, field_info("Of the waves.", "", ge=0)] = 0
    slope: Annotated[
        tuple[float, float], field_info("Rise of the mean floor a metre east and north.", "m/m")
    ] = (0.0, 0.0)
    ripples: Annotated[Ripples | None, field_info("On top.")] = None


class HeightField(Section, frozen=True, tag="height_field", tag_field="kind"):
    """A floor of measured heights: a GeoTIFF, or a .npy or .csv table with rows along y.

    A table fills the terrain's spans. A GeoTIFF keeps its size; where it has no data is no floor.
    """

    file: Annotated[str, field_info("Path, seen from the scene's file.")]
    scale: Annotated[
        float, field_info("Metres a unit of height; -1 turns depths.", "m", ge=-1e6, le=1e6)
    ] = 1.0
    offset_m: Annotated[float, field_info("Added to the heights; z is up.", "m")] = 0.0
    origin: Annotated[
        tuple[float, float] | None,
        field_info(
            "Easting and northing, or longitude and latitude, of the map's origin in a GeoTIFF; "
            "left out, its middle.",
            "m or °",
        ),
    ] = None


class TerrainSection(Section, frozen=True):
    """The floor."""

    relief: Annotated[Flat | Procedural | HeightField, field_info("Its height.")]
    x_m: Annotated[Span, field_info("From west to east.", "m")]
    y_m: Annotated[Span, field_info("From south to north.", "m")]
    cell_m: Annotated[float, field_info("Distance of its points.", "m", ge=0.005, le=1000)] = 0.25
    material: Annotated[str, field_info("Name of a material.")] = "sand"


class TargetSection(Section, frozen=True):
    """A point that echoes alike in all directions."""

    name: Annotated[str, field_info("For people.", "", min_length=1)]
    position_m: Annotated[Point, field_info("In the map.", "m")]
    target_strength_db: Annotated[float, field_info("Target strength.", "dB", ge=-150, le=60)]
    motion: Annotated[DriftMotion | TourMotion | None, field_info("How it moves.")] = None


class EmitterSection(Section, frozen=True):
    """Another sonar or pinger."""

    name: Annotated[str, field_info("For people.", "", min_length=1)]
    position_m: Annotated[Point, field_info("In the map.", "m")]
    frequency_khz: Annotated[float, field_info("Middle of its band.", "kHz", gt=0, le=1e4)]
    bandwidth_khz: Annotated[float, field_info("Width of its band.", "kHz", gt=0, le=1e4)]
    source_level_db: Annotated[float, field_info("Towards us.", "dB re 1 µPa at 1 m", ge=0, le=260)]
    period_s: Annotated[float, field_info("Between its pulses.", "s", gt=0, le=1e4)]
    pulse_ms: Annotated[float, field_info("Length of a pulse.", "ms", gt=0, le=1e4)]
    offset_s: Annotated[float, field_info("Of the first pulse.", "s", ge=0, le=1e6)] = 0.0


class BubblesSection(Section, frozen=True, tag="bubbles", tag_field="kind"):
    """Gas bubbles of one radius."""

    radius_um: Annotated[float, field_info("Radius.", "µm", gt=0, le=1e5)]
    per_m3: Annotated[float, field_info("How many.", "1/m³", ge=0, le=1e12)]


class SedimentSection(Section, frozen=True, tag="sediment", tag_field="kind"):
    """Quartz grains of one radius."""

    kg_per_m3: Annotated[float, field_info("Concentration.", "kg/m³", ge=0, le=100)]
    radius_um: Annotated[float, field_info("Radius.", "µm", ge=0.1, le=1000)] = 5.0


class CloudSection(Section, frozen=True):
    """Something in the water, in a box along the map's axes."""

    name: Annotated[str, field_info("For people.", "", min_length=1)]
    low_m: Annotated[Point, field_info("Lowest corner.", "m")]
    high_m: Annotated[Point, field_info("Highest corner.", "m")]
    matter: Annotated[BubblesSection | SedimentSection, field_info("What is in it.")]


class SonarSection(Section, frozen=True):
    """The sonar and its setting; what is left out is the model's own."""

    model: Annotated[
        Literal[
            "M370s",
            "M750d",
            "M1200d",
            "M3000d",
            "Gemini 720is",
            "P900-45",
            "P900-90",
            "P900-130",
        ],
        field_info(
            "Oculus model; or one of another maker, which can be neither served nor recorded."
        ),
    ] = "M750d"
    mode: Annotated[int, field_info("1 wide and far, 2 narrow and sharp.", "", ge=1, le=2)] = 1
    range_m: Annotated[float, field_info("Range asked for.", "m", ge=0.1, le=200)] = 10.0
    beams: Annotated[
        Annotated[int, Meta(ge=2, le=4096)] | UnsetType,
        field_info("Columns of the image; an Oculus has 512 or 256."),
    ] = UNSET
    bits: Annotated[Literal[8, 16, 32], field_info("Of a sample.")] = 8
    gain_percent: Annotated[float, field_info("The operator's gain.", "%", ge=0, le=100)] = 50.0
    gamma_byte: Annotated[
        int, field_info("Exponent of the pixels times 255; 0 and 255 are linear.", "", ge=0, le=255)
    ] = 255
    ping_rate_hz: Annotated[
        float, field_info("Asked for; the sound's travel may allow less.", "Hz", gt=0, le=40)
    ] = 5.0
    rows: Annotated[
        Annotated[int, Meta(ge=1, le=10000)] | None,
        field_info("Of the image, whatever an Oculus would choose.", ""),
    ] = None
    told_speed_mps: Annotated[
        Annotated[float, Meta(ge=1300, le=1700)] | None,
        field_info("Speed of sound that it assumes.", "m/s"),
    ] = None
    frequency_khz: Annotated[
        Annotated[float, Meta(ge=10, le=10000)] | UnsetType,
        field_info("Acoustic frequency.", "kHz"),
    ] = UNSET
    aperture_deg: Annotated[
        Annotated[float, Meta(gt=0, le=178)] | UnsetType,
        field_info("Between the outermost beams.", "°"),
    ] = UNSET
    beam_width_deg: Annotated[
        Annotated[float, Meta(ge=0.05, le=30)] | UnsetType,
        field_info("Of a beam in azimuth at -3 dB, one way.", "°"),
    ] = UNSET
    vertical_width_deg: Annotated[
        Annotated[float, Meta(ge=0.5, le=90)] | UnsetType,
        field_info("Of the fan in elevation at -3 dB, one way.", "°"),
    ] = UNSET
    max_range_m: Annotated[
        Annotated[float, Meta(ge=0.1, le=200)] | UnsetType,
        field_info("What may be asked for.", "m"),
    ] = UNSET
    max_rows: Annotated[
        Annotated[int, Meta(ge=1, le=10000)] | UnsetType,
        field_info("Rows of the image at most; coarser by powers of two beyond."),
    ] = UNSET
    base_row_mm: Annotated[
        Annotated[float, Meta(ge=0.5, le=1000)] | UnsetType,
        field_info("Finest spacing of rows.", "mm"),
    ] = UNSET
    pulse_ms: Annotated[
        Annotated[float, Meta(gt=0, le=1000)] | UnsetType,
        field_info("Length of the chirp, for the Doppler shift.", "ms"),
    ] = UNSET
    source_level_db: Annotated[
        Annotated[float, Meta(ge=0, le=260)] | UnsetType,
        field_info("Source level.", "dB re 1 µPa at 1 m"),
    ] = UNSET
    array_gain_db: Annotated[
        Annotated[float, Meta(ge=0, le=100)] | UnsetType,
        field_info("Of the receiving array against thermal noise.", "dB"),
    ] = UNSET
    side_lobe_db: Annotated[
        Annotated[float, Meta(ge=13.3, le=80)] | UnsetType,
        field_info("Azimuth side lobes under the main lobe.", "dB"),
    ] = UNSET
    noise_excess_db: Annotated[
        Annotated[float, Meta(ge=-50, le=120)] | UnsetType,
        field_info("Receiver's noise above thermal noise.", "dB"),
    ] = UNSET
    tvg_spreading_log: Annotated[
        Annotated[float, Meta(ge=0, le=60)] | UnsetType,
        field_info("a of the gain over range a log R.", "dB"),
    ] = UNSET
    crosstalk_db: Annotated[
        Annotated[float, Meta(ge=-200, le=0)] | UnsetType | None,
        field_info("Electrical, of a row's mean power in all its beams.", "dB"),
    ] = UNSET
    ring_down_db: Annotated[
        Annotated[float, Meta(ge=-200, le=20)] | UnsetType | None,
        field_info("What still rings after the transmission, of full scale at 50 % gain.", "dB"),
    ] = UNSET
    dynamic_focus: Annotated[
        bool | UnsetType, field_info("Whether beams are focused at every range.")
    ] = UNSET


class MountingSection(Section, frozen=True):
    """The sonar on the vehicle: Rz(yaw) Ry(pitch) Rx(roll); pitch 90° looks straight down."""

    position_m: Annotated[Point, field_info("In the vehicle: ahead, port, up.", "m")] = (
        0.0,
        0.0,
        -0.5,
    )
    roll_deg: Annotated[float, field_info("Roll.", "°", ge=-360, le=360)] = 0.0
    pitch_deg: Annotated[float, field_info("Pitch, nose down.", "°", ge=-360, le=360)] = 90.0
    yaw_deg: Annotated[float, field_info("Yaw, to port.", "°", ge=-360, le=360)] = 0.0


class OdometrySection(Section, frozen=True):
    """The odometry's rate and errors."""

    rate_hz: Annotated[float, field_info("Records a second.", "Hz", gt=0, le=1000)] = 25.0
    position_noise_m: Annotated[float, field_info("White error.", "m", ge=0, le=100)] = 0.005
    attitude_noise_deg: Annotated[float, field_info("White error.", "°", ge=0, le=90)] = 0.1
    velocity_noise_mps: Annotated[float, field_info("White error.", "m/s", ge=0, le=10)] = 0.0
    turn_rate_noise_dps: Annotated[float, field_info("White error.", "°/s", ge=0, le=90)] = 0.0
    position_bias_m: Annotated[Point, field_info("Constant, in the map.", "m")] = (0.0, 0.0, 0.0)
    attitude_bias_deg: Annotated[
        Degrees3, field_info("Constant roll, pitch and yaw, in the body.", "°")
    ] = (0.0, 0.0, 0.0)
    scale: Annotated[
        float,
        field_info("Part by which distances from the start are overrated.", "", ge=-0.5, le=0.5),
    ] = 0.0
    drift_mps: Annotated[Number3, field_info("Steady drift, in the map.", "m/s")] = (0.0, 0.0, 0.0)
    walk_m_per_sqrt_s: Annotated[
        float, field_info("Random walk: its spread after a second.", "m/√s", ge=0, le=10)
    ] = 0.0
    yaw_drift_deg_per_min: Annotated[
        float, field_info("Steady drift of the heading.", "°/min", ge=-60, le=60)
    ] = 0.0
    latency_s: Annotated[float, field_info("From validity to arrival.", "s", ge=0, le=10)] = 0.002
    jitter_s: Annotated[float, field_info("Mean of what comes on top.", "s", ge=0, le=10)] = 0.0
    dropout: Annotated[float, field_info("Share of records lost.", "", ge=0, lt=1)] = 0.0
    outages_s: Annotated[
        tuple[tuple[float, float], ...], field_info("Stretches without any record.", "s")
    ] = ()


class VehicleSection(Section, frozen=True):
    """What carries the sonar."""

    name: Annotated[str, field_info("For people.")] = "vehicle"
    latitude_deg: Annotated[float, field_info("Of the map's origin.", "°", ge=-90, le=90)] = 53.5
    longitude_deg: Annotated[float, field_info("Of the map's origin.", "°", ge=-180, le=180)] = 8.1
    size_m: Annotated[
        Size | None,
        field_info("Length, width, height: the box that other vehicles' sonars see, if any.", "m"),
    ] = None
    material: Annotated[str, field_info("Name of the box's material.")] = "pvc"
    odometry: Annotated[OdometrySection, field_info("Its navigation.")] = OdometrySection()


class FurtherSonarSection(Section, frozen=True):
    """Another sonar on a vehicle."""

    name: Annotated[str, field_info("Unlike others of the vehicle.", "", min_length=1)]
    sonar: Annotated[SonarSection, field_info("The sonar.")] = SonarSection()
    mounting: Annotated[MountingSection, field_info("How it sits.")] = MountingSection()


class FurtherVehicleSection(Section, frozen=True):
    """Another vehicle with its sonars."""

    vehicle: Annotated[VehicleSection, field_info("Its name and odometry.")]
    trajectory: Annotated[PathSection, field_info("Its true path.")]
    sonars: Annotated[
        tuple[FurtherSonarSection, ...], field_info("At least one.", "", min_length=1)
    ]


class SceneFile(Section, frozen=True):
    """A whole file."""

    trajectory: Annotated[PathSection, field_info("The vehicle's true path.")]
    description: Annotated[str, field_info("One sentence.")] = ""
    water: Annotated[WaterSection, field_info("The water.")] = WaterSection()
    sea: Annotated[
        SeaSection | None, field_info("The water's surface; left out it is too far to be heard.")
    ] = None
    materials: Annotated[dict[str, MaterialSection], field_info("Own materials by name.")] = {}
    terrain: Annotated[TerrainSection | None, field_info("The floor.")] = None
    objects: Annotated[tuple[ObjectSection, ...], field_info("What stands and moves.")] = ()
    targets: Annotated[tuple[TargetSection, ...], field_info("Points that echo.")] = ()
    emitters: Annotated[tuple[EmitterSection, ...], field_info("Other sonars.")] = ()
    clouds: Annotated[tuple[CloudSection, ...], field_info("Bubbles and sediment.")] = ()
    sonar: Annotated[SonarSection, field_info("The sonar.")] = SonarSection()
    mounting: Annotated[MountingSection, field_info("How it sits on the vehicle.")] = (
        MountingSection()
    )
    vehicle: Annotated[VehicleSection, field_info("What carries it.")] = VehicleSection()
    sonars: Annotated[
        tuple[FurtherSonarSection, ...], field_info("Further sonars on the vehicle.")
    ] = ()
    vehicles: Annotated[
        tuple[FurtherVehicleSection, ...], field_info("Further vehicles with theirs.")
    ] = ()
