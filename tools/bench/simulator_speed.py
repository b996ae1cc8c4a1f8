"""How fast the simulator makes pings of the shipped harbour, with all that `auto` calls for.

Each worker is a process and makes one ping at a time. Pings follow one another at the asked rate,
in stretches of the scenario's trajectory. `--write` puts the tables into
docs/reports/performance.md.
"""

import argparse
import os
import statistics
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import TYPE_CHECKING

from sonar_sim import Simulator, load_scenario
from sonar_sim.effects.rule_check import measured_costs_ms
from sonar_sim.engine import PingEngine
from sonar_sim.scene.scenario import Scenario, sonar_motion, sonar_pose
from sonar_sim.simulator import PINGS_PER_TASK
from studies.report import PAGES, write_section

if TYPE_CHECKING:
    from multiprocessing.queues import Queue
    from multiprocessing.synchronize import Barrier


PUBLISHED = (
    ("NPS / DAVE raster", "i9-9900K, RTX 2080 Ti", "512 beams, 60 m, 114 rays a beam", "0.5"),
    ("NPS / DAVE raster", "i9-9900K, RTX 2080 Ti", "512 beams, 60 m, 11 rays a beam", "3.0"),
    ("NPS / DAVE raster", "i9-9900K, RTX 2080 Ti", "512 beams, 10 m, 11 rays a beam", "10"),
    ("DAVE for ROS 2, CUDA", "a GPU, unnamed", "3000 rays", "28"),
    ("Cerqueira 2017", "i7-3540M, NVS 5200M", "128 x 500, 120° x 20°", "18.3"),
    ("Cerqueira 2017", "i7-3540M, NVS 5200M", "256 x 500, 120° x 20°", "5.0"),
    ("Cerqueira 2017", "i7-3540M, NVS 5200M", "256 x 1000, 120° x 20°", "4.6"),
    ("HoloOcean", "a GPU", "512 x 512, 40 m", "2, as its example is set"),
    ("uuv_simulator", "a GPU", "400 x 578", "40, as asked for"),
)
"""Simulator, hardware, size, pings a second as its authors give them."""


def tables(speeds: Sequence["Speed"], *, triangles: int, workers: int, load: float) -> str:
    """All tables as Markdown."""
    head = (
        f"`make sim-bench`: the shipped harbour, {triangles:,} triangles, {speeds[0].pings} pings "
        "in four stretches of its trajectory, each at the asked rate, everything that `auto` "
        "calls for, deciding and ray casting "
        f"included; {workers} processes of one thread. Load of the machine before: {load:.1f}."
    )
    return "\n\n".join(
        [head, _rates(speeds), _stages_table(speeds), _costs_table(speeds), _published()]
    )


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    ruler = ["---", *("---:" for _ in header[1:])]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [header, ruler, *rows])


def _rates(speeds: Sequence["Speed"]) -> str:
    rows = [
        (
            f"{s.beams} x {s.rows}",
            f"{s.wished_hz:g}",
            f"{s.rate_hz:.1f}",
            f"{s.cpu_ms:.1f}",
            "yes" if s.rate_hz >= s.wished_hz else "**no**",
        )
        for s in speeds
    ]
    return _table(("beams x rows", "asked, Hz", "pings a second", "CPU ms a ping", "met"), rows)


def _stages_table(speeds: Sequence["Speed"]) -> str:
    rows = [
        (name, *(f"{s.stage_ms.get(name, 0.0):.1f}" for s in speeds)) for name in speeds[0].stage_ms
    ]
    sizes = [f"{s.beams} x {s.rows}, ms" for s in speeds]
    return _table(("stage, one thread, median", *sizes), rows)


def _costs_table(speeds: Sequence["Speed"]) -> str:
    rows = []
    for name in speeds[0].cost_ms:
        on = f"{speeds[0].effects.get(name, 0) / speeds[0].pings:.0%}"
        rows.append((name, on, *(f"{s.cost_ms[name]:.1f}" for s in speeds)))
    sizes = [f"{s.beams} x {s.rows}, ms" for s in speeds]
    note = (
        "CPU time that an effect adds to one ping of the trajectory's middle, or would add; on a "
        "busy machine differences of some milliseconds are noise. Speckle saves time: mean powers "
        "take a finer walk over each patch."
    )
    return note + "\n\n" + _table(("effect", "pings that call for it", *sizes), rows)


def _published() -> str:
    note = "What others publish, on other machines and scenes:"
    return note + "\n\n" + _table(("simulator", "hardware", "size", "Hz"), PUBLISHED)


SCENE = "harbour"
SCENES = (
    "flat_floor",
    "harbour",
    "open_water",
    "pile_field",
    "pipeline",
    "ship_hull",
    "tank",
    "wreck",
)
SCENE_RATE_HZ = 10.0
SIZES = ((256, 500, 40.0), (512, 1000, 20.0))
"""Beams, rows, and the pings a second that are asked for."""
STRETCHES = 4
"""Parts of the trajectory that are pinged at the asked rate: their pings follow one another."""


@dataclass(frozen=True, slots=True)
class Speed:
    """One size of picture.

    Attributes:
        beams, rows: of the picture.
        wished_hz: asked for.
        rate_hz: pings a second of all workers together, by the clock on the wall.
        cpu_ms: of all workers for a ping.
        stage_ms: medians of one worker alone; what decides among them.
        cost_ms: what each effect adds to a ping, or would add.
        effects: in how many of the pings each was on.
        pings: that were made.
    """

    beams: int
    rows: int
    wished_hz: float
    rate_hz: float
    cpu_ms: float
    stage_ms: dict[str, float]
    cost_ms: dict[str, float]
    effects: "Counter[str]"
    pings: int


def measure(scenario: Scenario, wished_hz: float, pings: int, workers: int) -> Speed:
    """Measure the scenario's sonar; the workers get equal numbers of pings."""
    step = PINGS_PER_TASK * workers
    pings = -(-pings // step) * step
    times_s = _times_s(scenario.trajectory.duration_s, wished_hz, pings)
    size = scenario.sonar.beams, scenario.sonar.rows
    context = get_context("spawn")
    ready = context.Barrier(workers + 1)
    results: Queue[tuple[Counter[str], float]] = context.Queue()
    processes = [
        context.Process(target=_work, args=(size, times_s, (k, workers), ready, results))
        for k in range(workers)
    ]
    for process in processes:
        process.start()
    ready.wait()
    start_s = time.perf_counter()
    shares = [results.get() for _ in processes]
    wall_s = time.perf_counter() - start_s
    for process in processes:
        process.join()
    used = sum((share[0] for share in shares), Counter())
    simulator = Simulator(scenario.scene, scenario.sonar, threads=1)
    return Speed(
        *size,
        wished_hz,
        pings / wall_s,
        1e3 * sum(share[1] for share in shares) / pings,
        _stages(scenario, simulator, times_s),
        _costs(scenario, simulator, times_s[pings // 2]),
        used,
        pings,
    )


def _work(
    size: tuple[int, int],
    times_s: Sequence[float],
    share: tuple[int, int],
    ready: "Barrier",
    results: "Queue[tuple[Counter[str], float]]",
) -> None:
    """In a process of its own: make a share of the pings; reports effects and CPU time.

    Pings are dealt in blocks, as `simulate_pings` deals them.
    """
    scenario = _scenario(*size)
    simulator = Simulator(scenario.scene, scenario.sonar, threads=1)
    used: Counter[str] = Counter()

    def ping(number: int) -> tuple[str, ...]:
        t = times_s[number]
        pose, motion = sonar_pose(scenario, t), sonar_motion(scenario, t)
        return simulator.ping(pose, number, t, motion).effects

    ping(0)  # the first one warms up
    ready.wait()
    start_s = time.process_time()
    place, workers = share
    for number in range(len(times_s)):
        if number // PINGS_PER_TASK % workers == place:
            used.update(ping(number))
    results.put((used, time.process_time() - start_s))


def _scenario(beams: int, rows: int, name: str = SCENE) -> Scenario:
    """A shipped scenario with a picture of another size."""
    scenario = load_scenario(name)
    return replace(scenario, sonar=replace(scenario.sonar, beams=beams, forced_rows=rows))


def _times_s(duration_s: float, rate_hz: float, pings: int) -> list[float]:
    """When a sonar of that rate pings, in stretches from all over the trajectory."""
    each = -(-pings // STRETCHES)
    span_s = each / rate_hz
    starts_s = [(duration_s - span_s) * k / max(STRETCHES - 1, 1) for k in range(STRETCHES)]
    return [start_s + n / rate_hz for start_s in starts_s for n in range(each)][:pings]


def scene_costs_ms(name: str, pings: int) -> list[float]:
    """CPU time of a ping of a scene, one thread: by size, with `auto` and with `all`.

    Each ping is made in both ways before the next one: what slows the machine slows both.
    """
    costs = []
    for beams, rows, _ in SIZES:
        scenario = _scenario(beams, rows, name)
        times_s = _times_s(scenario.trajectory.duration_s, SCENE_RATE_HZ, pings)
        both = [
            Simulator(scenario.scene, scenario.sonar, effects=effects, threads=1)
            for effects in ("auto", "all")
        ]
        for simulator in both:
            simulator.ping(sonar_pose(scenario, 0.0))  # the first one warms up
        spent_s = [0.0, 0.0]
        for number, t in enumerate(times_s):
            pose, motion = sonar_pose(scenario, t), sonar_motion(scenario, t)
            for place, simulator in enumerate(both):
                start_s = time.process_time()
                simulator.ping(pose, number, t, motion)
                spent_s[place] += time.process_time() - start_s
        costs += [1e3 * spent / len(times_s) for spent in spent_s]
    return costs


def scenes_table(costs_ms: dict[str, list[float]]) -> str:
    """The scenes' costs as Markdown."""
    sizes = [f"{beams} x {rows}" for beams, rows, _ in SIZES]
    header = ["scene"]
    for size in sizes:
        header += [f"{size}, `auto`, ms", "`all`, ms", "times", "pings a second and core"]
    rows = []
    for name, costs in costs_ms.items():
        row = [name]
        for auto, everything in zip(costs[::2], costs[1::2], strict=True):
            row += [f"{auto:.1f}", f"{everything:.1f}", f"{everything / auto:.2f}"]
            row.append(f"{1e3 / auto:.0f}")
        rows.append(row)
    note = (
        f"CPU time of a ping in every shipped scene, pings at {SCENE_RATE_HZ:g} Hz in stretches "
        "of its trajectory, deciding and ray casting included; each ping is made in both ways "
        "before the next one."
    )
    return note + "\n\n" + _table(header, rows)


def _stages(scenario: Scenario, simulator: Simulator, times_s: Sequence[float]) -> dict[str, float]:
    """Medians over the pings, on one thread."""
    engine = _engine_of(scenario, simulator)
    laps: dict[str, list[float]] = {}
    for number, t in enumerate(times_s):
        pose, motion = sonar_pose(scenario, t), sonar_motion(scenario, t)
        start_s = time.perf_counter()
        physics = simulator.plan(pose, number, t, motion).physics
        laps.setdefault("deciding", []).append(1e3 * (time.perf_counter() - start_s))
        for name, ms in engine.ping(pose, physics, number, t, motion).stage_ms.items():
            laps.setdefault(name, []).append(ms)
    return {name: statistics.median(ms) for name, ms in laps.items()}


def _engine_of(scenario: Scenario, simulator: Simulator) -> PingEngine:
    """As the simulator's, on one thread."""
    nodes_per_beam = simulator.nodes_per_beam
    return PingEngine(scenario.scene, scenario.sonar, threads=1, nodes_per_beam=nodes_per_beam)


def _costs(scenario: Scenario, simulator: Simulator, time_s: float) -> dict[str, float]:
    pose, motion = sonar_pose(scenario, time_s), sonar_motion(scenario, time_s)
    planned = simulator.plan(pose, 0, time_s, motion)
    engine = _engine_of(scenario, simulator)
    return measured_costs_ms(engine, planned.plan, planned.view, 5)


def main() -> None:
    """Measure both sizes."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pings", type=int, default=96)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scenes", action="store_true", help="only the table of all scenes")
    parser.add_argument("--write", action="store_true", help="into docs/reports/performance.md")
    args = parser.parse_args()
    scenes = scenes_table({name: scene_costs_ms(name, args.pings) for name in SCENES})
    print(scenes)
    if args.write:
        write_section(
            PAGES["performance"], "simulator-scenes", scenes, "python -m bench simulator-speed"
        )
    if args.scenes:
        return
    scenario = load_scenario(SCENE)
    load = os.getloadavg()[0]
    speeds = []
    for beams, rows, wished_hz in SIZES:
        speeds.append(measure(_scenario(beams, rows), wished_hz, args.pings, args.workers))
    triangles = sum(len(surface.faces) for surface in scenario.scene.surfaces)
    text = tables(speeds, triangles=triangles, workers=args.workers, load=load)
    print(text)
    if args.write:
        write_section(PAGES["performance"], "simulator", text, "python -m bench simulator-speed")


if __name__ == "__main__":
    main()
