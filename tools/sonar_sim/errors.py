"""What can be wrong with what the simulator is given."""


class SonarSimError(Exception):
    """Root of them; the message says what, where and what to do."""


class SceneError(SonarSimError):
    """A scene that cannot be built."""


class EffectError(SonarSimError):
    """An effect that does not exist, or a parameter of it that cannot be."""
