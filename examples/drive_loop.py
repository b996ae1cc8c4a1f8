"""Learn or plan in the simulator, as with Gymnasium: `python examples/drive_loop.py [STEPS]`.

`HarbourEnv` has the interface of `gymnasium.Env` (reset, step, spaces), and is one where Gymnasium
is installed. The vehicle is to reach a goal by its sonar alone; this pilot turns away from what is
loud and near.
"""

import sys
from typing import Any

import numpy as np
from sonar_sim import FramePose, Mounting, load_scenario, sonar_preset
from sonar_sim.geometry.driving import DriveCommand
from sonar_sim.world import World

try:
    import gymnasium

    Base: Any = gymnasium.Env
except ImportError:
    Base = object

STEP_S = 0.5
SONAR = sonar_preset("M750d", demanded_range_m=8.0, beams=256, forced_rows=128)
AHEAD = Mounting((0.2, 0.0, 0.0), pitch_deg=0.0)
GOAL_M = np.array([6.0, -6.0])
NEAR_M = 1.0


class HarbourEnv(Base):
    """A vehicle with a sonar that looks ahead, 3 m deep in the harbour.

    The action is (ahead, turn to port), -1 to 1 each; the observation a ping, uint8 (rows, beams);
    the reward the metres by which the vehicle came nearer to its goal.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 of Gymnasium
    max_steps = 120

    def __init__(self) -> None:
        self._scene = load_scenario("harbour").scene
        self._random = np.random.default_rng()
        if Base is not object:
            box = gymnasium.spaces.Box
            self.action_space = box(-1.0, 1.0, (2,), np.float32)
            self.observation_space = box(0, 255, (SONAR.rows, SONAR.beams), np.uint8)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode: equal seeds give equal ones; without a seed it is another one."""
        del options
        if Base is not object:
            super().reset(seed=seed)
        if seed is not None:
            self._random = np.random.default_rng(seed)
        self._world = World(self._scene, seed=int(self._random.integers(1 << 31)))
        self._rov = self._world.add_vehicle(
            "rov", FramePose(np.array([-6.0, -6.0, -3.0]), np.eye(3))
        )
        self._sonar = self._rov.add_sonar("front", SONAR, AHEAD, rate_hz=1.0 / STEP_S)
        self._steps = 0
        return self._sonar.ping().ping.image.astype(np.uint8), {"distance_m": self._distance_m()}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drive for half a second, and ping at its end."""
        ahead, turn = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        before_m = self._distance_m()
        self._rov.drive(DriveCommand(ahead_mps=0.8 * ahead, turn_rps=0.5 * turn))
        (ping,) = self._world.step(STEP_S)
        self._steps += 1
        left_m = self._distance_m()
        arrived = left_m < NEAR_M
        info = {"distance_m": left_m, "position_m": self._rov.pose.position_m}
        truncated = self._steps >= self.max_steps
        image = ping.ping.image.astype(np.uint8)
        return image, before_m - left_m, arrived, truncated, info

    def _distance_m(self) -> float:
        return float(np.linalg.norm(self._rov.pose.position_m[:2] - GOAL_M))


def pilot(image: np.ndarray) -> np.ndarray:
    """Turn away from the side that is louder within 4 m, and slow down before it."""
    near = image[: len(image) // 2].astype(float)
    starboard, port = near[:, image.shape[1] // 2 :].mean(), near[:, : image.shape[1] // 2].mean()
    turn = np.clip((starboard - port) / 4.0, -1.0, 1.0)
    return np.array([1.0 - 0.5 * abs(turn), turn], dtype=np.float32)


def main(steps: int) -> None:
    """Run one episode."""
    env = HarbourEnv()
    image, info = env.reset(seed=1)
    total = 0.0
    for number in range(steps):
        image, reward, arrived, truncated, info = env.step(pilot(image))
        total += reward
        if number % 10 == 0 or arrived or truncated:
            print(f"{number:3d}: {info['distance_m']:5.2f} m to go, reward {total:+.2f}")
        if arrived or truncated:
            break


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else HarbourEnv.max_steps)
