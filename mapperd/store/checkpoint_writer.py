"""Objects become bytes. Long rows of equal objects become columns: they are most of it."""

import types
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from enum import Enum
from operator import attrgetter
from typing import Any, Literal

import msgspec
import numpy as np
from msgspec import Struct

from mapperd.store.checkpoint_registry import (
    FORMAT,
    Tag,
    attributes_of,
    is_frozen,
    kept_of,
    name_of,
)

__all__ = ["written"]

LONG = 16
"""Rows of so many objects are written as columns."""

PLAIN = frozenset({type(None), bool, float, str, bytes})
FUNCTIONS = (
    types.FunctionType,
    types.MethodType,
    types.BuiltinFunctionType,
    types.MethodWrapperType,
)
_INT64 = range(-(2**63), 2**63)

Written = Any
"""What MessagePack can hold."""


def written(*roots: object) -> bytes:
    """The state of some objects and all that they hold.

    Where two of them hold the same object, they do so again when they are read.

    Raises:
        TypeError: something is in it that no checkpoint can hold; our own mistake.
    """
    writer = _Writer()
    return msgspec.msgpack.encode([FORMAT, [writer.value(root) for root in roots]])


class _Writer:
    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}  # of objects that can change, by id
        self._alive: list[object] = []  # so that no id is used twice

    def value(self, value: object) -> Written:
        kind = type(value)
        if kind in PLAIN:
            return value
        if kind in _WAYS:
            return _WAYS[kind](self, value)
        if isinstance(value, Enum):
            return [Tag.ENUM, name_of(kind), value.name]
        if isinstance(value, Struct):
            return [Tag.STRUCT, name_of(kind), msgspec.to_builtins(value)]
        return [Tag.KEPT] if isinstance(value, FUNCTIONS) else self.object_(value)

    def _values(self, values: Iterable[object]) -> list[Written]:
        return [self.value(one) for one in values]

    def object_(self, value: object) -> Written:
        kind = type(value)
        name = name_of(kind)
        if not is_frozen(kind):
            number = self._numbers.get(id(value))
            if number is not None:
                return [Tag.AGAIN, number]
            self._numbers[id(value)] = len(self._numbers)
            self._alive.append(value)
        kept = kept_of(name)
        held = [
            part
            for attribute, one in attributes_of(value)
            if attribute not in kept
            for part in (attribute, self.value(one))
        ]
        return [Tag.OBJECT, name, held]

    def _row(self, values: Sequence[object]) -> list[Written]:
        columns = self._columns(values) if len(values) >= LONG else None
        return self._values(values) if columns is None else [[Tag.ROWS, len(values), columns]]

    def _columns(self, values: Sequence[object]) -> Written | None:
        """Frozen objects of one class, attribute by attribute; None where they are not alike."""
        kind = type(values[0])
        if kind in PLAIN or kind is int or any(type(one) is not kind for one in values):
            return None
        if not is_frozen(kind) or issubclass(kind, (Enum, Struct)):
            return None
        names = [name for name, _ in attributes_of(values[0])]
        columns = [
            part
            for name in names
            for part in (name, self._column(list(map(attrgetter(name), values))))
        ]
        return [name_of(kind), columns]

    def _column(self, values: list[Any]) -> Written:
        kind = type(values[0])
        if any(type(one) is not kind for one in values):
            return ["x", self._values(values)]
        if kind is type(None):
            return ["0"]
        if kind is int and all(one in _INT64 for one in values):
            return ["i", np.array(values, dtype=np.int64).tobytes()]
        if kind is float:
            return ["f", np.array(values, dtype=np.float64).tobytes()]
        if kind is np.ndarray and _alike(values):
            first = values[0]
            shape, write = list(first.shape), bool(first.flags.writeable)
            data = b"".join(map(np.ndarray.tobytes, values))
            return ["a", first.dtype.str, shape, write, data]
        columns = self._columns(values)
        return ["x", self._values(values)] if columns is None else ["o", columns]

    def deque_(self, value: "deque[object]") -> Written:
        return [Tag.DEQUE, value.maxlen, *self._row(value)]

    def list_(self, value: list[object]) -> Written:
        return [Tag.LIST, *self._row(value)]

    def tuple_(self, value: tuple[object, ...]) -> Written:
        return [Tag.TUPLE, *self._values(value)]

    def dict_(self, value: dict[object, object]) -> Written:
        tag = Tag.COUNTER if type(value) is Counter else Tag.DICT
        return [tag, *(self.value(part) for pair in value.items() for part in pair)]

    def set_(self, value: "set[Any] | frozenset[Any]") -> Written:
        tag = Tag.SET if type(value) is set else Tag.FROZENSET
        return [tag, *self._values(sorted(value))]

    def array_(self, value: "np.ndarray[Any, Any]") -> Written:
        if value.dtype.hasobject:
            raise TypeError("an array of objects cannot stand in a checkpoint")
        order = _order(value)
        data = value.tobytes(order)
        return [
            Tag.ARRAY,
            value.dtype.str,
            list(value.shape),
            order,
            bool(value.flags.writeable),
            data,
        ]


def _order(array: "np.ndarray[Any, Any]") -> Literal["C", "F"]:
    """Products round by it, so it is kept; slices of larger arrays are taken for rows."""
    return "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"


def _alike(arrays: "list[np.ndarray[Any, Any]]") -> bool:
    first = arrays[0]
    return not first.dtype.hasobject and all(
        one.shape == first.shape
        and one.dtype == first.dtype
        and _order(one) == "C"
        and one.flags.writeable == first.flags.writeable
        for one in arrays
    )


_WAYS: dict[type, Any] = {
    int: lambda _, value: value if value in _INT64 else [Tag.BIG, str(value)],
    list: _Writer.list_,
    tuple: _Writer.tuple_,
    dict: _Writer.dict_,
    Counter: _Writer.dict_,
    deque: _Writer.deque_,
    set: _Writer.set_,
    frozenset: _Writer.set_,
    np.ndarray: _Writer.array_,
    bytearray: lambda _, value: [Tag.BYTEARRAY, bytes(value)],
    **{
        kind: lambda _, value: [Tag.SCALAR, value.dtype.str, value.tobytes()]
        for kind in (np.float64, np.float32, np.int64, np.int32, np.uint32, np.uint8, np.bool_)
    },
}
