"""The benchmark's input: pings of the simulator, made once for each setting and seed."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench_pings import Pings
from bench_scene import basin, mounting, path
from sonar_sim import SonarSettings, Water
from sonar_sim.pool import SimulatorRecipe, simulate_pings

from oculus_driver.encode import bearing_table_cdeg

BENCH = Path(__file__).resolve().parent
ROWS = 500


@dataclass(frozen=True, slots=True)
class Setting:
    """How the sonar is set for a range: its tilt and gain as an operator would choose them."""

    range_m: float
    pitch_deg: float
    gain_percent: float

    @property
    def sonar(self) -> SonarSettings:
        """512 beams over 130 degrees, 20 degrees of aperture, `ROWS` rows."""
        return SonarSettings(
            demanded_range_m=self.range_m,
            base_row_m=self.range_m / ROWS,
            gain_percent=self.gain_percent,
        )


SETTINGS = (Setting(10.0, 25.0, 60.0), Setting(30.0, 10.0, 46.0))


def simulate(setting: Setting, pings: int, seed: int) -> Pings:
    """Simulate pings evenly along the path."""
    sonar, trajectory = setting.sonar, path()
    times_s = np.linspace(0.0, trajectory.duration_s, pings)
    poses = [trajectory.pose(float(t)) @ mounting(setting.pitch_deg).pose for t in times_s]
    recipe = SimulatorRecipe(basin(), sonar, Water(), seed)
    images = np.stack([ping.image for ping in simulate_pings(recipe, poses, processes=1)])
    map_T_sonar = np.tile(np.eye(4), (pings, 1, 1))  # noqa: N806 frames are named
    map_T_sonar[:, :3, :3] = [pose.rotation for pose in poses]
    map_T_sonar[:, :3, 3] = [pose.position_m for pose in poses]
    bearings_cdeg = bearing_table_cdeg(sonar.beams, sonar.half_aperture_rad)
    return Pings(images, np.radians(bearings_cdeg / 100.0), sonar.range_resolution_m, map_T_sonar)


def cached(folder: Path, setting: Setting, pings: int, seed: int) -> Path:
    """File of the simulated pings, made anew only if what makes them has changed."""
    sources = [*sorted((BENCH.parent / "sonar_sim").glob("*.py")), BENCH / "bench_scene.py"]
    made_of = b"".join(source.read_bytes() for source in [*sources, Path(__file__)])
    stamp = hashlib.sha256(made_of).hexdigest()[:8]
    file = folder / f"pings-{setting.range_m:g}m-{pings}-{seed}-{stamp}.npz"
    if not file.exists():
        simulate(setting, pings, seed).save(file)
    return file
