"""What sections of a scene's file are made of: a field's meaning, unit and limits."""

from typing import Annotated, Any

from msgspec import Meta, Struct

Number3 = tuple[float, float, float]
Limits = float


def says(description: str, unit: str = "", **limits: Limits) -> Meta:
    """A field's meaning, unit and limits."""
    known: dict[str, Any] = dict(limits)
    return Meta(description=description, extra={"unit": unit}, **known)


Metres = Annotated[float, says("", "m", ge=-1e5, le=1e5)]
Length = Annotated[float, says("", "m", gt=0, le=1e4)]
Point = tuple[Metres, Metres, Metres]
Size = tuple[Length, Length, Length]
Span = tuple[Metres, Metres]
Degrees3 = tuple[float, float, float]


class Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A mapping whose keys are known."""
