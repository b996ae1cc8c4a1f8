"""Client of a daemon's map stream for programs without asyncio: runs in its own thread."""

import asyncio
import ssl
import threading
import time
from collections.abc import Collection, Coroutine, Iterator, Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self, TypedDict, TypeVar, Unpack

from mapperd.client.change_queue import ChangeQueue
from mapperd.client.changes import ClientChange, ConnectionStatus
from mapperd.client.client import MapClient
from mapperd.client.state import StateReader
from mapperd.client.validation import AskError
from mapperd.wire.messages import Interest, Want

__all__ = ["MapFollower"]

Result = TypeVar("Result")


class Options(TypedDict, total=False):
    """Options of `MapClient`."""

    token: bytes | None
    tls: ssl.SSLContext | None
    wants: Collection[Want]
    interest: Interest | None
    bytes_per_s: int
    name: str
    most_blocks: int


class MapFollower(StateReader):
    """A `MapClient` without asyncio; a context manager, to be used once. Any thread may use it.

    Args:
        address: as of `MapClient`.
        options: other arguments of `MapClient`.

    Raises:
        ValueError: as `MapClient`.
    """

    def __init__(self, address: str = "", **options: Unpack[Options]) -> None:
        self._client = MapClient(address, **options)
        self._client_state = self._client._client_state  # noqa: SLF001 the same client
        self._ends = ExitStack()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._pending: ChangeQueue | None = None
        self._news = threading.Condition()
        self._noted = 0

    @property
    def link(self) -> ConnectionStatus:
        """State of the connection."""
        return self._client.link

    def __enter__(self) -> Self:
        self._loop = asyncio.new_event_loop()
        thread = threading.Thread(target=self._loop.run_forever, name="map-client", daemon=True)
        with ExitStack() as ends:
            ends.callback(self._loop.close)
            thread.start()
            ends.callback(thread.join)
            ends.callback(self._loop.call_soon_threadsafe, self._loop.stop)
            self._pending = ends.enter_context(self._client.reader(self._note))
            self._wait_for(self._client.__aenter__())
            self._ends = ends.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; iterators over changes end."""
        with self._ends:
            if self._pending is not None:
                self._wait_for(self._client.close())
                self._pending = None
        self._loop = None

    def changes(self, timeout_s: float | None = None) -> Iterator[ClientChange]:
        """Iterate over changes since the last call, until the timeout or for ever.

        The first call begins with the state that is known already. Each change goes to one thread.

        Raises:
            StreamError: the daemon refuses this client, or the server is not a daemon.
        """
        pending = self._pending
        if pending is None:
            return
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            change = self._next(pending, end_s)
            if change is None:
                return
            yield change

    def complete(self, timeout_s: float | None = None) -> None:
        """Wait until the mirror has all of the interest, up to date.

        Raises:
            TimeoutError: the time is over.
            StreamError: as `changes`.
        """
        self._wait_for(self._client.complete(timeout_s))

    def ask(self, do: str, *, timeout_s: float = 60.0, **fields: Any) -> dict[str, Any]:  # noqa: ANN401 plain values
        """Make a request of docs/reference/control.md; return its result.

        Raises:
            AskError: the request was not carried out.
        """
        return self._wait_for(self._client.ask(do, timeout_s=timeout_s, **fields))

    def set(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Change settings of the daemon, all or none; return name to values before and after.

        Raises:
            AskError: nothing was changed; `details` has the reasons by name.
        """
        return self._wait_for(self._client.set(changes))

    def change(
        self,
        *,
        wants: Collection[Want] | None = None,
        interest: Interest | None = None,
        bytes_per_s: int | None = None,
    ) -> None:
        """Change options, for this connection and later ones; None keeps an option.

        Raises:
            ValueError: a value is not allowed.
        """
        self._wait_for(self._client.change(wants=wants, interest=interest, bytes_per_s=bytes_per_s))

    def _note(self) -> None:
        with self._news:
            self._noted += 1
            self._news.notify_all()

    def _next(self, pending: ChangeQueue, end_s: float | None) -> ClientChange | None:
        """Return the next change; None after the timeout or when the client has closed."""
        while True:
            noted = self._noted
            change = pending.take()
            if change is not None:
                return change
            if self._client.link.state == "closed":
                self._client.raise_error()
                return None
            left_s = None if end_s is None else end_s - time.monotonic()
            if left_s is not None and left_s <= 0:
                return None
            with self._news:
                if self._noted == noted:
                    self._news.wait(left_s)

    def _wait_for(self, doing: Coroutine[Any, Any, Result]) -> Result:
        """Run a coroutine in the client's thread, and wait for its result."""
        if self._loop is None:
            doing.close()
            raise AskError("not_connected", "this client has closed or has not been entered")
        return asyncio.run_coroutine_threadsafe(doing, self._loop).result()
