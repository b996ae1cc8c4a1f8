"""Clouds as the engine takes them."""

from sonar_sim.effects.preview import View
from sonar_sim.propagation.physics import Cloud
from sonar_sim.scene.scene import Bubbles, Sediment


def clouds_of(view: View, kind: type[Bubbles] | type[Sediment]) -> tuple[Cloud, ...]:
    """The scene's clouds of one kind."""
    return tuple(cloud.box for cloud in view.clouds_of(kind))
