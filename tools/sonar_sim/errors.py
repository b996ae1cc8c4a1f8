"""Errors of the simulator's input."""

from typing import Final


class SonarSimError(Exception):
    """Base class; the message states what is wrong, where, and what to do."""


class SceneError(SonarSimError):
    """A scene that cannot be built."""


class EffectError(SonarSimError):
    """An effect that does not exist, or an invalid parameter of one."""


OK: Final = 0
FAULT: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130
