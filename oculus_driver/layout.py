"""Structures on the wire, declared once, field by field, and used in both directions."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from oculus_driver.errors import EncodeError, ProtocolError

if TYPE_CHECKING:
    from collections.abc import Mapping

U8 = "B"
U16 = "H"
U32 = "I"
F64 = "d"


@dataclass(frozen=True, slots=True)
class Field:
    """One field: where it lies and what it holds.

    Attributes:
        name: unique inside its layout, with the unit where there is one.
        offset: bytes from the start of the message; checked against the fields before it.
        code: `struct` code of one value, such as "H" or "6s".
        count: number of values; more than one is read as a tuple.
        default: what is packed where no value is given.
    """

    name: str
    offset: int
    code: str
    count: int = 1
    default: Any = 0


@dataclass(frozen=True)
class Layout:
    """A packed little-endian structure without gaps.

    Raises:
        ProtocolError: on construction, if a field's offset or the size is not what the fields
            before it add up to: a slip of the pen in a declaration is found at import.
    """

    name: str
    size: int
    fields: tuple[Field, ...]
    _struct: struct.Struct = field(init=False, repr=False, compare=False)
    _offsets: dict[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        end = 0
        for item in self.fields:
            if item.offset != end:
                raise ProtocolError(f"{self.name}.{item.name} declared at {item.offset}, is {end}")
            end += struct.calcsize("<" + item.code) * item.count
        if end != self.size:
            raise ProtocolError(f"{self.name} declared with {self.size} bytes, has {end}")
        codes = "<" + "".join(item.code * item.count for item in self.fields)
        offsets = {item.name: item.offset for item in self.fields}
        if len(offsets) != len(self.fields):
            raise ProtocolError(f"{self.name} names a field twice")
        object.__setattr__(self, "_struct", struct.Struct(codes))
        object.__setattr__(self, "_offsets", offsets)

    def offset_of(self, name: str) -> int:
        """Return the offset in bytes of the field `name`."""
        return self._offsets[name]

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """Return the structure's bytes; fields not in `values` take their defaults.

        Raises:
            EncodeError: a name that the layout does not have, or a value outside its type.
        """
        unknown = values.keys() - self._offsets.keys()
        if unknown:
            raise EncodeError(f"{self.name} has no field {', '.join(sorted(unknown))}")
        flat: list[Any] = []
        for item in self.fields:
            value = values.get(item.name, item.default)
            if item.count == 1:
                flat.append(value)
            else:
                flat.extend(value if item.name in values else (item.default,) * item.count)
        try:
            return self._struct.pack(*flat)
        except (struct.error, OverflowError, TypeError) as error:
            raise EncodeError(f"{self.name}: {error}") from error

    def unpack(self, data: bytes | bytearray | memoryview, offset: int = 0) -> dict[str, Any]:
        """Return the fields of the structure that starts at `offset`.

        Raises:
            ProtocolError: fewer bytes than the structure needs.
        """
        if offset < 0 or len(data) - offset < self.size:
            raise ProtocolError(f"{self.name} needs {self.size} bytes, {len(data) - offset} given")
        flat = iter(self._struct.unpack_from(data, offset))
        return {
            item.name: next(flat)
            if item.count == 1
            else tuple(next(flat) for _ in range(item.count))
            for item in self.fields
        }
