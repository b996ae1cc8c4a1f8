"""Pictures of a localized dive: particles on the map, and the error against time."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from mapperd.localization.maps import VolumeMap
from studies.localization.runs import Moment

mpl.use("Agg")
import matplotlib.pyplot as plt

MINUTE_S = 60.0
NEAR_M = 0.5
"""Above and below the vehicle's height: surfaces drawn as the map."""


def draw_errors(path: Path, moments: list[Moment], title: str) -> None:
    """Place and heading of the best mode, against the odometry alone."""
    minutes = [m.time_s / 60.0 for m in moments]
    picture, (place, heading) = plt.subplots(2, 1, figsize=(9, 5), sharex=True)
    place.semilogy(minutes, [m.reckoned_m for m in moments], color="#9a9a9a", label="odometry")
    place.semilogy(minutes, [m.error_m for m in moments], color="#1f77b4", lw=0.7, label="filter")
    place.set_ylim(0.01, None)
    place.set_ylabel("error, m")
    place.set_title(title)
    place.legend(loc="lower right")
    turns = np.degrees([m.turn_error_rad for m in moments])
    heading.plot(minutes, turns, color="#1f77b4", lw=0.7)
    heading.set_ylabel("heading error, deg")
    heading.set_xlabel("minutes")
    picture.tight_layout()
    picture.savefig(path, dpi=90)
    plt.close(picture)


def draw_clouds(path: Path, known: VolumeMap, moments: list[Moment], title: str) -> None:
    """Particles on the map at some instants, the true place a cross."""
    shown = [m for m in moments if m.particles is not None]
    picture, panels = plt.subplots(1, len(shown), figsize=(3.4 * len(shown), 3.2), squeeze=False)
    first, edge_m = known.first_centre_m, known.resolution_m
    nearest = known.distances_m.min(axis=2).T
    rows, columns = nearest.shape
    extent = (first[0], first[0] + columns * edge_m, first[1], first[1] + rows * edge_m)
    wall = (known.distances_m < edge_m).sum(axis=2).T * edge_m > NEAR_M
    for panel, moment in zip(panels[0], shown, strict=True):
        panel.imshow(wall, origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=1.5)
        particles = moment.particles
        if particles is not None:
            panel.scatter(particles[:, 0], particles[:, 1], s=1, color="#d62728", lw=0)
        panel.plot(*moment.true[:2], "x", color="#1f77b4")
        panel.set(xlim=extent[:2], ylim=extent[2:])
        seconds, minutes = moment.time_s, moment.time_s / MINUTE_S
        at = f"{seconds:.0f} s" if seconds < MINUTE_S else f"{minutes:.0f} min"
        panel.set_title(f"{title}, {at}, {moment.way_m:.1f} m", fontsize=8)
    picture.tight_layout()
    picture.savefig(path, dpi=90)
    plt.close(picture)
