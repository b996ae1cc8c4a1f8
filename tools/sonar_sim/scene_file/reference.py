"""The reference of the scenes' files, made from their types: `python -m` this writes the page."""

from pathlib import Path
from typing import Any, get_args

import msgspec.inspect as mi
from msgspec import NODEFAULT, UNSET

from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene_file import SHIPPED, load_scenario, scene_names, schema
from sonar_sim.scene_file.schema import Section

PAGE = Path("docs/reference/scene-files.md")
INTRODUCTION = """# Scene files

A scene is one YAML file: the water, objects, the sonar, and the vehicle with its path and the
errors of its odometry. `load_scenario(name_or_path)` reads it; errors name the file and the place.
`python -m sonar_sim.scene_file.reference` writes this page from the types.

- Map frame: x east, y north, z up; z = 0 is the water's surface. Objects are cut off at the surface
  and at the floor.
- Vehicle frame: x ahead, y to port, z up. Angles turn Rz(yaw) Ry(pitch) Rx(roll).
- Aliases, tags and duplicate keys are errors. Words are text unless they are a number, `true`,
  `false` or `null`.
- Paths of meshes and height tables start at the scene's file. Triangles without an area are
  ignored; vertices that are not finite, and files without a triangle, are errors.
- Of an interval, `[` and `]` include the limit, `(` and `)` exclude it.
- An emitter whose pulse is as long as its period sounds continuously: a thruster, a pump.
- Moving objects are not part of a map's truth.
"""


def reference() -> str:
    """The whole page."""
    parts = [INTRODUCTION, _shipped(), _materials()]
    parts += [_section(section) for section in _sections()]
    return "\n".join(parts)


def _shipped() -> str:
    lines = [
        "## Shipped scenes\n",
        "| name | sonar | range, m | triangles | what |",
        "|---|---|---|---|---|",
    ]
    for name in scene_names():
        scenario = load_scenario(name)
        sonar, triangles = scenario.sonar, len(scenario.scene.triangles_m)
        band = f"{sonar.model}, {sonar.frequency_hz / 1e3:g} kHz"
        lines.append(
            f"| `{name}` | {band} | {sonar.demanded_range_m:g} | {triangles} "
            f"| {scenario.description} |"
        )
    return "\n".join([*lines, f"\nTheir files are in `tools/sonar_sim/{SHIPPED.name}/`.\n"])


def _materials() -> str:
    lines = [
        "## Materials\n",
        "| name | Lambert, dB | reflection | roughness, mm | slope, rad |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| `{m.name}` | {m.lambert_db:g} | {m.reflection:g} | {m.roughness_m * 1e3:g} "
        f"| {m.slope_rad:g} |"
        for m in MATERIALS.values()
    ]
    return "\n".join([*lines, ""])


def _sections() -> list[type[Section]]:
    """The whole file first, then in the order of their definition, shapes last."""
    types = [
        one
        for one in vars(schema).values()
        if isinstance(one, type) and issubclass(one, Section) and one is not Section
    ]
    shapes = {*get_args(schema.Shape), schema.ShapePart}
    types.sort(key=lambda one: (one is not schema.SceneFile, one in shapes))
    return types


def _section(section: type[Section]) -> str:
    info = mi.type_info(section)
    if not isinstance(info, mi.StructType):
        raise TypeError(section)
    kind = f" (`kind: {info.tag}`)" if info.tag else ""
    lines = [f"## {section.__name__}{kind}\n", f"{section.__doc__}\n"]
    lines += ["| setting | takes | unit | default | meaning |", "|---|---|---|---|---|"]
    for field in info.fields:
        meta, inner = _described(field.type)
        unit = (meta.get("extra") or {}).get("unit", "")
        lines.append(
            f"| `{field.name}` | {_takes(inner)} | {unit} | {_default(field)} "
            f"| {meta['description']} |"
        )
    return "\n".join([*lines, ""])


def _described(kind: mi.Type) -> tuple[dict[str, Any], mi.Type]:
    """A field's description and unit, and its bare type."""
    if isinstance(kind, mi.Metadata):
        schema_of = kind.extra_json_schema or {}
        return {"description": schema_of.get("description", ""), "extra": kind.extra}, kind.type
    return {"description": "", "extra": None}, kind


def _takes(kind: mi.Type) -> str:
    """What a type allows, in words."""
    _, kind = _described(kind)
    match kind:
        case mi.BoolType():
            words = "true, false"
        case mi.FloatType() | mi.IntType():
            words = _number(kind)
        case mi.LiteralType(values=values):
            words = ", ".join(f"`{value}`" for value in values)
        case mi.StructType(cls=cls):
            words = f"[{cls.__name__}](#{_anchor(kind)})"
        case mi.UnionType(types=types):
            kinds = [one for one in types if not isinstance(one, (mi.NoneType, mi.CustomType))]
            words = " or ".join(_takes(one) for one in kinds)
        case mi.TupleType(item_types=items):
            words = f"{len(items)} x {_takes(items[0])}"
        case mi.VarTupleType(item_type=item):
            words = f"list of {_takes(item)}"
        case mi.DictType(value_type=value):
            words = f"names with {_takes(value)}"
        case _:
            words = "text"
    return words


def _number(kind: mi.FloatType | mi.IntType) -> str:
    name = "integer" if isinstance(kind, mi.IntType) else ""
    low = _bound(kind.ge, "[{:g}") or _bound(kind.gt, "({:g}")
    high = _bound(kind.le, "{:g}]") or _bound(kind.lt, "{:g})")
    if low or high:
        return f"{name} {low or '(-∞'}, {high or '∞)'}".lstrip()
    return name or "number"


def _bound(limit: float | None, form: str) -> str:
    return "" if limit is None else form.format(limit)


def _anchor(kind: mi.StructType) -> str:
    """How the heading of a section is linked to."""
    tag = f"-kind-{kind.tag}" if kind.tag else ""
    return f"{kind.cls.__name__}{tag}".lower()


def _default(field: mi.Field) -> str:
    value = field.default
    if field.required:
        return "required"
    if value is UNSET:
        return "the model's"
    if value in (None, NODEFAULT):
        return "none"
    if isinstance(value, Section):
        return "its own"
    if isinstance(value, tuple):
        return f"{list(value)}"
    return f"{value}".lower() if isinstance(value, bool) else f"{value}"


if __name__ == "__main__":
    PAGE.write_text(reference(), encoding="utf-8")
