"""Read the geometry of robots (URDF) and worlds (SDF): what stands where, before anything moves.

Both nest poses in XML. Of a link its visuals count; its collisions where it has none. Joints stand
at 0. Physics, sensors, plugins and lights are ignored.
"""

import math
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, cast
from xml.etree import ElementTree as ET

import numpy as np
import trimesh
from numpy.typing import NDArray

from sonar_sim.errors import SceneError
from sonar_sim.geometry.pose import rotation_of, rotation_of_quaternion

MODEL_PATHS = ("GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "GAZEBO_MODEL_PATH")
"""Variables of the environment that name the folders of Gazebo's models."""
FACETS = 48
MAX_INCLUDES = 16
Transform = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """One visual of a link.

    Attributes:
        name: model, link and visual.
        material: its name; empty if it has none, or only colours.
        transform: file's frame from the geometry's, with its scale, (4, 4).
        mesh: a primitive; None if `file` has the triangles.
        file: of a mesh.
    """

    name: str
    material: str
    transform: Transform
    mesh: trimesh.Trimesh | None
    file: Path | None


def read_urdf(path: Path) -> Iterator[Geometry]:
    """Read all visuals of a robot, all joints at 0, in the frame of its root.

    Raises:
        SceneError: not a robot, or a geometry or joint that cannot be read.
    """
    robot = _root(path, "robot")
    places = _urdf_links(robot, str(path))
    for link in robot.findall("link"):
        name = link.get("name", "")
        for k, visual in enumerate(link.findall("visual") or link.findall("collision")):
            where = f"{path}: link {name!r}"
            material = visual.find("material")
            named = "" if material is None else material.get("name", "")
            transform = places[name] @ _origin(visual.find("origin"), where)
            label = "/".join(filter(None, (name, visual.get("name") or (str(k) if k else ""))))
            yield _urdf_geometry(visual, transform, (label, named), path, where)


def _urdf_links(robot: ET.Element, where: str) -> dict[str, Transform]:
    """Each link's frame in the root's."""
    links = Counter(one.get("name", "") for one in robot.findall("link"))
    parents: dict[str, tuple[str, Transform]] = {}
    for joint in robot.findall("joint"):
        parent, child = (_attribute(joint.find(end), "link", where) for end in ("parent", "child"))
        for name in (parent, child):
            if links[name] != 1:
                raise SceneError(f"{where}: there are {links[name]} links {name!r}, not one")
        if child in parents:
            raise SceneError(f"{where}: link {child!r} has two parents")
        parents[child] = parent, _origin(joint.find("origin"), where)
    places = {}
    for link in links:
        at, transform, seen = link, np.eye(4), {link}
        while at in parents:
            at, joint_pose = parents[at]
            transform = joint_pose @ transform
            if at in seen:
                raise SceneError(f"{where}: link {link!r} hangs on itself")
            seen.add(at)
        places[link] = transform
    return places


def _urdf_geometry(
    visual: ET.Element, transform: Transform, names: tuple[str, str], path: Path, where: str
) -> Geometry:
    shape = _only_child(visual.find("geometry"), where)

    def sizes(key: str, count: int = 1) -> list[float]:
        return _sizes(_attribute(shape, key, where), f"{where}: {shape.tag}", count)

    match shape.tag:
        case "mesh":
            file = _resolved(_attribute(shape, "filename", where), path, where)
            scale = _numbers(shape.get("scale", "1 1 1"), where)
            return Geometry(*names, transform @ np.diag([*scale, 1.0]), None, file)
        case "box":
            mesh = _box(sizes("size", 3))
        case "sphere":
            mesh = _ellipsoid(sizes("radius") * 3)
        case "cylinder" | "capsule":
            mesh = _round(shape.tag, *sizes("radius"), *sizes("length"))
        case other:
            raise SceneError(
                f"{where}: no geometry {other!r}; there are box, cylinder, sphere, capsule, mesh"
            )
    return Geometry(*names, transform, mesh, None)


def _origin(element: ET.Element | None, where: str) -> Transform:
    """Read a pose of URDF: xyz and fixed-axis roll, pitch, yaw in radians."""
    if element is None:
        return np.eye(4)
    xyz = _numbers(element.get("xyz", "0 0 0"), where)
    rpy = _numbers(element.get("rpy", "0 0 0"), where)
    return _transform(xyz, rotation_of(*rpy))


def read_sdf(path: Path) -> Iterator[Geometry]:
    """Read all visuals of a world or model as it begins, in its frame.

    Raises:
        SceneError: not SDF, or a model, geometry or pose that cannot be found or read.
    """
    yield from _Sdf(path, 0).everything()


class _Sdf:
    """One file; those that it includes are read by others of this class."""

    def __init__(self, path: Path, depth: int) -> None:
        self._path = path
        self._depth = depth
        if depth > MAX_INCLUDES:
            raise SceneError(f"{path}: included more than {MAX_INCLUDES} deep")
        self.root = _root(path, "sdf")

    def everything(self) -> Iterator[Geometry]:
        worlds = self.root.findall("world")
        for frame in worlds or [self.root]:
            yield from self._models(frame, self._frames(frame, str(self._path)), np.eye(4), "")

    def one_model(
        self, transform: Transform, name: str, placement: str | None
    ) -> Iterator[Geometry]:
        """Read a model's file as another file includes it: its own pose is replaced.

        Its own name stands where the given one is empty or ends in a slash, its own placement frame
        where none is given.
        """
        model = self.root.find("model")
        if model is None:
            raise SceneError(f"{self._path}: there is no model in it")
        own = model.get("name", "") if not name or name.endswith("/") else ""
        placed = _placed_by(model, str(self._path), placement)
        yield from self._model(model, transform @ placed, name + own)

    def _models(
        self, parent: ET.Element, frames: "_PoseFrames", transform: Transform, prefix: str
    ) -> Iterator[Geometry]:
        """Read the models of a world, or those nested in a model."""
        for model in parent.findall("model"):
            name = model.get("name", "")
            yield from self._model(model, transform @ frames.pose(name), prefix + name)
        for include, inner, pose in self._includes(parent):
            at = transform @ frames.resolved(pose)
            name = prefix + include.findtext("name", "")
            yield from inner.one_model(at, name, include.findtext("placement_frame"))

    def _includes(
        self, parent: ET.Element
    ) -> Iterator[tuple[ET.Element, "_Sdf", ET.Element | None]]:
        """Each include of a world or model with its file, and the pose that counts."""
        for include in parent.findall("include"):
            inner = _Sdf(self._included(include), self._depth + 1)
            pose = include.find("pose")
            if include.find("placement_frame") is not None and pose is None:
                raise SceneError(f"{self._path}: an include has a placement_frame, but no pose")
            yield include, inner, inner.root.find("model/pose") if pose is None else pose

    def _frames(self, parent: ET.Element, where: str) -> "_PoseFrames":
        """All frames of a world or model, included models' too."""
        frames = _PoseFrames(parent, where)
        for include, inner, pose in self._includes(parent):
            model = inner.root.find("model")
            if model is not None:
                name = include.findtext("name", "") or model.get("name", "")
                frames.add_included(name, pose, model, include.findtext("placement_frame"))
        return frames

    def _model(self, model: ET.Element, transform: Transform, name: str) -> Iterator[Geometry]:
        frames = self._frames(model, f"{self._path}: model {name!r}")
        for link in model.findall("link"):
            link_name = link.get("name", "")
            at = transform @ frames.pose(link_name)
            for visual in link.findall("visual") or link.findall("collision"):
                label = f"{name}/{link_name}/{visual.get('name', '')}"
                where = f"{self._path}: {label}"
                own = visual.find("pose")
                if own is not None and own.get("relative_to"):
                    pose = transform @ frames.resolved(own)
                else:
                    pose = at @ _sdf_pose(own, where)
                material = visual.findtext("material/script/name", "").strip()
                found = self._geometry(visual, pose, (label, material), where)
                if found is not None:
                    yield found
        yield from self._models(model, frames, transform, f"{name}/")

    def _geometry(
        self, visual: ET.Element, transform: Transform, names: tuple[str, str], where: str
    ) -> Geometry | None:
        shape = _only_child(visual.find("geometry"), where)

        def sizes(key: str, count: int = 1) -> list[float]:
            return _sizes(shape.findtext(key), f"{where}: {shape.tag}", count)

        match shape.tag:
            case "empty":
                return None
            case "mesh":
                file = _resolved(shape.findtext("uri", "").strip(), self._path, where)
                scale = _numbers(shape.findtext("scale", "1 1 1"), where)
                if shape.find("submesh") is not None:
                    raise SceneError(f"{where}: submesh is not supported: save it as its own file")
                return Geometry(*names, transform @ np.diag([*scale, 1.0]), None, file)
            case "box":
                mesh = _box(sizes("size", 3))
            case "plane":
                mesh = _plane(shape, where)
            case "sphere":
                mesh = _ellipsoid(sizes("radius") * 3)
            case "ellipsoid":
                mesh = _ellipsoid(sizes("radii", 3))
            case "cylinder" | "capsule" | "cone":
                mesh = _round(shape.tag, *sizes("radius"), *sizes("length"))
            case other:
                raise SceneError(
                    f"{where}: geometry {other!r} is not supported; box, capsule, cone, cylinder, "
                    "ellipsoid, mesh, plane and sphere are; height maps go into the scene's terrain"
                )
        return Geometry(*names, transform, mesh, None)

    def _included(self, include: ET.Element) -> Path:
        uri = include.findtext("uri", "").strip()
        file = _resolved(uri, self._path, f"{self._path}: include")
        if file.is_dir():
            config = file / "model.config"
            name = "model.sdf"
            if config.is_file():
                name = _root(config, "model").findtext("sdf", name).strip()
            file /= name
            if not file.is_file():
                raise SceneError(f"{self._path}: include: {uri!r} has no {name}")
        return file


class _FrameEntry(NamedTuple):
    """A frame: its pose, what that is relative to by default, and of a model what places it."""

    pose: ET.Element | None
    default: str
    model: ET.Element | None
    placement: str | None


class _PoseFrames:
    """Named frames of a model or world: links, frames, nested models; poses may refer to them."""

    def __init__(self, parent: ET.Element, where: str) -> None:
        self._where = where
        self._own = {"", parent.get("name", ""), "__model__"}
        if parent.tag != "model":
            self._own.add("world")
        self._entries: dict[str, _FrameEntry] = {}
        for tag in ("link", "frame", "model", "joint"):
            named = Counter(one.get("name", "") for one in parent.findall(tag))
            for name, count in named.items():
                if count > 1:
                    raise SceneError(f"{where}: two elements <{tag}> are called {name!r}")
            for one in parent.findall(tag):
                default = one.get("attached_to", "")
                if tag == "joint":
                    default = one.findtext("child", "").strip()
                model = one if tag == "model" else None
                entry = _FrameEntry(one.find("pose"), default, model, None)
                self._entries.setdefault(one.get("name", ""), entry)

    def add_included(
        self, name: str, pose: ET.Element | None, model: ET.Element, placement: str | None
    ) -> None:
        """Add a model of another file, where no other frame has its name."""
        if name:
            self._entries.setdefault(name, _FrameEntry(pose, "", model, placement))

    def pose(self, name: str) -> Transform:
        """Return the frame of an element in that of the parent."""
        return self._pose(name, frozenset())

    def resolved(self, pose: ET.Element | None) -> Transform:
        """Return a pose in the parent's frame."""
        relative = "" if pose is None else pose.get("relative_to", "")
        return self._pose(relative, frozenset()) @ _sdf_pose(pose, self._where)

    def _pose(self, name: str, above: frozenset[str]) -> Transform:
        if name in self._own and name not in self._entries:
            return np.eye(4)
        if name not in self._entries or name in above:
            raise SceneError(f"{self._where}: no frame {name!r}, or one that refers to itself")
        pose, default, model, placement = self._entries[name]
        relative = (pose.get("relative_to") if pose is not None else None) or default
        placed = self._pose(relative, above | {name}) @ _sdf_pose(pose, self._where)
        return placed if model is None else placed @ _placed_by(model, self._where, placement)


def _placed_by(model: ET.Element, where: str, frame: str | None = None) -> Transform:
    """Return a model's frame in its placement frame, the one whose pose the model's pose is.

    Args:
        model: may name a placement frame.
        where: in messages.
        frame: named instead by who includes it.
    """
    frame = model.get("placement_frame", "") if frame is None else frame.strip()
    if not frame:
        return np.eye(4)
    frames = _PoseFrames(model, f"{where}: placement_frame of model {model.get('name', '')!r}")
    return np.asarray(np.linalg.inv(frames.pose(frame)), dtype=np.float64)


def _sdf_pose(element: ET.Element | None, where: str) -> Transform:
    """Read x y z roll pitch yaw, in radians or degrees, or x y z and a quaternion x y z w."""
    text = "" if element is None else (element.text or "").strip()
    if element is None or not text:
        return np.eye(4)
    if element.get("rotation_format") == "quat_xyzw":
        x, y, z, *xyzw = _numbers(text, where, 7)
        return _transform([x, y, z], rotation_of_quaternion(np.array(xyzw)[[3, 0, 1, 2]]))
    x, y, z, *rpy = _numbers(text, where, 6)
    if element.get("degrees", "false").lower() in ("true", "1"):
        rpy = [math.radians(angle) for angle in rpy]
    return _transform([x, y, z], rotation_of(*rpy))


def _transform(xyz: list[float], rotation: NDArray[np.float64]) -> Transform:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, xyz
    return transform


def _box(size_m: list[float]) -> trimesh.Trimesh:
    return cast("trimesh.Trimesh", trimesh.creation.box(extents=size_m))


def _ellipsoid(radii_m: list[float]) -> trimesh.Trimesh:
    mesh = cast("trimesh.Trimesh", trimesh.creation.icosphere(subdivisions=3, radius=1.0))
    mesh.vertices *= radii_m
    return mesh


def _round(kind: str, radius_m: float, length_m: float) -> trimesh.Trimesh:
    """Build a cylinder, capsule or cone along z about its middle."""
    if kind == "capsule":
        made = trimesh.creation.capsule(height=length_m, radius=radius_m, count=[FACETS, FACETS])
    elif kind == "cone":
        made = trimesh.creation.cone(radius=radius_m, height=length_m, sections=FACETS)
    else:
        made = trimesh.creation.cylinder(radius=radius_m, height=length_m, sections=FACETS)
    made.vertices -= [0.0, 0.0, made.bounds.mean(axis=0)[2]]
    return made


def _plane(shape: ET.Element, where: str) -> trimesh.Trimesh:
    width, length = _sizes(shape.findtext("size", "1 1"), f"{where}: plane", 2)
    normal = _numbers(shape.findtext("normal", "0 0 1"), where)
    if not np.linalg.norm(normal) > 0.0:
        raise SceneError(f"{where}: a plane's normal has no length")
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width, length, 0.0] / 2
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    turn = trimesh.geometry.align_vectors([0, 0, 1], normal)  # type: ignore[no-untyped-call]
    mesh.apply_transform(turn)
    return mesh


def _resolved(uri: str, path: Path, where: str) -> Path:
    """Return the file or folder of a URI: file://, package://, model://, or a path.

    A package or model is looked for in the folders above the file, in their `models`, and in
    Gazebo's.

    Raises:
        SceneError: nothing is there.
    """
    scheme, found, rest = uri.partition("://")
    looked = ""
    if not found:
        places, looked = [path.parent / uri], " beside the file"
    elif scheme == "file":
        places = [path.parent / rest]
    else:
        looked = f" in the folders above the file, their models, and ${MODEL_PATHS[0]}"
        named = [part for key in MODEL_PATHS for part in os.environ.get(key, "").split(os.pathsep)]
        above = [*path.resolve().parents]
        folders = [*above, *(one / "models" for one in above), *map(Path, filter(None, named))]
        places = [folder / rest for folder in folders]
        inside = rest.partition("/")[2]  # of a package whose folder has another name
        places += [folder / inside for folder in folders[:3] if inside]
    if not uri or not any(place.exists() for place in places):
        raise SceneError(f"{where}: there is no {uri!r}{looked}")
    return next(place for place in places if place.exists())


def _root(path: Path, tag: str) -> ET.Element:
    try:
        root = ET.parse(path).getroot()  # noqa: S314 expat limits what entities may grow to
    except (OSError, ET.ParseError) as error:
        raise SceneError(f"{path}: not XML: {error}") from error
    if root.tag != tag:
        raise SceneError(f"{path}: its root is <{root.tag}>, not <{tag}>")
    return root


def _only_child(element: ET.Element | None, where: str) -> ET.Element:
    if element is None or not len(element):
        raise SceneError(f"{where}: a geometry is missing")
    return element[0]


def _attribute(element: ET.Element | None, key: str, where: str) -> str:
    value = None if element is None else element.get(key)
    if value is None:
        tag = "an element" if element is None else f"<{element.tag}>"
        raise SceneError(f"{where}: {tag} with {key!r} is missing")
    return value


def _numbers(text: str, where: str, count: int = 3) -> list[float]:
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise SceneError(f"{where}: {text!r} is not {count} numbers")
    return values


def _sizes(text: str | None, where: str, count: int) -> list[float]:
    """Read sizes: what is turned inside out, or flat, is no shape."""
    values = _numbers(text or "", where, count)
    if min(values) <= 0.0:
        raise SceneError(f"{where}: {text!r} is not more than 0")
    return values
