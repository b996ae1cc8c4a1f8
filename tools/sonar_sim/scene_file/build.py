"""From a checked file to a scenario."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import msgspec

from sonar_sim.errors import SceneError
from sonar_sim.geometry.pose import Mounting
from sonar_sim.scene.material import MATERIALS, Material
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import (
    Bubbles,
    CloudSpec,
    Emitter,
    PointTarget,
    Scene,
    Sea,
    Sediment,
    Surface,
)
from sonar_sim.scene.sonar import SonarSettings, sonar_preset
from sonar_sim.scene.vehicle import OdometryErrors, Vehicle
from sonar_sim.scene.water import Water
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.objects import (
    Placed,
    motion_of,
    named_material,
    path_of,
    place,
    surface_of,
    without_hidden,
)
from sonar_sim.scene_file.shapes import floor_of, height_of

FLOOR = "floor"
MICRO, MILLI, KILO = 1e6, 1e3, 1e3
"""Parts of a unit, and units in a thousand; dividing keeps 5 µm at exactly 5e-6 m."""


def build_scenario(name: str, file: schema.SceneFile, folder: Path) -> Scenario:
    """Build the scenario of a file.

    Args:
        name: of the scenario.
        file: checked.
        folder: where the files are that it names.

    Raises:
        SceneError: something in it cannot be; names the place.
    """
    where = str(folder / f"{name}.yaml")
    materials = _materials(file, where)
    with _place(f"{where}: $.trajectory"):
        trajectory = path_of(file.trajectory)
    with _place(f"{where}: $.vehicle"):
        vehicle = _vehicle(file.vehicle, materials)
    with _place(f"{where}: $.sonar"):
        sonar = _sonar(file.sonar)
    first = Scenario(
        name=name,
        scene=_scene(file, materials, folder, where),
        sonar=sonar,
        mounting=_mounting(file.mounting),
        trajectory=trajectory,
        vehicle=vehicle,
        ping_rate_hz=file.sonar.ping_rate_hz,
        description=file.description,
    )
    others = [*_further_sonars(file.sonars, first, f"{where}: $.sonars")]
    for k, section in enumerate(file.vehicles):
        at = f"{where}: $.vehicles[{k}]"
        with _place(at):
            one = _vehicle(section.vehicle, materials)
            known = {first.vehicle.name, *(other.vehicle.name for other in others)}
            if one.name in known:
                raise SceneError(f"two vehicles are called {one.name}")
            on = replace(first, trajectory=path_of(section.trajectory), vehicle=one, sonar_name="")
        others += _further_sonars(section.sonars, on, f"{at}.sonars")
    return replace(first, others=tuple(others))


def _further_sonars(
    sections: Sequence[schema.FurtherSonarSection], on: Scenario, where: str
) -> Iterator[Scenario]:
    """Build scenarios of sonars on the vehicle of another one."""
    names = {on.sonar_name}
    for k, section in enumerate(sections):
        with _place(f"{where}[{k}]"):
            if section.name in names:
                raise SceneError(f"two sonars of {on.vehicle.name} are called {section.name}")
            names.add(section.name)
            yield replace(
                on,
                name=f"{on.vehicle.name}/{section.name}",
                sonar=_sonar(section.sonar),
                mounting=_mounting(section.mounting),
                ping_rate_hz=section.sonar.ping_rate_hz,
                sonar_name=section.name,
            )


def _mounting(section: schema.MountingSection) -> Mounting:
    return Mounting(**msgspec.structs.asdict(section))


def _scene(
    file: schema.SceneFile, materials: Mapping[str, Material], folder: Path, where: str
) -> Scene:
    with _place(f"{where}: $.water"):
        water = _water(file.water)
    return Scene(
        surfaces=_surfaces(file, materials, folder, where),
        targets=_targets(file, where),
        emitters=tuple(_emitter(emitter) for emitter in file.emitters),
        clouds=_clouds(file, where),
        water=water,
        sea=None if file.sea is None else Sea(file.sea.rms_height_mm / MILLI, file.sea.lambert_db),
    )


def _materials(file: schema.SceneFile, where: str) -> Mapping[str, Material]:
    own = {}
    for name, section in file.materials.items():
        with _place(f"{where}: $.materials.{name}"):
            own[name] = Material(
                name,
                section.lambert_db,
                section.reflection,
                section.roughness_mm / MILLI,
                section.slope_rad,
            )
    return {**MATERIALS, **own}


def _surfaces(
    file: schema.SceneFile, materials: Mapping[str, Material], folder: Path, where: str
) -> tuple[Surface, ...]:
    """The floor first, then the objects in the file's order."""
    floor_m = None
    if file.terrain is not None:
        with _place(f"{where}: $.terrain"):
            floor_m = height_of(file.terrain, folder)
    placed: list[Placed] = []
    for k, section in enumerate(file.objects):
        with _place(f"{where}: $.objects[{k}] ({section.name})"):
            placed += place(section, materials, floor_m, folder)
    surfaces = [surface for one in placed for surface in one.surfaces]
    if file.terrain is not None and floor_m is not None:
        with _place(f"{where}: $.terrain"):
            bodies = [one.whole for one in placed if one.whole is not None]
            floor = without_hidden(floor_of(file.terrain, floor_m), bodies)
            material = named_material(file.terrain.material, materials)
            surfaces.insert(0, surface_of(FLOOR, floor, material, smooth=True))
    names = [surface.name for surface in surfaces]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise SceneError(f"{where}: $.objects: two objects are called {twice}")
    return tuple(surfaces)


def _targets(file: schema.SceneFile, where: str) -> tuple[PointTarget, ...]:
    """A target that moves is at its motion's origin."""
    made = []
    for k, target in enumerate(file.targets):
        with _place(f"{where}: $.targets[{k}] ({target.name})"):
            motion = motion_of(target.motion, target.position_m, (0.0, 0.0, 0.0))
        here = target.position_m if motion is None else (0.0, 0.0, 0.0)
        made.append(PointTarget(target.name, here, target.target_strength_db, motion))
    return tuple(made)


def _emitter(section: schema.EmitterSection) -> Emitter:
    return Emitter(
        section.name,
        section.position_m,
        section.frequency_khz * KILO,
        section.bandwidth_khz * KILO,
        section.source_level_db,
        section.period_s,
        section.pulse_ms / MILLI,
        section.offset_s,
    )


def _clouds(file: schema.SceneFile, where: str) -> tuple[CloudSpec, ...]:
    made = []
    for k, cloud in enumerate(file.clouds):
        match cloud.matter:
            case schema.BubblesSection(radius_um=radius_um, per_m3=per_m3):
                matter: Bubbles | Sediment = Bubbles(radius_um / MICRO, per_m3)
            case schema.SedimentSection(kg_per_m3=kg_per_m3, radius_um=radius_um):
                matter = Sediment(kg_per_m3, radius_um / MICRO)
        with _place(f"{where}: $.clouds[{k}]"):
            made.append(CloudSpec(cloud.name, cloud.low_m, cloud.high_m, matter))
    return tuple(made)


def _water(section: schema.WaterSection) -> Water:
    values = msgspec.structs.asdict(section)
    values["sediment_radius_m"] = values.pop("sediment_radius_um") / MICRO
    return Water(**values)


_SONAR_UNITS = {
    "frequency_khz": ("frequency_hz", KILO),
    "aperture_deg": ("half_aperture_rad", math.radians(0.5)),
    "beam_width_deg": ("beam_width_rad", math.radians(1.0)),
    "vertical_width_deg": ("vertical_width_rad", math.radians(1.0)),
    "base_row_mm": ("base_row_m", 1 / MILLI),
    "pulse_ms": ("pulse_s", 1 / MILLI),
}
"""Field of the sonar, and its unit, of what the file has in other units."""


def _sonar(section: schema.SonarSection) -> SonarSettings:
    values = {k: v for k, v in msgspec.structs.asdict(section).items() if v is not msgspec.UNSET}
    for name, (field, factor) in _SONAR_UNITS.items():
        if name in values:
            values[field] = values.pop(name) * factor
    values["demanded_range_m"] = values.pop("range_m")
    values["forced_rows"] = values.pop("rows")
    del values["ping_rate_hz"]
    return sonar_preset(values.pop("model"), values.pop("mode"), **values)


def _vehicle(section: schema.VehicleSection, materials: Mapping[str, Material]) -> Vehicle:
    values = msgspec.structs.asdict(section.odometry)
    rate_hz = values.pop("rate_hz")
    return Vehicle(
        section.name,
        rate_hz,
        OdometryErrors(**values),
        section.latitude_deg,
        section.longitude_deg,
        section.size_m,
        named_material(section.material, materials),
    )


@contextmanager
def _place(where: str) -> Iterator[None]:
    """Prefix errors with their place in the file."""
    try:
        yield
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error
