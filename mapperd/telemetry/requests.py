"""What is asked through the broker: commands and changes of settings, each with its answer."""

import asyncio
from collections import Counter, OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from mapperd.api import DaemonApi, OperationError, PoseRequest
from mapperd.config.live import Refused
from mapperd.errors import MapperdError
from mapperd.telemetry.outbox import Kind, QueuedMessage
from mapperd.telemetry.payloads import encoded
from mapperd.telemetry.topics import Asked, Topics

__all__ = ["ORIGIN", "TelemetryRequests"]

ORIGIN = "mqtt"

MAX_WAITING = 16
MAX_BYTES = 4096
MAX_ID = 64
MAX_NUMBER = 2**63
REMEMBERED = 64
"""Answers by request id, so that a request that comes twice is done once."""

WITH_ARGUMENTS = ("save", "initial_pose", "set_map")

Id = str | int | None
Answer = dict[str, Any]


class _BadRequestError(Exception):
    """What was sent is no request."""


@dataclass(frozen=True, slots=True)
class _PendingAnswer:
    asked: Asked
    id: Id
    body: Any


class TelemetryRequests:
    """Obeys one request after the other.

    Args:
        operations: the daemon.
        topics: where requests come from and answers go to.
        put: takes the answers.

    Attributes:
        counts: `done`, `refused`, `repeated`; of those that get no answer `retained` (a broker's
            memory is no wish, nor is clearing it), `no_request` (nothing we know the name of)
            and `too_many`.
    """

    def __init__(
        self, operations: DaemonApi, topics: Topics, put: Callable[[QueuedMessage], None]
    ) -> None:
        self._operations = operations
        self._topics = topics
        self._put = put
        self._waiting: asyncio.Queue[_PendingAnswer] = asyncio.Queue(MAX_WAITING)
        self._answers: OrderedDict[tuple[Asked, Id], bytes] = OrderedDict()
        self.counts: Counter[str] = Counter()

    def offer(self, topic: str, payload: bytes, *, retained: bool) -> None:
        """Take a message that came; never waits."""
        asked = self._topics.asked(topic)
        if asked is None:
            self.counts["no_request"] += 1
        elif retained or not payload:  # nothing is what takes a retained message away
            self.counts["retained"] += 1
        elif self._waiting.full():
            self.counts["too_many"] += 1
        else:
            try:
                request = _request(asked, payload)
            except _BadRequestError as error:
                self._answer(asked, None, _refusal("bad_request", str(error)))
            else:
                self._waiting.put_nowait(request)

    async def work(self) -> None:
        """Obey, until cancelled."""
        while True:
            request = await self._waiting.get()
            known = self._answers.get((request.asked, request.id))
            if known is not None and request.id is not None:
                self.counts["repeated"] += 1
                self._publish(request.asked, known)
                continue
            self._answer(request.asked, request.id, await self._obeyed(request))

    async def _obeyed(self, request: _PendingAnswer) -> Answer:
        try:
            if request.asked.kind == "config":
                return await asyncio.to_thread(self._set, request.asked.name, request.body)
            return {"ok": True, "result": await self._command(request.asked.name, request.body)}
        except _BadRequestError as error:
            return _refusal("bad_request", str(error))
        except OperationError as error:
            return _refusal(error.reason, str(error))
        except MapperdError as error:
            return _refusal("refused", str(error))
        except Exception as error:  # noqa: BLE001 a fault of ours costs the request, not the daemon
            return _refusal("internal_error", f"{type(error).__name__}: {error}")

    def _set(self, name: str, value: object) -> Answer:
        """In a thread: who follows a setting may wait for the end of a ping."""
        result = self._operations.settings.apply({name: value}, ORIGIN)
        if isinstance(result, Refused):
            reasons = "; ".join(f"{where}: {why}" for where, why in result.reasons.items())
            return _refusal("refused", reasons)
        return {"ok": True, "value": value}

    def _command(self, name: str, body: Mapping[str, Any]) -> Awaitable[dict[str, Any]]:
        operations = self._operations
        plain = {
            "reset": operations.reset,
            "clear": operations.reset,
            "reload": operations.reload,
            "snapshot": operations.snapshot,
            "global_localization": operations.global_localization,
            "request_nomotion_update": operations.request_nomotion_update,
        }
        if name in plain:
            _allow(body)
            return plain[name](ORIGIN)
        match name if name in WITH_ARGUMENTS else self._topics.also.get(name):
            case "save":
                _allow(body, "name")
                return operations.save(_text(body, "name"), ORIGIN)
            case "initial_pose":
                _allow(body, "pose")
                return operations.initial_pose(_pose(body), ORIGIN)
            case "set_map":
                _allow(body, "name", "pose")
                pose = _pose(body) if "pose" in body else None
                return operations.set_map(_text(body, "name"), pose, ORIGIN)
        known = ", ".join([*WITH_ARGUMENTS, *plain])
        raise OperationError(f"there is no such command; there are {known}", "unknown_command")

    def _answer(self, asked: Asked, request_id: Id, answer: Answer) -> None:
        self.counts["done" if answer["ok"] else "refused"] += 1
        payload = encoded({"id": request_id, **answer})
        if request_id is not None:
            self._answers[asked, request_id] = payload
            if len(self._answers) > REMEMBERED:
                self._answers.popitem(last=False)
        self._publish(asked, payload)

    def _publish(self, asked: Asked, payload: bytes) -> None:
        self._put(QueuedMessage(self._topics.result(asked), payload, Kind.ANSWER, qos=1))


def _request(asked: Asked, payload: bytes) -> _PendingAnswer:
    """Read a payload: of a command an object with an id, of a setting a value or such an object."""
    if len(payload) > MAX_BYTES:
        raise _BadRequestError(f"{len(payload)} bytes; at most {MAX_BYTES}")
    try:
        body = msgspec.json.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _BadRequestError(f"not JSON: {error}") from error
    if asked.kind == "config":
        if isinstance(body, dict) and "value" in body:
            _allow(body, "id", "value")
            return _PendingAnswer(asked, _id_of(body), body["value"])
        return _PendingAnswer(asked, None, body)
    if not isinstance(body, dict) or body.get("id") is None:
        raise _BadRequestError('an object with an "id" of your choice is wanted')
    request_id = _id_of(body)
    return _PendingAnswer(asked, request_id, {key: one for key, one in body.items() if key != "id"})


def _id_of(body: Mapping[str, Any]) -> Id:
    request_id = body.get("id")
    if isinstance(request_id, bool) or not isinstance(request_id, str | int | None):
        raise _BadRequestError("id: a text or a whole number is wanted")
    if isinstance(request_id, int) and abs(request_id) >= MAX_NUMBER:
        raise _BadRequestError("id: at most 63 bits")
    if len(str(request_id)) > MAX_ID:
        raise _BadRequestError(f"id: at most {MAX_ID} characters")
    return request_id


def _pose(body: Mapping[str, Any]) -> PoseRequest:
    try:
        return msgspec.convert(body.get("pose"), PoseRequest)
    except msgspec.ValidationError as error:
        raise _BadRequestError(f"pose: {error}") from error


def _text(body: Mapping[str, Any], key: str) -> str:
    if not isinstance(body.get(key), str):
        raise _BadRequestError(f"{key}: expected a string")
    return str(body[key])


def _allow(body: Mapping[str, Any], *keys: str) -> None:
    for key in body:
        if key not in keys:
            raise _BadRequestError(f"{key[:60]}: is not known here")


def _refusal(reason: str, text: str) -> Answer:
    return {"ok": False, "reason": reason, "text": text}
