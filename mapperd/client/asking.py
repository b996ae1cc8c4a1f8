"""Requests that wait for their answers."""

import asyncio
from typing import Any

from mapperd.client.errors import AskError
from mapperd.wire.messages import Answer

__all__ = ["Asking"]

UNDER_WAY = 8
"""A daemon cuts off who asks more at once."""


class Asking:
    """Each request of one client, from its number to its answer.

    Attributes:
        turn: held by each; more than a daemon takes wait for it.
    """

    def __init__(self) -> None:
        self.turn = asyncio.Semaphore(UNDER_WAY)
        self._number = 0
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}

    def begin(self) -> tuple[int, "asyncio.Future[dict[str, Any]]"]:
        """A number for a request, and what its answer will be."""
        self._number += 1
        answer = asyncio.get_running_loop().create_future()
        self._waiting[self._number] = answer
        return self._number, answer

    def end(self, number: int) -> None:
        """Nobody waits for it any more."""
        self._waiting.pop(number, None)

    def answered(self, answer: Answer) -> None:
        """Give an answer to who waits for it; one that nobody waits for is passed over."""
        waiting = self._waiting.pop(answer.id, None) if answer.id is not None else None
        if waiting is None or waiting.done():
            return
        if answer.error is None:
            waiting.set_result(answer.result or {})
            return
        reason = str(answer.error.get("reason", "failed"))
        details = answer.error.get("details")
        waiting.set_exception(
            AskError(
                reason,
                str(answer.error.get("message", reason)),
                details if isinstance(details, dict) else None,
            )
        )

    def lose_all(self) -> None:
        """The connection is gone, and with it all answers; some requests may have been obeyed."""
        waiting, self._waiting = self._waiting, {}
        for answer in waiting.values():
            if not answer.done():
                what = "the connection broke before the answer; it may have been done"
                answer.set_exception(AskError("link_lost", what))
