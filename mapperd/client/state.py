"""The state that a client holds: the newest of everything."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mapperd.client.changes import ClientChange, MapChanged, MapReset
from mapperd.client.mirror import MapMirror
from mapperd.client.validation import (
    EndedError,
    check_blocks,
    check_map_info,
    check_message,
    places_of,
    size_of,
)
from mapperd.wire.blocks import decode_blocks
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import (
    MAX_PATH,
    MAX_SETTINGS,
    BlocksMessage,
    EventMessage,
    FanMessage,
    FromServer,
    ImageMessage,
    Interest,
    LocalizationMessage,
    MapInfo,
    PathMessage,
    PoseMessage,
    ResetMessage,
    Resume,
    ReturnsMessage,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
    WelcomeMessage,
)

__all__ = ["MAX_BLOCKS", "ClientState", "StateReader"]

MAX_BLOCKS = 1 << 20
"""Maximum blocks of a mirror: half a GiB, 1 GiB with counts."""

MAX_SETTINGS_BYTES = 1 << 20
"""Maximum bytes of the descriptions of all settings; a daemon has 50 000."""

NEWEST = (
    PoseMessage,
    FanMessage,
    ReturnsMessage,
    ImageMessage,
    RobotsMessage,
    LocalizationMessage,
    StatusMessage,
)
"""Kinds of which only the newest message is kept."""

Newest = TypeVar(
    "Newest",
    PoseMessage,
    FanMessage,
    ReturnsMessage,
    ImageMessage,
    RobotsMessage,
    LocalizationMessage,
    StatusMessage,
)


class ClientState:
    """State of one client, kept through all its connections; its arrays are read only.

    Args:
        interest: part of the map that the client wants.
        publish: called with each change after it was applied.
        most_blocks: maximum blocks of the mirror.

    Attributes:
        interest: part of the map that the client wants.
        wants_map: the map was wanted at some time of this connection.
        welcome: the last one; None before the first connection.
        is_complete: the last message about the map on this connection completed the interest.
        mirror: of the map, always the same object; empty if no map is wanted.
        path: (N, 3) float64, metres, map frame.
        newest: the newest message of each type in `NEWEST`.
        settings: description by name, as of `mapperctl params`.
        last_event: number of the last event.
        used: bytes of the last established connection that were applied.
    """

    def __init__(
        self,
        interest: Interest,
        publish: Callable[[ClientChange], None],
        most_blocks: int = MAX_BLOCKS,
    ) -> None:
        self.interest = interest
        self.wants_map = False
        self.welcome: WelcomeMessage | None = None
        self.is_complete = False
        self.mirror: MapMirror | None = None
        self.path: NDArray[np.float64] = _frozen(np.zeros((0, 3)))
        self.newest: dict[type, ClientChange] = {}
        self.settings: dict[str, Any] = {}
        self.last_event: int | None = None
        self._setting_bytes: dict[str, int] = {}
        self.used = 0
        self._ticket = ""
        self._is_invalid = False
        self._path_version = 0
        self._newest = 0
        self._publish = publish
        self._most_blocks = most_blocks

    @property
    def ticket(self) -> str:
        """Ticket of the last connection; "" if it has none or cannot be resumed."""
        return self._ticket

    def newest_of(self, kind: type[Newest]) -> Newest | None:
        """Return the newest message of a kind; None before the first."""
        newest = self.newest.get(kind)
        return newest if isinstance(newest, kind) else None

    def resume(self) -> Resume | None:
        """Return what a new connection may resume from; None if it has to begin again."""
        mirror = self.mirror
        if mirror is None or self.welcome is None or self._is_invalid:
            return None
        if mirror.complete is None and not self._ticket:
            return None
        if mirror.interest != self.interest:
            return None
        return Resume(
            map=mirror.info.id,
            session=self.welcome.session,
            revision=mirror.complete,
            level=self.interest.level,
            detail=self.interest.detail,
            radius_m=self.interest.radius_m,
            box=self.interest.box,
            newest=self._newest,
            path=len(self.path),
            path_version=self._path_version,
            ticket=self._ticket,
            bytes=self.used if self._ticket else 0,
        )

    def forget_ticket(self) -> None:
        """Do not resume the last connection."""
        self._ticket = ""

    def invalidate(self) -> None:
        """Begin the next connection without a state: the daemon sent something invalid."""
        self.forget_ticket()
        self._is_invalid = True

    def begin(self, welcome: WelcomeMessage, resume: Resume | None) -> None:
        """Begin a connection.

        Args:
            welcome: of the daemon.
            resume: what the client claimed to hold.

        Raises:
            StreamError: the daemon resumes something that the client did not claim.
        """
        check_map_info(welcome.map)
        mirror = self.mirror
        if not welcome.resumed:
            self._begin_map(welcome.map, self.interest)
        elif resume is None or mirror is None or _grid(mirror.info) != _grid(welcome.map):
            raise StreamError(
                "the daemon resumes a map that this client does not hold", "bad_resume"
            )
        else:
            mirror.info = welcome.map
        is_other = self.welcome is None or self.welcome.session != welcome.session
        self.welcome = welcome
        self._ticket, self.used = welcome.ticket, 0
        if is_other or not welcome.resumed:
            self._take_path(PathMessage(first=0, points=b""))

    def take(self, news: FromServer) -> None:
        """Apply a message that follows the welcome.

        Raises:
            StreamError: the message is invalid.
        """
        check_message(news)
        if isinstance(news, BlocksMessage):
            self._take_blocks(news)
        elif isinstance(news, ResetMessage):
            check_map_info(news.map)
            self.is_complete = False
            self._begin_map(news.map, news.interest or self.interest)
        elif isinstance(news, PathMessage):
            self._take_path(news)
        elif isinstance(news, SettingsMessage):
            self._take_settings(news)
        elif isinstance(news, EventMessage):
            number = news.event.get("number")
            self.last_event = number if isinstance(number, int) and 0 <= number < 1 << 63 else None
            self._publish(news)
        elif isinstance(news, NEWEST):
            self.newest[type(news)] = news
            self._publish(news)
        else:
            raise StreamError(f"an unexpected message: {news.__struct_config__.tag}", "bad_order")

    def _begin_map(self, info: MapInfo, interest: Interest) -> None:
        self._newest = 0
        self._is_invalid = False
        if self.mirror is None:
            self.mirror = MapMirror(info, interest)
        else:
            self.mirror.begin(info, interest)
        self._publish(MapReset(info))

    def _take_blocks(self, news: BlocksMessage) -> None:
        mirror = self.mirror
        if mirror is None or not self.wants_map:
            raise StreamError("blocks, but the map was not requested", "not_asked")
        if news.complete is not None and news.complete > news.revision:
            raise StreamError("complete up to a later revision than its own", "bad_value")
        keys = np.zeros((0, 3), np.int32)
        with mirror.lock:
            if news.body:
                keys = self._put(mirror, news)
            mirror.revision = max(mirror.revision, news.revision)
            self._newest = max(self._newest, news.revision)
            if news.complete is not None:
                mirror.complete = max(mirror.complete or 0, news.complete)
        self.is_complete = news.complete is not None and mirror.interest == self.interest
        # Without the mirror's lock: a reader may hold it and wait for changes.
        self._publish(MapChanged(keys, news.stamp_ns, news.left))

    def _put(self, mirror: MapMirror, news: BlocksMessage) -> NDArray[np.int32]:
        blocks = decode_blocks(news.body, counts=mirror.interest.detail == "counts")
        check_blocks(blocks, mirror.interest, mirror.cell_m)
        mirror.put(blocks, news.stamp_ns)
        if len(mirror) > self._most_blocks:
            what = f"more than {self._most_blocks} blocks; request a smaller part or a higher level"
            raise EndedError(what, "too_many_blocks")
        return blocks.keys

    def _take_path(self, news: PathMessage) -> None:
        points = places_of(news)
        if news.first > len(self.path):
            raise StreamError("a path with a gap", "bad_value")
        if news.first + len(points) > MAX_PATH:
            raise StreamError(f"a path of more than {MAX_PATH} points", "bad_value")
        is_as_before = news.first == len(self.path) and not len(points)
        self.path = _frozen(np.concatenate([self.path[: news.first], points]))
        self._path_version = news.version
        if not is_as_before:
            self._publish(news)

    def _take_settings(self, news: SettingsMessage) -> None:
        settings = {**self.settings, **news.facts}
        if len(settings) > MAX_SETTINGS:
            raise StreamError(f"more than {MAX_SETTINGS} settings", "bad_value")
        sizes = {name: size_of((name, fact)) for name, fact in news.facts.items()}
        sizes = {**self._setting_bytes, **sizes}
        if sum(sizes.values()) > MAX_SETTINGS_BYTES:
            raise StreamError(f"settings of more than {MAX_SETTINGS_BYTES} bytes", "bad_value")
        self.settings, self._setting_bytes = settings, sizes
        self._publish(news)


def _grid(info: MapInfo) -> tuple[str, float, float]:
    """Return what blocks depend on; thresholds and origin may change."""
    return info.id, info.resolution_m, info.log_odds_step


def _frozen(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.flags.writeable = False
    return array


class StateReader:
    """The newest of each kind; it stays when the connection breaks. Any thread may read it."""

    _client_state: ClientState

    @property
    def welcome(self) -> WelcomeMessage | None:
        """Welcome of the last connection."""
        return self._client_state.welcome

    @property
    def mirror(self) -> MapMirror | None:
        """Mirror of the map, always the same object; None before the first connection."""
        return self._client_state.mirror

    @property
    def path(self) -> NDArray[np.float64]:
        """Path of the vehicle, (N, 3), metres, map frame; read only."""
        return self._client_state.path

    @property
    def settings(self) -> dict[str, Any]:
        """Settings by name, as the answer to `params` of docs/reference/control.md."""
        return self._client_state.settings

    @property
    def pose(self) -> PoseMessage | None:
        """Newest pose of the vehicle."""
        return self._client_state.newest_of(PoseMessage)

    @property
    def fan(self) -> FanMessage | None:
        """Field of view of the sonar."""
        return self._client_state.newest_of(FanMessage)

    @property
    def returns(self) -> ReturnsMessage | None:
        """First returns of the last ping."""
        return self._client_state.newest_of(ReturnsMessage)

    @property
    def image(self) -> ImageMessage | None:
        """Image of the last ping."""
        return self._client_state.newest_of(ImageMessage)

    @property
    def robots(self) -> RobotsMessage | None:
        """Other robots that were detected lately."""
        return self._client_state.newest_of(RobotsMessage)

    @property
    def localization(self) -> LocalizationMessage | None:
        """State of localization."""
        return self._client_state.newest_of(LocalizationMessage)

    @property
    def status(self) -> StatusMessage | None:
        """Status of the daemon and of this link; once a second."""
        return self._client_state.newest_of(StatusMessage)
