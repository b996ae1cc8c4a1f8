"""Control requests of clients, as an `Ask` carries them: docs/reference/control.md."""

from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct, field

from mapperd.api import ChangeReport, PoseRequest

__all__ = [
    "EventsRequest",
    "Fault",
    "GetRequest",
    "GlobalLocalizationRequest",
    "InitialPoseRequest",
    "LocalizationRequest",
    "NoMotionUpdateRequest",
    "ParamsRequest",
    "ReloadRequest",
    "ReportRequest",
    "Request",
    "ResetRequest",
    "SaveRequest",
    "SetMapRequest",
    "SetRequest",
    "SnapshotRequest",
    "StatusRequest",
    "decode_request",
    "plain",
    "plain_map",
]

Id = Annotated[int, Meta(ge=0, le=2**53 - 1)]
Names = Annotated[list[str], Meta(max_length=1000)]


def _tag(name: str) -> str:
    return name.removesuffix("Request").lower()


class _WireRequest(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="do", tag=_tag
):
    id: Id


class StatusRequest(_WireRequest, frozen=True, kw_only=True):
    """Return the daemon's status."""


class ParamsRequest(_WireRequest, frozen=True, kw_only=True):
    """Return facts of settings or sections; no names request all."""

    names: Names = field(default_factory=list)


class GetRequest(_WireRequest, frozen=True, kw_only=True):
    """Return values of settings or sections."""

    names: Annotated[list[str], Meta(min_length=1, max_length=1000)]


class SetRequest(_WireRequest, frozen=True, kw_only=True):
    """Change settings, all or none."""

    changes: Annotated[dict[str, Any], Meta(min_length=1, max_length=1000)]


class SaveRequest(_WireRequest, frozen=True, kw_only=True):
    """Write the map to a file in the folder for maps."""

    name: Annotated[str, Meta(max_length=1000)]


class ResetRequest(_WireRequest, frozen=True, kw_only=True):
    """Empty the map."""


class ReloadRequest(_WireRequest, frozen=True, kw_only=True):
    """Read the settings' files again."""


class SnapshotRequest(_WireRequest, frozen=True, kw_only=True):
    """Write the map and the recording to disk."""


class EventsRequest(_WireRequest, frozen=True, kw_only=True):
    """Return the events after a number."""

    since: Id = 0


class LocalizationRequest(_WireRequest, frozen=True, kw_only=True):
    """Return the pose on the known map, and some of the particles."""

    particles: Annotated[int, Meta(ge=0, le=500)] = 0


class InitialPoseRequest(_WireRequest, frozen=True, kw_only=True, tag="initial_pose"):
    """Begin localization at a pose."""

    pose: PoseRequest


class GlobalLocalizationRequest(_WireRequest, frozen=True, kw_only=True, tag="global_localization"):
    """Begin localization anywhere on the map."""


class NoMotionUpdateRequest(_WireRequest, frozen=True, kw_only=True, tag="request_nomotion_update"):
    """Use the next scan as an update even without motion."""


class SetMapRequest(_WireRequest, frozen=True, kw_only=True, tag="set_map"):
    """Localize on another map, from a pose if it is given."""

    name: Annotated[str, Meta(max_length=1000)]
    pose: PoseRequest | None = None


class ReportRequest(_WireRequest, frozen=True, kw_only=True):
    """Report changes of the map against a known one; `begin` forgets earlier reports."""

    changes: Annotated[list[ChangeReport], Meta(max_length=100)]
    known: Annotated[str, Meta(max_length=100)] = ""
    begin: bool = False


Request = (
    StatusRequest
    | ParamsRequest
    | GetRequest
    | SetRequest
    | SaveRequest
    | ResetRequest
    | ReloadRequest
    | SnapshotRequest
    | EventsRequest
    | ReportRequest
    | LocalizationRequest
    | InitialPoseRequest
    | GlobalLocalizationRequest
    | NoMotionUpdateRequest
    | SetMapRequest
)


class Fault(Struct, frozen=True):
    """Why a request was not carried out.

    Attributes:
        reason: short and stable.
        message: one line for a person.
        details: plain values.
    """

    reason: str
    message: str
    details: dict[str, Any] = field(default_factory=dict)


class _AnyId(Struct, frozen=True):
    id: Id | None = None


_REQUESTS = msgspec.json.Decoder(Request)
_IDS = msgspec.json.Decoder(_AnyId)


def decode_request(raw: bytes) -> tuple[Request | Fault, int | None]:
    """Decode a request, one value of MessagePack.

    Returns:
        the request, or what is wrong with it; and its id, if it has one.
    """
    try:
        # Through JSON, in which requests are documented: no request has values that JSON lacks.
        line = msgspec.json.encode(msgspec.msgpack.decode(raw))
    except (msgspec.MsgspecError, TypeError, ValueError, OverflowError, RecursionError) as error:
        return Fault("bad_request", f"not a request: {error}"), None
    try:
        request = _REQUESTS.decode(line)
    except (msgspec.DecodeError, RecursionError) as error:
        return Fault("bad_request", f"not a request: {error}"), _id_of(line)
    return request, request.id


def plain(value: object) -> object:
    """Convert numbers of numpy to plain numbers, and other objects to text."""
    return value.item() if isinstance(value, np.generic) else str(value)


def plain_map(value: object) -> dict[str, Any]:
    """Return a map of plain values, as JSON holds them: NaN and infinities become null."""
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=plain), type=dict[str, Any])


def _id_of(line: bytes) -> int | None:
    try:
        return _IDS.decode(line).id
    except (msgspec.DecodeError, RecursionError):
        return None
