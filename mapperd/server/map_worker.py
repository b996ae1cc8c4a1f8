"""Sends the map to the clients, in rounds, in one worker thread."""

import asyncio
from collections.abc import Awaitable, Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NoReturn

from mapperd.api import DaemonApi
from mapperd.events import Severity
from mapperd.server.connection import ClientConnection, ServerContext
from mapperd.server.map_source import MapView, Source
from mapperd.server.priority_queue import Part, SendRoom
from mapperd.server.session import MapStart, ResumeCache, ResumeState, ViewRequest
from mapperd.server.state_feed import StateFeed
from mapperd.wire.framing import framed
from mapperd.wire.messages import Interest, ResetMessage, Resume, Vector

__all__ = ["Frame", "MapWorker", "next_frames"]

UNWATCHED_S = 2.0
"""Time between looks at the map while no client watches it; ages of blocks depend on the looks."""

ROUND_BYTES = 128 << 10
"""Limit for one client in one round, because the others wait for it."""

RETRY_DELAY_S = 1.0
"""Delay after a round that failed."""

Frame = tuple[bytes, int, int | None]
"""A message; its number; the near blocks that are left of the pass, None for far blocks."""


def next_frames(view: MapView, rooms: SendRoom, position_m: Vector | None) -> list[Frame]:
    """Return the messages about the map for one round: near blocks, otherwise far ones."""
    return [*_of_part(view, "near", rooms.near, position_m)] or [
        *_of_part(view, "far", rooms.far, position_m)
    ]


def _of_part(view: MapView, part: Part, most: int, position_m: Vector | None) -> Iterator[Frame]:
    room = min(most, ROUND_BYTES)
    # The last half of the room may stay empty: small messages compress badly.
    while room > min(most, ROUND_BYTES) // 2:
        frame = view.next(position_m, room, part)
        if frame is None:
            return
        yield frame, view.number, view.near_left if part == "near" else None
        room -= len(frame)


@dataclass(slots=True)
class _Order:
    """Work for one client in a round."""

    client: ClientConnection
    view: MapView | None
    view_request: ViewRequest | None
    rooms: SendRoom
    settled: int = 0
    is_new: bool = False
    is_resumed: bool = False
    frames: list[Frame] = field(default_factory=list)
    fault: Exception | None = None


@dataclass(slots=True)
class _MapJob:
    """Work of a round.

    Attributes:
        look: look for changes of the map.
        orders: work for each client.
        draw: kinds of messages to draw.
        coarseness: sizes of images to draw.
        left: views of clients that left, and the states from which these may resume.
        now_s: start of the round.
        map_start: of the map, when all is done.
    """

    look: bool
    orders: list[_Order]
    draw: frozenset[str]
    coarseness: set[int]
    left: list[tuple[MapView, ResumeState | None]]
    now_s: float
    map_start: MapStart | None = None


class MapWorker:
    """Looks at the map, and gives each client what it has room for.

    Args:
        operations: the daemon.
        feed: state messages; the worker draws some of them.
        source: the map.
        clients: connected clients, updated by the server.
        context: clocks, counters, limits.

    Attributes:
        resume_cache: of clients that were lost; of the worker.
    """

    FOLLOWS = ("stream.rate",)
    """Settings that are read in each round."""

    def __init__(
        self,
        operations: DaemonApi,
        feed: StateFeed,
        source: Source,
        clients: Collection[ClientConnection],
        context: ServerContext,
    ) -> None:
        self._operations = operations
        self._feed = feed
        self._source = source
        self._clients = clients
        self._context = context
        self._due = asyncio.Event()
        self._map_start = MapStart(source.info(), source.revision, source.session)
        self._looked_s: float | None = None
        self._left: list[tuple[MapView, ResumeState | None]] = []
        self.resume_cache = ResumeCache(context.limits.clients)

    def wake(self) -> None:
        """Wake the loop: there may be work."""
        self._due.set()

    def welcome(self, client: ClientConnection) -> None:
        """Welcome a client that does not want the map, without waiting for the worker."""
        client.session.view_request = None
        client.session.view_ready(None, self._map_start)
        client.turn()

    def leave(self, view: MapView, resume_state: ResumeState | None) -> None:
        """Keep or close the view of a client that left; no `resume_state` closes it."""
        self._left.append((view, resume_state))
        self.wake()

    async def run(self) -> NoReturn:
        """Run rounds while there is work, until cancelled."""
        loop = asyncio.get_running_loop()
        worker = ThreadPoolExecutor(1, "map-stream")

        async def in_worker(work: Callable[[], None]) -> None:
            await asyncio.shield(loop.run_in_executor(worker, work))

        try:
            while True:
                await self._due.wait()
                self._due.clear()
                try:
                    await self._round(in_worker)
                except Exception as error:  # noqa: BLE001 an internal error must not end the stream
                    self._failed(error)
                    await asyncio.sleep(RETRY_DELAY_S)
        finally:
            worker.shutdown()  # waits for one round, which is short

    async def _round(self, in_worker: Callable[[Callable[[], None]], Awaitable[None]]) -> None:
        job = self._job(self._context.clock())
        if not (job.look or job.orders or job.draw or job.left):
            return
        await in_worker(lambda: self._work(job))
        map_start = job.map_start
        assert map_start is not None  # noqa: S101 the work has been done
        self._map_start = map_start
        for order in job.orders:
            if order.fault is not None:
                # The view counts blocks as sent that were not: only a new connection repairs that.
                self._failed(order.fault)
                order.client.abort()
                self._left = [(v, None if v is order.view else p) for v, p in self._left]
            if order.is_new and order.view is not None:
                order.client.session.took(order.view, is_resumed=order.is_resumed)
            if order.client.is_over:
                if order.is_new and order.view is not None:
                    self.leave(order.view, order.client.resume_state())
            elif order.view_request is None:
                self._deliver(order)
            else:
                self._begin(order, map_start)

    def _job(self, now_s: float) -> _MapJob:
        clients = [*self._clients]
        look = self._is_time_to_look(now_s)
        found = (self._order(client, now_s, look=look) for client in clients)
        wanted = frozenset().union(*(client.session.wants for client in clients))
        left, self._left = self._left, []
        return _MapJob(
            look,
            [order for order in found if order is not None],
            wanted if self._feed.wants_drawing(wanted, now_s) else frozenset(),
            {c.session.outbox.coarseness() for c in clients if "image" in c.session.wants},
            left,
            now_s,
        )

    def _work(self, job: _MapJob) -> None:
        """Run in the worker thread."""
        for view, resume_state in job.left:
            if resume_state is None:
                view.close()
            else:
                self.resume_cache.park(view, resume_state, job.now_s)
        self.resume_cache.expire(job.now_s)
        if job.look:
            self._source.look(self._context.now_ns(), self._feed.position_m)
        if job.draw:
            self._feed.draw(job.draw, job.coarseness)
        for order in job.orders:
            try:
                self._fill(order)
            except Exception as error:  # noqa: BLE001 the other clients get their messages
                order.fault = error
        source = self._source
        job.map_start = MapStart(source.info(), source.revision, source.session)

    def _failed(self, error: Exception) -> None:
        self._context.count("failed")
        text = f"map stream: {type(error).__name__}: {error}"
        self._operations.events.add(Severity.ERROR, "stream_failed", text)

    def _is_time_to_look(self, now_s: float) -> bool:
        watched = any("map" in client.session.wants for client in self._clients)
        period_s = 1 / self._operations.settings.current.stream.rate if watched else UNWATCHED_S
        if self._looked_s is not None and now_s - self._looked_s < period_s:
            return False
        self._looked_s = now_s
        return True

    def _order(self, client: ClientConnection, now_s: float, *, look: bool) -> _Order | None:
        session = client.session
        if session.view_request is not None:
            return _Order(client, session.view, session.view_request, SendRoom())
        rooms = session.map_rooms(now_s) if look or session.left else SendRoom()
        if session.view is None or not rooms:
            return None
        return _Order(client, session.view, None, rooms, session.settled)

    def _fill(self, order: _Order) -> None:
        """Run in the worker thread."""
        if order.view_request is not None:
            self._meet(order, order.view_request)
            return
        view, position_m = order.view, self._feed.position_m
        if view is not None:
            view.settle(order.settled)
            order.frames = next_frames(view, order.rooms, position_m)

    def _meet(self, order: _Order, view_request: ViewRequest) -> None:
        """Create, change or close the view of a client, in the worker."""
        view = order.view
        if view_request.interest is None:
            if view is not None:
                view.close()
            order.view = None
        elif view is None:
            order.view = self._parked(view_request.interest, view_request.resume)
            order.is_resumed = order.view is not None
            if order.view is None:
                order.view = self._source.subscribe(view_request.interest, view_request.resume)
            order.is_new = True
        else:
            view.change(view_request.interest)

    def _parked(self, interest: Interest, resume: Resume | None) -> MapView | None:
        if resume is None or not resume.ticket:
            return None
        return self.resume_cache.take(resume, interest, self._source)

    def _deliver(self, order: _Order) -> None:
        client, view, now_s = order.client, order.view, self._context.clock()
        session = client.session
        if view is None or session.view is not view:
            return  # the client has changed its interest
        if order.rooms.near and all(near_left is None for _, _, near_left in order.frames):
            session.nothing_near()
        for frame, number, near_left in order.frames:
            client.write(session.mapped(frame, number, view.left, now_s, near_left))
        session.left = view.left
        if session.left and order.frames and session.map_rooms(now_s):
            self.wake()

    def _begin(self, order: _Order, map_start: MapStart) -> None:
        client, view_request, now_s = order.client, order.view_request, self._context.clock()
        session = client.session
        is_first = session.state == "admitted"
        if session.view_request is view_request:
            session.view_request = None
        session.view_ready(order.view, map_start)
        view = order.view if order.is_new and not is_first else None
        if view_request is not None and view_request.interest is not None and view is not None:
            # Blocks that the client holds from an earlier view may be outdated.
            info, revision = map_start.info, map_start.revision
            again = ResetMessage(map=info, revision=revision, interest=view_request.interest)
            client.write(session.sent_reset(framed(again), view, now_s))
        client.turn()
        self.wake()
