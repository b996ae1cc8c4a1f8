"""Changes that a reader has not taken yet, in bounded memory."""

import threading
from collections import OrderedDict, deque
from collections.abc import Callable

import msgspec
import numpy as np

from mapperd.client.changes import ClientChange, LinkChanged, MapChanged, MapReset
from mapperd.client.mirror import keys_of, names_of
from mapperd.client.state import ClientState
from mapperd.client.validation import size_of
from mapperd.wire.blocks import path_message
from mapperd.wire.messages import EventMessage, PathMessage, SettingsMessage

__all__ = ["ChangeQueue"]

MAX_KEYS = 1 << 17
MAX_EVENTS, MAX_EVENT_BYTES = 1000, 1 << 20
NO_KEYS = np.zeros((0, 3), np.int32)


class ChangeQueue:
    """Changes in order; waiting changes of one kind are merged.

    Changes of the map, the path and the settings are united. The newest events are kept and the
    others counted. Of all other kinds the newest change is kept. If too many blocks changed, the
    reader gets the whole map again. Any thread may add and take.

    Args:
        client_state: state of the client; the queue begins with all of it.
        link: state of the connection.
        news: called after a change was added.
    """

    def __init__(
        self, client_state: ClientState, link: LinkChanged, news: Callable[[], None]
    ) -> None:
        self._client_state = client_state
        self._news = news
        self._lock = threading.Lock()
        self._waiting: OrderedDict[type, ClientChange] = OrderedDict()
        self._events: deque[tuple[EventMessage, int]] = deque()
        self._events_lost = self._event_bytes = 0
        self._keys: dict[bytes, None] = {}
        self._is_all = False
        self._add_all(link)

    def add(self, change: ClientChange) -> None:
        """Add a change."""
        with self._lock:
            self._add(change)
        self._news()

    def take(self) -> ClientChange | None:
        """Remove and return the next change; None if there is none."""
        with self._lock:
            if not self._waiting:
                return None
            kind, change = self._waiting.popitem(last=False)
            if kind is EventMessage:
                return self._taken_event()
            if isinstance(change, PathMessage):
                return path_message(change.first, self._client_state.path[change.first :])
            if not isinstance(change, MapChanged):
                return change
            keys, self._keys = self._keys, {}
            is_all, self._is_all = self._is_all, False
        # Without the lock: a thread that holds the mirror's lock may call `take` too.
        mirror = self._client_state.mirror
        changed = mirror.keys() if is_all and mirror is not None else keys_of(keys)
        return MapChanged(changed, change.stamp_ns, change.left)

    def _add_all(self, link: LinkChanged) -> None:
        client_state = self._client_state
        self._add(link)
        if client_state.mirror is not None:
            self._add(MapReset(client_state.mirror.info))
            self._is_all = True
            self._add(MapChanged(NO_KEYS, 0, 0))
        if len(client_state.path):
            self._add(PathMessage(first=0, points=b""))
        if client_state.settings:
            self._add(SettingsMessage(facts=client_state.settings))
        for change in client_state.newest.values():
            self._add(change)

    def _add(self, change: ClientChange) -> None:
        waiting = self._waiting
        kind = type(change)
        before = waiting.get(kind)
        if isinstance(change, MapReset):
            self._keys, self._is_all = {}, False
            waiting.pop(MapChanged, None)
            waiting.pop(MapReset, None)
        elif isinstance(change, MapChanged):
            self._add_keys(change)
        elif isinstance(change, EventMessage):
            self._add_event(change)
        elif isinstance(change, PathMessage) and isinstance(before, PathMessage):
            change = PathMessage(first=min(before.first, change.first), points=b"")
        elif isinstance(change, SettingsMessage) and isinstance(before, SettingsMessage):
            change = SettingsMessage(facts={**before.facts, **change.facts})
        waiting[kind] = change
        if kind is LinkChanged:
            waiting.move_to_end(kind)

    def _add_keys(self, change: MapChanged) -> None:
        if not self._is_all:
            self._keys.update(dict.fromkeys(names_of(change.keys)))
        mirror = self._client_state.mirror
        if len(self._keys) > MAX_KEYS and mirror is not None:
            self._add(MapReset(mirror.info))
            self._is_all = True

    def _add_event(self, event: EventMessage) -> None:
        events, size = self._events, size_of(event)
        events.append((event, size))
        self._event_bytes += size
        while len(events) > MAX_EVENTS or (len(events) > 1 and self._event_bytes > MAX_EVENT_BYTES):
            self._events_lost += 1 + self._first_event().lost

    def _first_event(self) -> EventMessage:
        event, size = self._events.popleft()
        self._event_bytes -= size
        return event

    def _taken_event(self) -> EventMessage:
        event = self._first_event()
        if self._events_lost:
            event = msgspec.structs.replace(event, lost=event.lost + self._events_lost)
            self._events_lost = 0
        if self._events:
            self._waiting[EventMessage] = self._events[0][0]
        return event
