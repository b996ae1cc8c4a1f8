"""The settings' types as a JSON Schema, for editors and other programs."""

from typing import Any

import msgspec

from mapperd.config.aliases import ALIASES, IGNORED, VALUE_ALIASES
from mapperd.config.tree import Config

__all__ = ["json_schema"]

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema() -> dict[str, Any]:
    """Schema of a settings file; every setting has its `x-unit` and `x-dynamic`.

    Rules about several settings are beyond it: what it lets through may still be refused.
    """
    schema = {"$schema": DIALECT, **msgspec.json.schema(Config)}
    _add_other_names(schema)
    for name in IGNORED:
        ignored = {"deprecated": True, "description": "Ignored: it has no effect."}
        _fields(schema, name)[_last(name)] = ignored
    return schema


def _fields(schema: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the properties of a setting's section, which may have ignored settings only."""
    ignored = {"type": "object", "properties": {}, "additionalProperties": False}
    sections = schema["$defs"]["Config"]["properties"]
    section = sections.setdefault(name.partition(".")[0], ignored | {"deprecated": True})
    if "$ref" not in section:
        return section["properties"]  # type: ignore[no-any-return]
    properties: dict[str, Any] = schema["$defs"][_last(section["$ref"], "/")]["properties"]
    return properties


def _add_other_names(schema: dict[str, Any]) -> None:
    """Accept files with settings or values under their other names."""
    inner: dict[str, Any] = {}
    for other, name in ALIASES.items():
        fields = _fields(schema, name)
        known = {k: v for k, v in fields[_last(name)].items() if k != "default"}
        if name in VALUE_ALIASES:
            known |= {"enum": [*known["enum"], *VALUE_ALIASES[name]]}
        place = inner if ".initial_pose." in other else fields
        place[_last(other)] = known | {"deprecated": True}
    for name, values in VALUE_ALIASES.items():
        field = _fields(schema, name)[_last(name)]
        field["enum"] = [*field["enum"], *values]
    _fields(schema, "amcl.initial_pose")["initial_pose"] = {
        "type": "object",
        "properties": inner,
        "additionalProperties": False,
        "deprecated": True,
    }


def _last(name: str, mark: str = ".") -> str:
    return name.rpartition(mark)[2]
