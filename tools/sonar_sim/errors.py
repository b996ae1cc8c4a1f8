"""Errors of the simulator's input."""


class SonarSimError(Exception):
    """Base class; the message states what is wrong, where, and what to do."""


class SceneError(SonarSimError):
    """A scene that cannot be built."""


class SceneMissingError(SceneError):
    """A scene file that does not exist or cannot be read."""


class EffectError(SonarSimError):
    """An effect that does not exist, or an invalid parameter of one."""
