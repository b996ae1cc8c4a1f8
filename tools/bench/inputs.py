"""The benchmark's input: pings of the simulator, made once for each setting and seed."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sonar_sim import Pose, Scene, SonarSettings
from sonar_sim.pool import Shot, SimulatorRecipe, simulate_pings

from bench import scene, seabed
from bench.pings import Pings
from oculus_driver.encode import bearing_table_cdeg

BENCH = Path(__file__).resolve().parent
ROWS = 500


@dataclass(frozen=True, slots=True)
class Look:
    """Where the sonar looks: a scene, and poses by range and number of pings."""

    scene: Callable[[], Scene]
    poses: Callable[[float, int], list[Pose]]


DOWN, AHEAD = "down", "ahead"
LOOKS = {
    DOWN: Look(seabed.seabed, seabed.poses),
    AHEAD: Look(scene.basin, scene.poses),
}


@dataclass(frozen=True, slots=True)
class Setting:
    """Where the sonar looks, how far, and its gain as an operator would choose it."""

    look: str
    range_m: float
    gain_percent: float

    @property
    def sonar(self) -> SonarSettings:
        """512 beams over 130 degrees, 20 degrees of aperture, `ROWS` rows."""
        return SonarSettings(
            demanded_range_m=self.range_m,
            base_row_m=self.range_m / ROWS,
            gain_percent=self.gain_percent,
        )


SETTINGS = (
    Setting(DOWN, 10.0, 46.0),
    Setting(DOWN, 30.0, 42.0),
    Setting(AHEAD, 10.0, 60.0),
    Setting(AHEAD, 30.0, 46.0),
)


def simulate(setting: Setting, pings: int, seed: int) -> Pings:
    """Simulate pings along the look's path."""
    sonar, look = setting.sonar, LOOKS[setting.look]
    poses = look.poses(setting.range_m, pings)
    recipe = SimulatorRecipe(look.scene(), sonar, seed)
    shots = [Shot(pose) for pose in poses]
    made = simulate_pings(recipe, shots, processes=1)
    images = np.stack([ping.image for ping in made]).astype(np.uint8)
    map_T_sonar = np.tile(np.eye(4), (pings, 1, 1))  # noqa: N806 frames are named
    map_T_sonar[:, :3, :3] = [pose.rotation for pose in poses]
    map_T_sonar[:, :3, 3] = [pose.position_m for pose in poses]
    bearings_cdeg = bearing_table_cdeg(sonar.beams, sonar.half_aperture_rad)
    return Pings(images, np.radians(bearings_cdeg / 100.0), sonar.range_resolution_m, map_T_sonar)


def cached(folder: Path, setting: Setting, pings: int, seed: int) -> Path:
    """File of the simulated pings, made anew only if what makes them has changed."""
    scenes = [BENCH / f"{part}.py" for part in ("scene", "seabed", "shapes")]
    sources = [*sorted((BENCH.parent / "sonar_sim").rglob("*.py")), *scenes, Path(__file__)]
    stamp = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:8]
    file = folder / f"pings-{setting.look}-{setting.range_m:g}m-{pings}-{seed}-{stamp}.npz"
    if not file.exists():
        simulate(setting, pings, seed).save(file)
    return file
