"""One of our contenders in a process of its own; prints `Measured` as JSON."""

import argparse
import time
from pathlib import Path

from bench_pings import Pings, load
from measured import Measured, status_bytes
from our_settings import WAYS, add_arguments, config_of, print_json

from mapperd.mapping import SonarMap


def measure(
    sonar_map: SonarMap, pings: Pings, budget_s: float, *, first_returns_only: bool
) -> Measured:
    """Integrate the pings one after another, timing each."""
    ms: list[float] = []
    touched: list[int | None] = []
    start_rss_bytes = status_bytes("VmRSS")
    for i in range(len(pings)):
        if sum(ms) > 1e3 * budget_s:
            break
        echo = pings.echo(i, first_returns_only=first_returns_only)
        began_s = time.perf_counter()
        stats = sonar_map.integrate(echo, pings.map_T_sonar[i])
        ms.append(1e3 * (time.perf_counter() - began_s))
        touched.append(stats.occupied + stats.free)
    peak_rss_bytes = status_bytes("VmHWM")
    counts = sonar_map.counts()
    return Measured(
        ms=ms,
        touched=touched,
        memory_bytes=sonar_map.memory_bytes,
        known_voxels=counts.occupied + counts.free + counts.uncertain,
        start_rss_bytes=start_rss_bytes,
        peak_rss_bytes=peak_rss_bytes,
    )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.add_argument("way", choices=WAYS)
    parser.add_argument("--threads", type=int, default=1)
    said = parser.parse_args()
    sonar_map = SonarMap(config_of(said.way, said.resolution_m, said.threads))
    pings = load(Path(said.pings))
    print_json(measure(sonar_map, pings, said.budget_s, first_returns_only=said.first_returns))


if __name__ == "__main__":
    main()
