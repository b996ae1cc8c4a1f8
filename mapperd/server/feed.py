"""Events for one client: it is told what it has not seen, as fast as it reads."""

from typing import Any

from mapperd.events import EventLog

__all__ = ["EventFeed"]

AT_ONCE = 200


class EventFeed:
    """Where a client is in the log; nothing is kept for it.

    Args:
        log: what happened.
        since: number of the last event that the client has.
    """

    def __init__(self, log: EventLog, since: int) -> None:
        self._log = log
        self._since = min(since, log.last)

    def take(self) -> dict[str, Any]:
        """The next events, at most `AT_ONCE`.

        Returns:
            `events`; `missed`, before them, because they are not kept any more; `more` if there
            are more.
        """
        found, missed = self._log.since(self._since)
        taken = found[:AT_ONCE]
        if taken:
            self._since = taken[-1].number
        return {
            "events": [event.plain() for event in taken],
            "missed": missed,
            "more": len(found) > len(taken),
        }
