"""A scenario: a scene with a sonar on a vehicle that drives through it."""

from dataclasses import dataclass, field

from sonar_sim.geometry.pose import Mounting
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.trajectory import Trajectory
from sonar_sim.vehicle import Vehicle


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """All that a survey needs.

    Attributes:
        name: by which it is shipped, or its file's.
        scene: what is there.
        sonar: what looks.
        trajectory: the vehicle's true path.
        mounting: how the sonar sits on the vehicle.
        vehicle: its odometry.
        ping_rate_hz: asked for; the sound's travel may allow less.
        description: one sentence.
    """

    name: str
    scene: Scene
    sonar: SonarSettings
    trajectory: Trajectory
    mounting: Mounting = field(default_factory=Mounting)
    vehicle: Vehicle = field(default_factory=Vehicle)
    ping_rate_hz: float = 5.0
    description: str = ""

    @property
    def true_ping_rate_hz(self) -> float:
        """Pings a second: a ping is over when its last echo is back."""
        speed_mps = self.scene.water.speed_of_sound_mps
        return min(self.ping_rate_hz, speed_mps / (2.0 * self.sonar.range_m))
