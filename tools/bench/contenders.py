"""The contenders, and the command that runs each."""

import sys
from dataclasses import dataclass
from pathlib import Path

BENCH = Path(__file__).resolve().parent


@dataclass(frozen=True, slots=True)
class Case:
    """One look, range and voxel size, and the files that hold its pings.

    Attributes:
        loud_share: share of the pixels above the map's intensity threshold.
    """

    look: str
    range_m: float
    resolution_m: float
    pings_file: Path
    rays_file: Path
    loud_share: float

    @property
    def name(self) -> str:
        """For people."""
        return f"looking {self.look}, {self.range_m:g} m, {100 * self.resolution_m:g} cm"


@dataclass(frozen=True, slots=True)
class Contender:
    """A map and an integrator.

    Attributes:
        name: unique.
        map_name: of the map and its integrator.
        takes: what it is given of a ping.
        threads: that it may use.
        words: what distinguishes its command.
    """

    name: str
    map_name: str
    takes: str
    threads: int
    words: tuple[str, ...]

    @property
    def label(self) -> str:
        """For people; all rivals take the same input."""
        takes = f", {self.takes}" if self.is_ours else ""
        threads = f", {self.threads} threads" if self.threads > 1 else ""
        return f"{self.map_name}{takes}{threads}"

    @property
    def is_ours(self) -> bool:
        """Whether it is a map of this project."""
        return self.takes != RAYS

    def command(self, case: Case, build: Path, budget_s: float) -> list[str | Path]:
        """To run it on a case in a process of its own."""
        given = (f"{case.resolution_m}", f"{budget_s}")
        if not self.is_ours:
            program, *way = self.words
            return [build / program, case.rays_file, *given, *way]
        return [sys.executable, "-m", "bench.our_contender", case.pings_file, *given, *self.words]


def _rival(program: str, map_name: str, *way: str) -> Contender:
    name = " ".join((program.removesuffix("_rival"), *way))
    return Contender(name, map_name, RAYS, 1, (program, *way))


def _ours(way: str, threads: int, takes: str) -> Contender:
    """Motion within the ping is timed with one thread of the evidence grid."""
    map_name = "ours, rays" if way == "rays" else "ours, evidence grid"
    words = [way, "--threads", f"{threads}"]
    words += ["--first-returns"] if takes == FIRST else []
    words += ["--motion"] if way == "grid" and threads == 1 else []
    return Contender(f"{way} {threads} {takes}", map_name, takes, threads, tuple(words))


RAYS, FIRST, FULL = "11 rays a first return", "first returns", "full image"
OCTOMAP = _rival("octomap_rival", "OctoMap insertPointCloud")
OPENVDB = (
    _rival("openvdb_rival", "OpenVDB, each visit", "visits"),
    _rival("openvdb_rival", "OpenVDB, once a ping", "once"),
)
BONXAI = _rival("bonxai_rival", "Bonxai insertPointCloud")
RAYS_FIRST, RAYS_FULL = _ours("rays", 1, FIRST), _ours("rays", 1, FULL)
GRID_FIRST, GRID_FULL = _ours("grid", 1, FIRST), _ours("grid", 1, FULL)
GRID_FIRST_2, GRID_FULL_2 = _ours("grid", 2, FIRST), _ours("grid", 2, FULL)
CONTENDERS = (
    *(OCTOMAP, *OPENVDB, BONXAI),
    *(RAYS_FIRST, RAYS_FULL),
    *(GRID_FIRST, GRID_FULL, GRID_FIRST_2, GRID_FULL_2),
)
