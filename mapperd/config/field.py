"""Metadata of settings: description, unit, limits."""

from typing import Any

from msgspec import Meta

__all__ = ["rule"]


def rule(description: str, unit: str = "", *, live: bool = False, **limits: float | str) -> Meta:
    """Annotate a field with its description, unit, limits, and whether it may change live.

    The unit and `live` are `x-unit` and `x-dynamic` of the field's JSON Schema.
    """
    known: dict[str, Any] = dict(limits)
    marks = {"x-unit": unit, "x-dynamic": live}
    return Meta(description=description, extra_json_schema=marks, **known)
