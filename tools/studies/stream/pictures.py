"""The age of a client's map over the time, as a picture."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

from studies.stream.scenes import NEAR_M, TetherOutcome

__all__ = ["draw_ages"]

PROMISE_S = 3.0
SMOOTH_S = 2.0


def draw_ages(path: Path, outcome: TetherOutcome) -> None:
    """Above the ages of what is near and far, below what came through the link."""
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(9, 6), sharex=True, height_ratios=(2, 1), layout="constrained"
    )
    ages = outcome.ages
    seconds = (ages.times_ns - outcome.joined_ns) / 1e9
    above.plot(seconds, ages.far_s, color="0.6", label=f"beyond {NEAR_M:.0f} m")
    above.plot(seconds, ages.near_s, color="C0", label=f"within {NEAR_M:.0f} m of the vehicle")
    above.axhline(PROMISE_S, color="C3", linewidth=1, linestyle="--", label="promise: 3 s")
    above.set_yscale("symlog", linthresh=PROMISE_S)
    above.set_ylim(0)
    above.set_ylabel("age of the oldest content, s")
    above.legend(loc="upper right")
    shape = outcome.shape
    above.set_title(
        f"The map of a client that joins mid-dive: {shape.bits_per_s / 1e3:.0f} kbit/s, "
        f"{shape.delay_s * 1e3:.0f} ms each way, {shape.loss:.0%} of packets lost"
    )
    told_s = (outcome.traffic[:, 0] - outcome.joined_ns) / 1e9
    edges = np.arange(0, max(told_s.max(initial=1.0), 1.0) + SMOOTH_S, SMOOTH_S)
    until = np.interp(edges, told_s, outcome.traffic[:, 1], left=0)
    below.step(edges[1:], np.diff(until) * 8 / 1e3 / SMOOTH_S, where="pre", color="C2")
    below.axhline(shape.bits_per_s / 1e3, color="0.6", linewidth=1, linestyle="--")
    below.set_ylabel("received, kbit/s")
    below.set_xlabel("seconds since it joined")
    below.set_xlim(0, seconds.max(initial=1.0))
    figure.savefig(path, dpi=110)
    plt.close(figure)
