"""Bytes become objects: freshly built ones are overlaid with what was saved of their like.

Whatever is in the bytes, nothing is called but the classes of the registry, without arguments and
without their `__init__`. A fresh object that was overlaid with damaged bytes is of no use any more.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from mapperd.config.aliases import tree_updated
from mapperd.config.tree import Config
from mapperd.errors import CheckpointError
from mapperd.store.checkpoint_registry import (
    FORMAT,
    Tag,
    attributes_of,
    class_named,
    is_frozen,
    kept_of,
)

__all__ = ["overlay"]

_ABSENT = object()
_FAULTS = (TypeError, ValueError, KeyError, IndexError, AttributeError, RecursionError)

Prepare = Callable[[Any, dict[str, Any]], None]
"""Given a fresh object and its saved attributes, the plain ones."""


def overlay(
    data: bytes, *roots: object, prepare: Mapping[type, Prepare] | None = None
) -> tuple[Any, ...]:
    """Give objects the state that `written` wrote of such objects.

    Args:
        data: of `written`.
        roots: built with the same settings, in the same order; None takes any value.
        prepare: class to what is called with a fresh object of it and its saved attributes before
            they are read, to build what cannot be made without its maker.

    Returns:
        the roots, with values in the place of None.

    Raises:
        CheckpointError: the bytes are damaged or of another program; the roots are of no use.
    """
    try:
        version, values = msgspec.msgpack.decode(data)
        if version != FORMAT or len(values) != len(roots):
            raise CheckpointError(f"is of another program (format {version!r})")
        reader = _Reader(prepare or {})
        found = tuple(reader.value(value, root) for value, root in zip(values, roots, strict=True))
    except (msgspec.DecodeError, *_FAULTS) as error:
        raise CheckpointError(f"cannot be read: {type(error).__name__}: {error}") from error
    if any(root is not None and one is not root for one, root in zip(found, roots, strict=True)):
        raise CheckpointError("is of other objects")
    return found


class _Reader:
    def __init__(self, prepare: Mapping[type, Prepare]) -> None:
        self._prepare = prepare
        self._objects: list[object] = []

    def value(self, saved: Any, fresh: Any = _ABSENT) -> Any:  # noqa: ANN401 any state
        if not isinstance(saved, list):
            return saved
        tag, *parts = saved
        return _READERS[tag](self, parts, fresh)

    def kept_(self, _: list[Any], fresh: Any) -> Any:  # noqa: ANN401
        if fresh is _ABSENT:
            raise CheckpointError("holds an object that only a program can make")
        return fresh

    def object_(self, parts: list[Any], fresh: Any) -> Any:  # noqa: ANN401
        name, held = parts
        kind = class_named(name)
        made = type(fresh) is not kind or is_frozen(kind)
        target = object.__new__(kind) if made else fresh
        if not is_frozen(kind):
            self._objects.append(target)
        saved = dict(zip(held[::2], held[1::2], strict=True))
        if not made:
            self._check_names(name, saved, target)
            if kind in self._prepare:
                self._prepare[kind](target, {key: self._peek(one) for key, one in saved.items()})
        for attribute, one in saved.items():
            before = _ABSENT if made else getattr(target, attribute)
            after = self.value(one, before)
            if after is not before:
                object.__setattr__(target, attribute, after)
        return target

    def _peek(self, saved: Any) -> Any:  # noqa: ANN401
        """A value, where it is plain or a dictionary of plain ones; else None."""
        if isinstance(saved, list):
            plain = saved[0] == Tag.DICT and not any(isinstance(one, list) for one in saved)
            return dict(zip(saved[1::2], saved[2::2], strict=True)) if plain else None
        return saved

    @staticmethod
    def _check_names(name: str, saved: dict[str, Any], fresh: object) -> None:
        expected = {attribute for attribute, _ in attributes_of(fresh)} - kept_of(name)
        if saved.keys() != expected:
            differ = ", ".join(sorted(saved.keys() ^ expected))
            raise CheckpointError(f"is of another program: {name} differs in {differ}")

    def again_(self, parts: list[Any], _: Any) -> Any:  # noqa: ANN401
        return self._objects[parts[0]]

    def _row(self, saved: Sequence[Any], fresh: Any) -> list[Any]:  # noqa: ANN401
        if len(saved) == 1 and isinstance(saved[0], list) and saved[0][0] == Tag.ROWS:
            _, count, columns = saved[0]
            return self._columns(columns, count)
        old = list(fresh) if isinstance(fresh, (list, deque, tuple)) else []
        old += [_ABSENT] * (len(saved) - len(old))
        return [self.value(one, before) for one, before in zip(saved, old, strict=False)]

    def _columns(self, columns: list[Any], count: int) -> list[Any]:
        name, held = columns
        kind = class_named(name)
        made = [object.__new__(kind) for _ in range(count)]
        put = object.__setattr__
        for attribute, column in zip(held[::2], held[1::2], strict=True):
            for one, value in zip(made, self._column(column, count), strict=True):
                put(one, attribute, value)
        return made

    def _column(self, column: list[Any], count: int) -> list[Any]:
        tag, *parts = column
        if tag == "0":
            return [None] * count
        if tag == "x":
            return [self.value(one) for one in parts[0]]
        if tag == "o":
            return self._columns(parts[0], count)
        if tag == "a":
            dtype, shape, write, data = parts
            rows = np.frombuffer(data, dtype=_dtype(dtype)).reshape(count, *shape)
            # Each with memory of its own: the whole would live as long as any of them.
            arrays = [row.copy() for row in rows]
            for array in arrays:
                array.setflags(write=write)
            return arrays
        return list(np.frombuffer(parts[0], dtype={"i": np.int64, "f": np.float64}[tag]).tolist())

    def list_(self, parts: list[Any], fresh: Any) -> list[Any]:  # noqa: ANN401
        row = self._row(parts, fresh)
        if type(fresh) is not list:
            return row
        fresh[:] = row
        return fresh

    def tuple_(self, parts: list[Any], fresh: Any) -> tuple[Any, ...]:  # noqa: ANN401
        return tuple(self._row(parts, fresh))

    def deque_(self, parts: list[Any], fresh: Any) -> "deque[Any]":  # noqa: ANN401
        row = self._row(parts[1:], fresh)
        if type(fresh) is not deque or fresh.maxlen != parts[0]:
            return deque(row, parts[0])
        fresh.clear()
        fresh.extend(row)
        return fresh

    def dict_(
        self,
        parts: list[Any],
        fresh: Any,  # noqa: ANN401
        kind: type[dict[Any, Any]] = dict,
    ) -> dict[Any, Any]:
        old = fresh if isinstance(fresh, dict) else {}
        keys = [self.value(key) for key in parts[::2]]
        items = {
            key: self.value(one, old.get(key, _ABSENT))
            for key, one in zip(keys, parts[1::2], strict=True)
        }
        same: dict[Any, Any] = fresh if type(fresh) is kind else kind()
        same.clear()
        same.update(items)
        return same

    def counter_(self, parts: list[Any], fresh: Any) -> "dict[Any, Any]":  # noqa: ANN401
        return self.dict_(parts, fresh, Counter)

    def set_(self, parts: list[Any], fresh: Any) -> set[Any]:  # noqa: ANN401
        items = set(self._row(parts, None))
        if type(fresh) is not set:
            return items
        fresh.clear()
        fresh.update(items)
        return fresh

    def frozenset_(self, parts: list[Any], _: Any) -> frozenset[Any]:  # noqa: ANN401
        return frozenset(self._row(parts, None))

    def bytearray_(self, parts: list[Any], fresh: Any) -> bytearray:  # noqa: ANN401
        if type(fresh) is not bytearray:
            return bytearray(parts[0])
        fresh[:] = parts[0]
        return fresh

    def big_(self, parts: list[Any], _: Any) -> int:  # noqa: ANN401
        return int(parts[0])

    def enum_(self, parts: list[Any], _: Any) -> Any:  # noqa: ANN401
        return class_named(parts[0])[parts[1]]

    def struct_(self, parts: list[Any], _: Any) -> Any:  # noqa: ANN401
        kind, fields = class_named(parts[0]), parts[1]
        return msgspec.convert(tree_updated(fields)[0] if kind is Config else fields, kind)

    def array_(self, parts: list[Any], _: Any) -> Any:  # noqa: ANN401
        dtype, shape, order, write, data = parts
        array = np.frombuffer(data, dtype=_dtype(dtype)).reshape(shape, order=order)
        array = array.copy(order)
        array.setflags(write=write)
        return array

    def scalar_(self, parts: list[Any], _: Any) -> Any:  # noqa: ANN401
        return np.frombuffer(parts[1], dtype=_dtype(parts[0]))[0]


def _dtype(text: str) -> "np.dtype[Any]":
    kind = np.dtype(text)
    if kind.hasobject:
        raise CheckpointError("holds an array of objects")
    return kind


_READERS: dict[str, Callable[[_Reader, list[Any], Any], Any]] = {
    Tag.LIST: _Reader.list_,
    Tag.TUPLE: _Reader.tuple_,
    Tag.SET: _Reader.set_,
    Tag.FROZENSET: _Reader.frozenset_,
    Tag.DEQUE: _Reader.deque_,
    Tag.DICT: _Reader.dict_,
    Tag.COUNTER: _Reader.counter_,
    Tag.BYTEARRAY: _Reader.bytearray_,
    Tag.BIG: _Reader.big_,
    Tag.ENUM: _Reader.enum_,
    Tag.STRUCT: _Reader.struct_,
    Tag.ARRAY: _Reader.array_,
    Tag.SCALAR: _Reader.scalar_,
    Tag.OBJECT: _Reader.object_,
    Tag.AGAIN: _Reader.again_,
    Tag.KEPT: _Reader.kept_,
}
