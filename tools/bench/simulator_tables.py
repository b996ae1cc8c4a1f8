"""The tables of the simulator's speed, beside the rates that others publish."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bench.simulator_speed import Speed

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
    return "\n\n".join([head, _rates(speeds), _stages(speeds), _costs(speeds), _published()])


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


def _stages(speeds: Sequence["Speed"]) -> str:
    rows = [
        (name, *(f"{s.stage_ms.get(name, 0.0):.1f}" for s in speeds)) for name in speeds[0].stage_ms
    ]
    sizes = [f"{s.beams} x {s.rows}, ms" for s in speeds]
    return _table(("stage, one thread, median", *sizes), rows)


def _costs(speeds: Sequence["Speed"]) -> str:
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
