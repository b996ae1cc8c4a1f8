"""What settings there are: the tree of types, seen as a flat list of named parameters."""

import functools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta, Struct

from mapperd.config.tree import Config

__all__ = [
    "Parameter",
    "hint_at",
    "inner_parameters",
    "parameters",
    "rule_text",
    "section_of",
    "value_of",
]

SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One setting.

    Attributes:
        name: its place in the tree, `octree.voxel_resolution`; fields of the sections of a list
            have `[]` behind the list's name.
        default: as plain values; `msgspec.UNSET` if it is required.
        unit: or the scale, or nothing.
        allowed: the values that it takes, for people.
        description: one sentence or two.
        dynamic: it may change while the program runs.
        annotation: its type with its limits.
    """

    name: str
    default: Any
    unit: str
    allowed: str
    description: str
    dynamic: bool
    annotation: Any


@functools.cache
def parameters() -> Mapping[str, Parameter]:
    """All settings that can be set on their own, by name, in the order of the tree."""
    found = {
        parameter.name: parameter
        for parameter in _walk(Config, "", msgspec.to_builtins(Config()), inside=False)
    }
    return MappingProxyType(found)


def inner_parameters(parameter: Parameter) -> list[Parameter]:
    """The fields of a setting that is a list of sections, or a section or nothing."""
    section = section_of(parameter.annotation)
    if section is None:
        return []
    mark = "[]" if get_origin(_plain(parameter.annotation)) is tuple else ""
    return list(_walk(section, f"{parameter.name}{mark}.", _defaults(section), inside=True))


def value_of(config: Config, name: str) -> Any:  # noqa: ANN401 whatever the setting holds
    """The value of a setting, as plain values."""
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return msgspec.to_builtins(value)


def hint_at(path: str) -> Any:  # noqa: ANN401 a type or an annotation
    """The annotation of a setting, or the class of a section, at `$.odometry.sources[0].link`.

    Returns:
        None where there is no such place.
    """
    hint: Any = Config
    for part in path.split(".")[1:]:
        field, *indices = re.split(r"\[[^\]]*\]", part)
        section = section_of(hint)
        hint = None if section is None else _hints(section).get(field)
        if indices:
            hint = section_of(hint)
    return hint


def section_of(hint: Any) -> type[Struct] | None:  # noqa: ANN401 a type or an annotation
    """The section that a place holds, be it in a list, or possibly nothing."""
    plain = _plain(hint)
    candidates = [plain, *get_args(plain)]
    return next((kind for kind in candidates if hasattr(kind, "__struct_fields__")), None)


def rule_text(path: str) -> str | None:
    """What a setting allows, for people: "a number >= 0.001 and <= 100 (m)".

    Args:
        path: `$.octree.voxel_resolution`.

    Returns:
        None where the path names no single setting.
    """
    hint = hint_at(path)
    return None if get_origin(hint) is not Annotated else _allowed(hint)


def _allowed(hint: Any) -> str:  # noqa: ANN401 an annotation
    base, meta = _plain(hint), hint.__metadata__[0]
    section = section_of(hint)
    if section is not None:
        names = ", ".join(section.__struct_fields__)
        if get_origin(base) is tuple:
            return f"a list of {meta.min_length} to {meta.max_length} sections of {names}"
        return f"nothing or a section of {names}"
    if base is bool:
        return "true or false"
    if base is str:
        return str(meta.extra_json_schema["x-unit"])
    if get_origin(base) is not None:
        return " or ".join(str(choice) for choice in get_args(base))
    return _number(base, meta)


def _number(base: type, meta: Meta) -> str:
    limits = [f"{s} {getattr(meta, k):g}" for k, s in SIGNS.items() if getattr(meta, k) is not None]
    kind = "a whole number" if base is int else "a number"
    unit = (meta.extra_json_schema or {})["x-unit"]
    return f"{kind} {' and '.join(limits)}" + (f" ({unit})" if unit else "")


def _walk(
    section: type[Struct], prefix: str, defaults: Mapping[str, Any], *, inside: bool
) -> Iterator[Parameter]:
    for field, hint in _hints(section).items():
        if get_origin(hint) is Annotated:
            meta = hint.__metadata__[0]
            default = defaults.get(field, msgspec.UNSET)
            marks = meta.extra_json_schema
            unit, dynamic = marks["x-unit"], marks["x-dynamic"] and not inside
            allowed, about = _allowed(hint), meta.description
            yield Parameter(f"{prefix}{field}", default, unit, allowed, about, dynamic, hint)
        else:
            yield from _walk(hint, f"{prefix}{field}.", defaults[field], inside=inside)


def _defaults(section: type[Struct]) -> dict[str, Any]:
    known = (field for field in msgspec.structs.fields(section) if not field.required)
    return {field.name: msgspec.to_builtins(field.default) for field in known}


@functools.cache
def _hints(section: type[Struct]) -> dict[str, Any]:
    return get_type_hints(section, include_extras=True)


def _plain(hint: Any) -> Any:  # noqa: ANN401 a type or an annotation
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint
