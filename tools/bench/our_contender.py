"""One of our contenders in a process of its own; prints `ContenderResult` as JSON."""

import argparse
import math
import time
from pathlib import Path

import msgspec
import numpy as np

from bench.contenders import status_bytes
from bench.inputs import Pings, load
from bench.results import ContenderResult
from mapperd.config.tree import Config, MappingConfig, OctreeConfig, SonarConfig
from mapperd.geometry.motion import PingMotion
from mapperd.mapping.sonar_map import SonarMap

APERTURE_DEG = 20.0
"""One-way aperture of the simulated sonar: the rivals' rays and our wedge span the same water."""
SPEED_MPS, YAW_RATE_RADPS, SOUND_MPS = 1.0, math.radians(20.0), 1500.0
WAYS = ("grid", "rays")


def config_of(
    way: str,
    resolution_m: float,
    threads: int = 1,
    *,
    detail: float = 1.0,
    carve_no_return: bool = False,
) -> Config:
    """Settings of a contender; all but aperture, grid and integrator are the defaults."""
    if way == "rays":
        mapping = MappingConfig(integrator="rays")
    else:
        mapping = MappingConfig(
            integrator="evidence_grid",
            detail=detail,
            threads=threads,
            carve_no_return=carve_no_return,
        )
    return Config(
        sonar=SonarConfig(vertical_aperture=APERTURE_DEG),
        octree=OctreeConfig(voxel_resolution=resolution_m),
        mapping=mapping,
    )


class ContenderRun:
    """Integrates the pings of a file into empty maps, timing each ping.

    Args:
        config: of every map.
        pings: in order.
        budget_s: a pass begins no ping after this.
        first_returns_only: leave the rest of the image empty.
    """

    def __init__(
        self, config: Config, pings: Pings, budget_s: float, *, first_returns_only: bool
    ) -> None:
        self.config = config
        self._pings = pings
        self._budget_ms = 1e3 * budget_s
        self._first_returns_only = first_returns_only

    def measure(self, *, with_motion: bool = False) -> ContenderResult:
        """Both passes, and motion if wanted."""
        sonar_map = SonarMap(self.config)
        start_rss_bytes = status_bytes("VmRSS")
        ms, touched = self._one_pass(sonar_map)
        peak_rss_bytes = status_bytes("VmHWM")
        counts = sonar_map.counts()
        memory_bytes, held_voxels = sonar_map.memory_bytes, sonar_map.core.held_voxels
        second_ms, _ = self._one_pass(sonar_map, most=len(ms))
        del sonar_map
        resting_ms, moving_ms = self._with_motion() if with_motion else ([], [])
        return ContenderResult(
            ms=ms,
            second_ms=second_ms,
            touched=touched,
            memory_bytes=memory_bytes,
            known_voxels=counts.occupied + counts.free + counts.uncertain,
            held_voxels=held_voxels,
            start_rss_bytes=start_rss_bytes,
            peak_rss_bytes=peak_rss_bytes,
            resting_ms=resting_ms,
            moving_ms=moving_ms,
        )

    def _one_pass(
        self, sonar_map: SonarMap, most: int | None = None
    ) -> tuple[list[float], list[int | None]]:
        """Milliseconds and touched voxels of each ping, of at most so many."""
        ms: list[float] = []
        touched: list[int | None] = []
        for i in range(len(self._pings) if most is None else most):
            if sum(ms) > self._budget_ms:
                break
            took_ms, voxels = self._integrate(sonar_map, i)
            ms.append(took_ms)
            touched.append(voxels)
        return ms, touched

    def _with_motion(self) -> tuple[list[float], list[float]]:
        """Milliseconds of each ping at rest and moving, each into a map of its own.

        The two take turns, and take turns in being first, so that drift of the machine cancels.
        """
        maps = (SonarMap(self.config), SonarMap(self.config))
        ms: tuple[list[float], list[float]] = ([], [])
        for i in range(len(self._pings)):
            if sum(ms[1]) > self._budget_ms:
                break
            for moving in (i % 2, 1 - i % 2):
                motion = self._motion(i) if moving else None
                ms[moving].append(self._integrate(maps[moving], i, motion)[0])
        return ms

    def _integrate(
        self, sonar_map: SonarMap, i: int, motion: PingMotion | None = None
    ) -> tuple[float, int]:
        echo = self._pings.echo(i, first_returns_only=self._first_returns_only)
        began_s = time.perf_counter()
        stats = sonar_map.integrate(echo, self._pings.map_T_sonar[i], motion)
        return 1e3 * (time.perf_counter() - began_s), stats.occupied + stats.free

    def _motion(self, i: int) -> PingMotion:
        """Along the map's x, turning about its z; the pose holds at the middle of the image."""
        map_R_sonar = self._pings.map_T_sonar[i, :3, :3]  # noqa: N806 frames are named
        range_m = self._pings.images.shape[1] * self._pings.range_resolution_m
        return PingMotion(
            np.array([SPEED_MPS, 0.0, 0.0]),
            map_R_sonar.T @ np.array([0.0, 0.0, YAW_RATE_RADPS]),
            range_m / SOUND_MPS,
            SOUND_MPS,
        )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pings", type=Path, help="file of bench_pings")
    parser.add_argument("resolution_m", type=float)
    parser.add_argument("budget_s", type=float, help="a pass begins no ping after this")
    parser.add_argument("way", choices=WAYS)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--first-returns", action="store_true", help="and nothing behind them")
    parser.add_argument("--motion", action="store_true", help="time motion within the ping too")
    args = parser.parse_args()
    config = config_of(args.way, args.resolution_m, args.threads)
    run = ContenderRun(
        config, load(args.pings), args.budget_s, first_returns_only=args.first_returns
    )
    print(msgspec.json.encode(run.measure(with_motion=args.motion)).decode())


if __name__ == "__main__":
    main()
