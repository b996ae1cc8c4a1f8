"""States of estimators as bytes: a versioned MessagePack of named tuples, numbers and arrays.

An object that a checkpoint holds has `state()`, which returns a named tuple, and `restore(state)`.
Named tuples are written by position: attributes may be renamed, and fields with a default may be
added at the end. Any other change of fields needs a new `FORMAT`.
"""

import re
from typing import Any, Final, Literal, TypeVar

import msgspec
import numpy as np

from mapperd.errors import CheckpointError

__all__ = ["FORMAT", "decode_state", "encode_state"]

FORMAT: Final = 2
"""Version of the format; checkpoints of others are not read."""

_ARRAY: Final = 1
"""Code of the extension type of an array."""

_DTYPE: Final = re.compile(r"[<>|][biuf][1248]")

_INT64_MIN, _UINT64_MAX = -(2**63), 2**64 - 1

T = TypeVar("T")


def encode_state(state: object) -> bytes:
    """Encode a state.

    Raises:
        TypeError: it holds an object that checkpoints cannot hold; a programming error.
    """
    try:
        return msgspec.msgpack.encode((FORMAT, state), enc_hook=_plain)
    except OverflowError:  # a sender's stamps may have any number of digits
        return msgspec.msgpack.encode((FORMAT, _with_text(state)), enc_hook=_plain)


def decode_state(data: bytes, kind: type[T]) -> T:
    """Decode a state from `encode_state`.

    Args:
        data: the bytes.
        kind: type of the state.

    Raises:
        CheckpointError: the bytes are damaged or of another format.
    """
    try:
        version, _ = msgspec.msgpack.decode(data, type=tuple[int, msgspec.Raw])
        if version != FORMAT:
            raise CheckpointError(f"the checkpoint has format {version}; allowed: {FORMAT}")
        _, state = msgspec.msgpack.decode(
            data,
            type=tuple[int, kind],  # type: ignore[valid-type]
            dec_hook=_array,
            ext_hook=_extension,
            strict=False,
        )
    except (msgspec.DecodeError, TypeError, ValueError, RecursionError) as error:
        raise CheckpointError(f"the checkpoint cannot be read: {error}") from error
    return state


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        if _DTYPE.fullmatch(value.dtype.str) is None:
            raise TypeError(f"an array of {value.dtype} cannot be in a checkpoint")
        # The order of an array affects rounding. Slices of larger arrays are stored by rows.
        order: Literal["C", "F"] = (
            "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
        )
        content = (value.dtype.str, value.shape, order, value.flags.writeable, value.tobytes(order))
        return msgspec.msgpack.Ext(_ARRAY, msgspec.msgpack.encode(content))
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__qualname__} cannot be in a checkpoint")


def _extension(code: int, data: memoryview) -> Any:  # noqa: ANN401 an array
    if code != _ARRAY:
        raise ValueError(f"an unknown extension {code}")
    dtype, shape, order, writeable, content = msgspec.msgpack.decode(
        data, type=tuple[str, tuple[int, ...], str, bool, bytes]
    )
    if _DTYPE.fullmatch(dtype) is None:
        raise ValueError(f"an array of {dtype[:20]!r}")
    flat = np.frombuffer(content, dtype=dtype)
    array = np.array(flat.reshape(shape, order="F" if order == "F" else "C"), order="K")
    array.setflags(write=writeable)
    return array


def _array(kind: type, value: object) -> object:
    """Check the type of a field that holds an array."""
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{kind} expected")
    return value


def _with_text(value: Any) -> Any:  # noqa: ANN401 any state
    """Return the state with integers of more than 64 bits as text."""
    if isinstance(value, int):
        return value if _INT64_MIN <= value <= _UINT64_MAX else str(value)
    if isinstance(value, dict):
        return {_with_text(key): _with_text(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_with_text(one) for one in value]
    return value
