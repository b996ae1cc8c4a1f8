"""What a client knows by now, for its readers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.client.mirror import MapMirror
from mapperd.client.state import Knowledge
from mapperd.wire.messages import (
    Fan,
    Image,
    Localization,
    Pose,
    Returns,
    Robots,
    Status,
    Welcome,
)

__all__ = ["Known"]


class Known:
    """The newest of everything; it stays while the connection is away. Any thread may read it."""

    _knowledge: Knowledge

    @property
    def welcome(self) -> Welcome | None:
        """Of the last connection."""
        return self._knowledge.welcome

    @property
    def mirror(self) -> MapMirror | None:
        """The map, one and the same object for good; None before the first connection."""
        return self._knowledge.mirror

    @property
    def path(self) -> NDArray[np.float64]:
        """(N, 3), metres, map frame; read only."""
        return self._knowledge.path

    @property
    def settings(self) -> dict[str, Any]:
        """Name to facts, as the answer to `params` of docs/control.md."""
        return self._knowledge.settings

    @property
    def pose(self) -> Pose | None:
        """Where the vehicle is."""
        return self._knowledge.newest_of(Pose)

    @property
    def fan(self) -> Fan | None:
        """What the sonar looks at."""
        return self._knowledge.newest_of(Fan)

    @property
    def returns(self) -> Returns | None:
        """What the last ping met."""
        return self._knowledge.newest_of(Returns)

    @property
    def image(self) -> Image | None:
        """Of the last ping."""
        return self._knowledge.newest_of(Image)

    @property
    def robots(self) -> Robots | None:
        """Others that were seen."""
        return self._knowledge.newest_of(Robots)

    @property
    def localization(self) -> Localization | None:
        """How it goes."""
        return self._knowledge.newest_of(Localization)

    @property
    def status(self) -> Status | None:
        """Of the daemon and of this link; once a second."""
        return self._knowledge.newest_of(Status)
