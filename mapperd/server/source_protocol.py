"""The map as the server of the stream sees it; all of it is called in one worker thread."""

from typing import Protocol

from mapperd.server.priority_queue import Part
from mapperd.wire.messages import Interest, MapFacts, Resume, Vector

__all__ = ["MapView", "Source"]


class MapView(Protocol):
    """What one client has been told of the map."""

    resumed: bool
    """What the client held was right."""

    reason: str
    """Why not."""

    @property
    def number(self) -> int:
        """Number of the last message."""

    @property
    def left(self) -> int:
        """Blocks that are still to be told."""

    @property
    def near_left(self) -> int:
        """Of those the ones near the vehicle that belong to this pass, as of the last message."""

    def next(self, position_m: Vector | None, most_bytes: int, part: Part = "any") -> bytes | None:
        """The next message as it goes over the wire; None where all is told.

        Args:
            position_m: of the vehicle, what is nearest to it comes first.
            most_bytes: about; one block is always told.
            part: of the map, that it may be about.
        """

    def change(self, interest: Interest) -> None:
        """Something else is of interest from now on."""

    def settle(self, number: int) -> None:
        """Note that the client has used the messages up to this one."""

    def go_on(self, interest: Interest, number: int) -> bool:
        """The client is back, and has messages up to this one; later ones are told again.

        Returns:
            whether it may keep what it holds.
        """

    def close(self) -> None:
        """The client is gone."""


class Source(Protocol):
    """The map."""

    @property
    def session(self) -> str:
        """Which the revisions are of."""

    @property
    def revision(self) -> int:
        """As of the last look."""

    def facts(self) -> MapFacts:
        """What is the same for all of it."""

    def look(self, now_ns: int, position_m: Vector | None = None) -> None:
        """Find what changed since the last look, nearest to the vehicle first."""

    def subscribe(self, interest: Interest, resume: Resume | None = None) -> MapView:
        """Begin to tell a client."""
