"""Milliseconds a ping of both integrators, in one run on one recording.

Usage: python tools/bench/integrators.py [out/demo/capture.bin] [--pings N]
"""

import argparse
import itertools
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from mapperd.config import Config, Mapping, Octree
from mapperd.echo import Echo, echo_of
from mapperd.mapping import SonarMap
from oculus_driver import Ping, StreamParser, decode_ping
from oculus_driver.recording import OCULUS, open_recording

Integrator = Literal["rays", "projective"]
INTEGRATORS: tuple[Integrator, ...] = ("rays", "projective")


def echoes(path: Path) -> Iterator[Echo]:
    """The pings of a recording, as the map wants them."""
    parser = StreamParser()
    with open_recording(path) as recording:
        for chunk in recording:
            if chunk.encoding != OCULUS:
                continue
            for message in parser.feed(chunk.data, chunk.arrival_ns):
                ping = decode_ping(message)
                if isinstance(ping, Ping):
                    yield echo_of(ping, Config().sonar)


def milliseconds(pings: list[Echo], resolution_m: float, integrator: Integrator) -> list[float]:
    """Time of each ping, the sonar moving 5 cm between them and looking straight down."""
    config = Config(
        octree=Octree(voxel_resolution=resolution_m), mapping=Mapping(integrator=integrator)
    )
    sonar_map = SonarMap(config)
    map_T_sonar = np.eye(4)  # noqa: N806 frames are named
    map_T_sonar[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    times = []
    for i, echo in enumerate(pings):
        map_T_sonar[0, 3] = 0.05 * i
        began_s = time.perf_counter()
        sonar_map.integrate(echo, map_T_sonar)
        times.append(1e3 * (time.perf_counter() - began_s))
    return times


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recording", nargs="?", type=Path, default=Path("out/demo/capture.bin"))
    parser.add_argument("--pings", type=int, default=60)
    said = parser.parse_args()
    pings = list(itertools.islice(echoes(said.recording), said.pings))
    rows, beams = pings[0].intensity.shape
    print(f"{len(pings)} pings of {beams} beams x {rows} rows, {pings[0].max_range_m:.2f} m")
    for resolution_m in (0.1, 0.05):
        medians = {}
        for integrator in INTEGRATORS:
            times = milliseconds(pings, resolution_m, integrator)
            medians[integrator] = statistics.median(times)
            p95 = float(np.percentile(times, 95))
            print(
                f"  {100 * resolution_m:3.0f} cm  {integrator:10}  "
                f"median {medians[integrator]:6.1f} ms  p95 {p95:6.1f} ms"
            )
        print(f"         projective / rays: {medians['projective'] / medians['rays']:.1f}")


if __name__ == "__main__":
    main()
